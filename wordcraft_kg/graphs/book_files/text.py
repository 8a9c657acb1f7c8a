"""The text of a recipe book: UTF-8, UTF-16 with a mark, or the encoding that the user names.

No encoding is guessed: many fit the same bytes, and give other labels. Text formats that are no
recipe books have names for refusals. JSON is parsed with errors that name the line.
"""

import codecs
import json
import re
from collections import Counter
from pathlib import Path
from typing import Any, NamedTuple

from wordcraft_kg.base.errors import ConfigError, RecipeFileError
from wordcraft_kg.base.escaping import for_terminal
from wordcraft_kg.graphs.book_files.rows import refusal

_MARKS = {
    codecs.BOM_UTF8: "utf-8",
    codecs.BOM_UTF16_LE: "utf-16",
    codecs.BOM_UTF16_BE: "utf-16",
}
_NOT_OF_FILES = frozenset(
    {"punycode", "idna", "unicode_escape", "raw_unicode_escape", "undefined", "mbcs", "oem"}
    | {"unicode-escape", "raw-unicode-escape"}
)
"""Python's encodings of names and source code, not of files."""
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


class Decoded(NamedTuple):
    """A file's text.

    Attributes:
        text: the text, without a byte order mark.
        encoding: name of the encoding.
        has_mark: whether the bytes began with a byte order mark.
    """

    text: str
    encoding: str
    has_mark: bool


def check_encoding(encoding: str | None) -> None:
    """Check that Python knows a text encoding.

    Args:
        encoding: its name; None, for UTF-8 or the encoding of a mark, is always right.

    Raises:
        ConfigError: if it does not, or the encoding is one of names or source code, not of files.
    """
    if encoding is None:
        return
    try:
        if not isinstance("".encode(encoding), bytes):
            raise LookupError
        if codecs.lookup(encoding).name in _NOT_OF_FILES:
            raise LookupError
        b"".decode(encoding)
    except (LookupError, UnicodeError, ValueError, TypeError):
        raise ConfigError(
            f"`encoding` {encoding!r}: expected an encoding that Python knows, such as utf-8, "
            "cp1252 or shift_jis."
        ) from None


def decode(path: Path, data: bytes, encoding: str | None = None) -> Decoded:
    """Decode a file's bytes.

    Args:
        path: the file, for errors.
        data: the bytes.
        encoding: the encoding, one that :func:`check_encoding` accepts; None for that of a byte
            order mark, or UTF-8.

    Raises:
        RecipeFileError: for an empty or binary file, and for bytes that do not fit the encoding.
            The message shows the first such line as another encoding reads it.
    """
    mark = next((mark for mark in _MARKS if data.startswith(mark)), b"")
    marked = _MARKS.get(mark, "")
    name = codecs.lookup(encoding or marked or "utf-8").name.removesuffix("-sig")
    if not name.startswith(marked):
        seen = f"it begins with the byte order mark of {marked}, and `encoding` is {encoding}"
        raise refusal(path, seen, "encodings", "Leave --encoding out.")
    if name == "utf-8" and b"\x00" in data:
        seen = "a binary file (it holds zero bytes), not text"
        remedy = "If it is text in UTF-16, name it with --encoding utf-16-le."
        raise refusal(path, seen, "encodings", remedy)
    try:
        text = data.decode(name).removeprefix("\ufeff")
    except UnicodeDecodeError as error:
        seen = _not(data, name, error)
        remedy = "Name the file's encoding, such as --encoding cp1252, or save the file as UTF-8."
        raise refusal(path, seen, "encodings", remedy) from None
    if text.startswith("\ufeff"):
        raise refusal(path, "two byte order marks", "encodings", "Remove them.")
    if not text.strip():
        raise RecipeFileError(f"{path} is empty; a recipe book needs at least one recipe.")
    return Decoded(text, name, bool(mark))


def _not(data: bytes, name: str, error: UnicodeDecodeError) -> str:
    """Return where bytes are not in an encoding, and what the usual other one makes of them."""
    line = data.count(b"\n", 0, error.start) + 1
    line_start = data.rfind(b"\n", 0, error.start) + 1
    around = data[line_start : error.start + 30].decode("cp1252", errors="replace")
    shown = for_terminal(around.splitlines()[0][:60])
    byte = f"byte 0x{data[error.start]:02x}"
    expected = name.replace("utf", "UTF")
    return f"line {line} is not {expected} ({byte}); as cp1252 it begins {shown!r}"


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


# --- JSON ----------------------------------------------------------------------------------------

_START = re.compile(r'\s*(?:[\[{]\s*)+"')
"""Brackets before a text in quotes, as at the start of lists of labels and of objects."""


def is_json(text: str) -> bool:
    """Return whether a text begins as JSON does, whatever its file's ending."""
    return _START.match(text) is not None


def load_json(path: Path, text: str) -> tuple[Any, bool]:
    """Parse JSON, or JSON lines as a list.

    Args:
        path: the file, for errors.
        text: the whole text.

    Returns:
        The value, and whether it was JSON lines.

    Raises:
        RecipeFileError: if it is neither, with the line of the first fault; or for JSON that no
            book can be, such as an object with a key twice.
    """
    try:
        return _loads(path, text), False
    except json.JSONDecodeError as error:
        # JSON lines look to a parser like a value in the first line, and more behind it.
        first_value = text[: error.pos].strip()
        if error.msg != "Extra data" or error.lineno == 1 or "\n" in first_value:
            raise _not_json(path, error.lineno, error) from None
    # Only line feeds: other separators, such as U+2028, may stand in a text.
    lines = enumerate(text.split("\n"), start=1)
    return [parsed_json(path, line, number) for number, line in lines if line.strip()], True


def parsed_json(path: Path | str, text: str, line: int | None = None) -> Any:
    """Parse one JSON value.

    Args:
        path: the file, for errors.
        text: the value.
        line: number of the text's line in the file; None for a text that is the whole file.

    Raises:
        RecipeFileError: if it is not JSON, with the line; or for JSON that no book can be, such as
            an object with a key twice.
    """
    try:
        return _loads(path, text)
    except json.JSONDecodeError as error:
        raise _not_json(path, error.lineno if line is None else line, error) from None


def _not_json(path: Path | str, line: int, error: json.JSONDecodeError) -> RecipeFileError:
    return RecipeFileError(f"{path}, line {line}, column {error.colno}: not JSON ({error.msg}).")


def _loads(path: Path | str, text: str) -> Any:
    """Parse JSON; an object with a key twice is refused, where Python would drop the first.

    Raises:
        json.JSONDecodeError: if it is not JSON.
        RecipeFileError: if it is JSON that no book can be.
    """

    def without_duplicate_keys(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        value = dict(pairs)
        if len(value) < len(pairs):
            counts = Counter(key for key, _ in pairs)
            repeated = [key for key in value if counts[key] > 1]
            raise RecipeFileError(f"{path}: the key '{repeated[0]}' occurs twice in one object.")
        return value

    try:
        return json.loads(text, object_pairs_hook=without_duplicate_keys)
    except (json.JSONDecodeError, RecipeFileError):
        raise
    except RecursionError:
        raise RecipeFileError(f"{path}: nested too deeply for a recipe book.") from None
    except ValueError as error:  # such as a number of thousands of digits
        raise RecipeFileError(f"{path}: not a recipe book ({error}).") from None
