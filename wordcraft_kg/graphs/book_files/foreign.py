"""Names of text formats that are no recipe books, for refusals."""

import re

_SAMPLE = 2**16  # characters at the start of a text
_FORMATS = {
    "HTML": r"\A\s*<(?:!doctype html|html|head|body|table|div|ul|ol|p)\b",
    "XML": r"\A\s*<[?!\w]",
    "SQL": r"^\s*(?:INSERT\s+INTO|CREATE\s+TABLE)\b",
    "a table of MediaWiki": r"\A\s*\{\|",
    "a table of DokuWiki": r"\A\s*\^.+\^\s*$",
    "a table of Jira": r"\A\s*\|\|.+\|\|\s*$",
    "a table that a database printed": r"^\s*(?:\+-[+-]+\+|-+\+-[+-]+)\s*$",
    "a table of reStructuredText": r"^={2,} +={2,}[ =]*$",
    "LaTeX": r"\\(?:begin|end)\{",
    "program code": r"^\s*(?:const|let|var|function|def|class|import|local) ",
    "TOML": r"^\s*\[{1,2}[\w.\"' -]+\]{1,2}\s*$",
    "YAML": r"^(?:---\s*$|[^\s,:;|]+:\s*(?:[\[{|>].*)?$|\s*- [^,;|]+:)",
}
"""Signs of formats, the more certain ones first."""


def foreign_format(text: str) -> str | None:
    r"""Return the format of a text that is neither a table nor lines nor JSON, or None.

    Example:
        >>> foreign_format("mud:\n  - [water, earth]"), foreign_format("a,b,c")
        ('YAML', None)
    """
    sample = text[:_SAMPLE]
    for name, sign in _FORMATS.items():
        if re.search(sign, sample, re.IGNORECASE | re.MULTILINE):
            return name
    return None
