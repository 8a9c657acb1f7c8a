"""Lines such as ``water + earth = mud``, as in forums and chats; several results by commas.

Either side of the sign may hold the sum: ``mud = water + earth, clay + rain`` gives two recipes.
Marks of lists are no part of labels.
"""

import io
import re
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from msgspec.structs import replace

from wordcraft_kg.graphs.book_files.cells import alternatives, read_labels, without_markup
from wordcraft_kg.graphs.book_files.rows import (
    INFINITE_CRAFT_BASE,
    MAX_LINE_LENGTH,
    Entry,
    Fault,
    FileRows,
    LeftOut,
    Row,
    refusal,
    without_nothing,
)
from wordcraft_kg.graphs.book_files.tables import read_directive, too_long
from wordcraft_kg.graphs.book_files.words import is_documented
from wordcraft_kg.graphs.reading import Reading
from wordcraft_kg.graphs.recipes import label_fault

_FORWARD = "→⇒⟶⟹➡⇨➔➜"
_BACKWARD = "←⇐⟵⟸⬅⇦"
_SIGNS = tuple(
    re.compile(sign)
    for sign in (
        rf"[-=~—–]+(?:>|&gt;)|[{_FORWARD}]\ufe0f?",
        rf"[<‹][-=~—–]+|[{_BACKWARD}]\ufe0f?",
        r":=",
        r"\s=\s",
        r"=",
        r"\s:\s",
        r":",
    )
)
"""Signs between ingredients and results, the more certain ones first."""
_MARK = re.compile(
    r"(?:\s*(?:[-*•–·◦▪‣+>]\s+|\*{2,}\s+|>+\s+|\(?\d+[.)\]:]\s+|\d+[.)](?=[^\W\d])|\[\d+\]\s+"
    r"|\d+\s+[-–—]\s+|\[[ xX]?\]\s+|[☐☑☒✓✔✅]\ufe0f?\s*)){0,3}"
)
"""Marks of a list before a line: bullets, numbers, boxes, quotes."""
_END_MARK = re.compile(r"\s*(?:;|<br\s*/?>|\\|[✓✔✅]\ufe0f?)\s*$", re.IGNORECASE)
_QUOTED = re.compile(r"""(["'])((?:(?!\1).)+)\1""")
_WIDE_SIGNS = str.maketrans("＋＝：，", "+=:,")
"""Signs as East Asian keyboards write them."""
_HEADING = re.compile(r"\s*(?:#|//|={2,}|-{2,}|\*{2,}|`{3}|\[[^\]+=]*\]\s*$|[^+=:]*:\s*$)")
_COMMENT = re.compile(r"\s*(?:#\s|#$|//)")
_TAG = re.compile(r"#[\w.-]+:\w")  # a label of Minecraft, such as #minecraft:planks
_LEFT_OVER = re.compile(
    rf"^[=<>~≈|:;*\"“`]|^-[-\s]|[=<>~≈|:;*\"”`]$|\s[-–—]$|[{_FORWARD}{_BACKWARD}≈]|\[\[|\]\]|;\s"
    r"|\s(?:[=<>~|#/]|//|:=)\s"
)
"""Signs, quotes and comments that a label does not hold."""
_PREFIX = re.compile(r"^(?:[^\w\s\"'(#]+\s*|.{0,30}?[:\])|]\s+|\S*\d\S*\s+)(?=.)")
_SUFFIX = re.compile(r"(?<=.)(?:\s*[\[(][^\[\]()]*[\])]|\s+[-–—]\s+.*|\s*[^\w\s\"')\]]+)$")
"""Beginnings and ends of lines that may be marks, or parts of labels."""
_OFTEN = 0.2  # share of the lines with a beginning or end
_SELDOM = 0.1  # how many times rarer it must be in other labels
_ENOUGH = 0.5  # share of the lines that are recipes, in a file of this shape
_SAMPLE_LINES = 200


class _Sides(NamedTuple):
    """A line's two sides of the sign, and whether it is an arrow to the left."""

    left: str
    right: str
    is_backward: bool = False


def looks_like_lines(text: str, *, is_table: bool) -> bool:
    """Return whether at least half of a text's first lines have a sum and a sign.

    Args:
        text: the text.
        is_table: whether the file's ending is that of a table; then the sum has to come before any
            delimiter, as in a + b = c, d.
    """
    lines = [line for line in text[: 2**17].splitlines() if line.strip()][:_SAMPLE_LINES]
    content = [line for line in lines if not _is_heading(line)]
    if is_table and any(sign in line for line in content[:20] for sign in ",;\t|"):
        starts = [_sides(re.split(r"[,;\t|]", line)[0]) for line in content]
        return bool(content) and all(sides is not None and "+" in sides.left for sides in starts)
    sums = [line for line in content if _is_recipe(line[:MAX_LINE_LENGTH])]
    return bool(content) and len(sums) >= _ENOUGH * len(content)


def read_lines(path: Path, text: str, *, fold: bool = False) -> FileRows:
    """Read a text with a sum on each line.

    Args:
        path: the file, for errors.
        text: its text.
        fold: whether labels are in lower case.

    Raises:
        RecipeFileError: if sums are on both sides, or an arrow points at a sum.
    """
    source = FileRows(Reading(shape="lines a + b = c"))
    lines = list(enumerate(io.StringIO(text, newline=""), start=1))
    left = right = 0
    for number, line in lines:
        sides = None if _is_heading(line) else _sides(line)
        if sides is not None:
            left += "+" in sides.left
            right += "+" in sides.right
            if sides.is_backward and "+" in sides.left:
                seen = f"line {number}, whose arrow points at a sum of ingredients"
                raise refusal(path, seen, "lines")
    if left and right:
        raise refusal(path, "lines with sums on either side of the sign, or on both", "lines")
    columns = ("sum", "result") if left >= right else ("sum", "result before it")
    source.reading = replace(source.reading, columns=columns)
    entries: list[Entry] = list(_entries(source, lines, sum_is_left=left >= right))
    rows = [entry for entry in entries if isinstance(entry, Row)]
    labels = read_labels(rows, label_fault, fold=fold)
    source.entries = [labels.row(entry) if isinstance(entry, Row) else entry for entry in entries]
    source.label = labels.label
    source.reading = labels.facts(source.reading)
    # Each label of Infinite Craft's base as a word of its own.
    if all(re.search(rf"\b{word}\b", text) for word in INFINITE_CRAFT_BASE):
        source.entries = without_nothing(source.entries)
    # In a line the sum may stand on either side.
    first, last = ([row.ingredients[0] for row in rows], [row.result for row in rows])
    inner = [label for row in rows for label in row.ingredients[1:]]
    if left < right:
        first, last = last, [row.ingredients[-1] for row in rows]
    for where, pattern, ends in (("begin", _PREFIX, first), ("end", _SUFFIX, last)):
        others = [*inner, *(last if ends is first else first)]
        mark = _common_mark(pattern, ends, others)
        if mark is not None:
            seen = (
                f"many lines {where} as with {mark[:40]!r}, which may be a mark or part of a label"
            )
            raise refusal(path, seen, "lines", "Remove it from the lines.")
    return source


def _common_mark(pattern: re.Pattern[str], ends: list[str], others: list[str]) -> str | None:
    """Return what many labels at an end of lines have, and few other labels; None without one."""
    marks = [found[0].strip() for found in map(pattern.search, ends) if found]
    elsewhere = sum(1 for label in others if pattern.search(label))
    share = len(marks) / max(len(ends), 1)
    is_mark = len(marks) > 1 and share >= _OFTEN and elsewhere <= _SELDOM * share * len(others)
    return marks[0] if is_mark else None


def _entries(
    source: FileRows, lines: list[tuple[int, str]], *, sum_is_left: bool
) -> Iterator[Entry]:
    for number, line in lines:
        if not line.strip():
            continue
        is_directive = re.match(r"#\s*(?:base|entities)\s*:", line, re.IGNORECASE)
        if is_directive:
            yield from filter(None, [read_directive(source, number, line)])
        elif _is_heading(line):
            yield LeftOut(number, "headings or comments")
        elif len(line) > MAX_LINE_LENGTH:
            yield Fault(number, "row", too_long(line), "long")
        else:
            yield from _recipes(source, number, line, sum_is_left=sum_is_left)


def _recipes(source: FileRows, number: int, line: str, *, sum_is_left: bool) -> Iterator[Entry]:
    sides = _sides(line)
    if sides is None:
        message = (
            f"{line.strip()[:80]!r} has no sign such as = or ->, or several; expected a + b = c."
        )
        yield Fault(number, "row", message, "no sign")
        return
    total, rest = (sides.left, sides.right) if sum_is_left else (sides.right, sides.left)
    # Several results, or several sums of the same result, between commas.
    if sum_is_left:
        pairs = [(_summands(total), _unwrapped(result)) for result in rest.split(",")]
        several_outputs = source.reading.several_outputs + (len(pairs) > 1)
        source.reading = replace(source.reading, several_outputs=several_outputs)
    else:
        pairs = [(_summands(part), _unwrapped(rest)) for part in total.split(",")]
    for ingredients, result in pairs:
        # Each fault once, in the order of the labels.
        faults = dict.fromkeys(filter(None, map(_label_fault, (*ingredients, result))))
        message = alternatives(ingredients, "+") or " Also, ".join(faults)
        yield Fault(number, "label", message) if message else Row(number, ingredients, result)


def _label_fault(label: str) -> str | None:
    sign = _LEFT_OVER.search(label)
    if sign is None and label.startswith("#") and not _TAG.match(label):
        return f"{label[:80]!r} may be a comment or a label; remove the #."
    if sign is not None and label_fault(label) is None:
        return (
            f"{label[:80]!r} holds {sign[0].strip() or sign[0]!r}, which may be a sign, a mark or "
            "part of a label; expected a + b = c."
        )
    return label_fault(label)


def _is_heading(line: str) -> bool:
    """Return whether a line is a heading or comment; nested bullets and tags are recipes."""
    # The name of a column of lines.
    if len(line.split()) == 1 and is_documented(line):
        return True
    return bool(_COMMENT.match(line)) or bool(_HEADING.match(line) and not _is_recipe(line))


def _is_recipe(line: str) -> bool:
    sides = _sides(line)
    return sides is not None and ("+" in sides.left or "+" in sides.right)


def _sides(line: str) -> _Sides | None:
    """Return what stands left and right of a line's sign, or None without exactly one sign."""
    content = line.translate(_WIDE_SIGNS).strip()
    mark = _MARK.match(content)
    content = _END_MARK.sub("", content[mark.end() if mark else 0 :])
    for sign in _SIGNS:
        parts = sign.split(content, maxsplit=2)
        # A sign at an end is a mark; a less certain sign may part the line.
        if len(parts) < 2 or not parts[0].strip() or not parts[1].strip():
            continue
        if len(parts) > 2:
            return None
        is_backward = sign is _SIGNS[1]
        left, right = map(_unwrapped, parts)
        return _Sides(left, right, is_backward)
    return None


def _summands(text: str) -> list[str]:
    """Return the parts of a sum; a plus without spaces is part of a label if there is one with."""
    return [_unwrapped(part) for part in text.split(" + " if " + " in text else "+")]


def _unwrapped(text: str) -> str:
    """Return a text without quotes or markup around all of it."""
    text = without_markup(text.strip())
    # Two quoted labels stay as they are, and are refused.
    quoted = _QUOTED.fullmatch(text)
    inner = quoted[2].strip() if quoted else ""
    return inner or text
