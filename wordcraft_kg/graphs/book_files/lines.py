"""Lines such as ``water + earth = mud``, as in forums and chats; several results by commas.

Either side of the sign may hold the sum: ``mud = water + earth, clay + rain`` gives two recipes.
Marks of lists are no part of labels. What else most lines begin or end with is refused.
"""

import io
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from itertools import islice
from pathlib import Path
from typing import NamedTuple

from wordcraft_kg.graphs.book_files.directives import is_directive, read_directive
from wordcraft_kg.graphs.book_files.guide import refusal
from wordcraft_kg.graphs.book_files.rows import (
    FROM_NOTHING,
    NOTHING,
    WITH_NOTHING,
    Entry,
    Fault,
    LeftOut,
    RowSource,
    alternatives,
    is_infinite_craft,
)
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
_IS_BACKWARD = re.compile(rf"[<‹{_BACKWARD}]")
_MARK = re.compile(
    r"\s*(?:[-*•–·◦▪‣+>]\s+|\*{2,}\s+|>+\s+|\(?\d+[.)\]:]\s+|\d+[.)](?=[^\W\d])|\[\d+\]\s+"
    r"|\d+\s+[-–—]\s+|\[[ xX]?\]\s+|[☐☑☒✓✔✅]\ufe0f?\s*)"
)
"""A mark of a list before a line: a bullet, a number, a box, a quote."""
_WIDE_SIGNS = str.maketrans("＋＝：，", "+=:,")
"""Signs as East Asian keyboards write them."""
_MOST_MARKS = 3  # such as a bullet, a box and a number
_END_MARK = re.compile(r"\s*(?:;|<br\s*/?>|\\|[✓✔✅]\ufe0f?)\s*$", re.IGNORECASE)
_HEADING = re.compile(r"\s*(?:#|//|={2,}|-{2,}|\*{2,}|`{3}|\[[^\]+=]*\]\s*$|[^+=:]*:\s*$)")
_COMMENT = re.compile(r"\s*(?:#\s|//)")
_TAG = re.compile(r"#[\w.-]+:\w")  # a label of Minecraft, such as #minecraft:planks
_WRAPPERS = (('"', '"'), ("“", "”"), ("'", "'"), ("`", "`"), ("**", "**"), ("[[", "]]"))
"""Quotes and markup around a label or a sum."""
_LEFT_OVER = re.compile(
    rf"^[=<>~≈|:;*\"“`]|^-[-\s]|[=<>~≈|:;*\"”`]$|\s[-–—]$|[{_FORWARD}{_BACKWARD}≈]|\[\[|\]\]|;\s"
    r"|\s(?:[=<>~|#/]|//|:=)\s"
)
"""Signs, quotes and comments that a label does not hold."""
_PREFIX = re.compile(r"[^\w\s\"'(#]+\s*|.{0,30}?[:\])|]\s+|\S*\d\S*\s+")
_SUFFIX = re.compile(r"(?:\s*[\[(][^\[\]()]*[\])]|\s+[-–—]\s+.*|\s*[^\w\s\"')\]]+)$")
_JUDGED_LINES = 10_000
_OFTEN = 0.2  # share of lines with one beginning or end
_MOSTLY = 0.5  # share of the other labels
_SELDOM = 0.1  # how many times rarer it must be in other labels
_LIMIT = 100_000  # characters in a line
_ENOUGH = 0.5  # share of the lines that are recipes, in a file of this shape


class _Sides(NamedTuple):
    """A line's two sides of the sign, and whether it is an arrow to the left."""

    left: str
    right: str
    is_backward: bool = False


def looks_like_lines(lines: list[str]) -> bool:
    """Return whether at least half of the lines have a sum and a sign; headings do not count.

    Args:
        lines: lines that are not blank; without any, the answer is False.
    """
    content = [line for line in lines if not _is_heading(line)]
    sums = [line for line in content if _is_recipe(line[:_LIMIT])]
    return bool(content) and len(sums) >= _ENOUGH * len(content)


def begins_with_recipe(line: str) -> bool:
    """Return whether a line is a recipe up to its first comma, as in a + b = c, d."""
    sides = _sides(line.partition(",")[0])
    return sides is not None and "+" in sides.left


class SumLines(RowSource):
    """A text with a sum on each line."""

    shape = "lines a + b = c"

    def __init__(self, path: Path, text: str):
        """Find on which side the sums are.

        Args:
            path: the file, for errors.
            text: its text.

        Raises:
            RecipeFileError: if they are on both sides, an arrow points at a sum, or many lines
                begin or end with what may be a mark.
        """
        super().__init__()
        self._path = path
        self._text = text
        self._drops_nothing = is_infinite_craft(text)
        left = right = 0
        for number, sides in self._parted():
            left += "+" in sides.left
            right += "+" in sides.right
            if sides.is_backward and "+" in sides.left:
                seen = f"line {number}, whose arrow points at a sum of ingredients"
                raise refusal(path, seen, "lines")
        if left and right:
            raise refusal(path, "lines with sums on either side of the sign, or on both", "lines")
        self._sum_is_left = left >= right
        self.columns = ("sum", "result") if self._sum_is_left else ("sum", "result before it")
        self._ingredients = self._known_ingredients()
        self._check_ends()

    def _parted(self) -> Iterator[tuple[int, _Sides]]:
        for number, line in enumerate(io.StringIO(self._text, newline=""), start=1):
            sides = None if _is_heading(line) else _sides(line)
            if sides is not None:
                yield number, sides

    def _known_ingredients(self) -> frozenset[str]:
        """Return the ingredients of sums with a comma: such a comma does not part results."""
        parts: set[str] = set()
        for _, sides in self._parted():
            total, _ = self._sum_and_result(sides)
            if "," in total:
                parts.update(_summands(total))
        return frozenset(parts)

    def _sum_and_result(self, sides: _Sides) -> tuple[str, str]:
        if self._sum_is_left:
            return sides.left, sides.right
        return sides.right, sides.left

    def _check_ends(self) -> None:
        """Refuse lines that often begin or end with what other labels do not have.

        Raises:
            RecipeFileError: naming the beginning or the end, such as "Step 1: " or " (new!)".
        """
        firsts: list[str] = []
        lasts: list[str] = []
        after: list[str] = []
        before: list[str] = []
        for _, sides in islice(self._parted(), _JUDGED_LINES):
            labels = [*_summands(sides.left), *_summands(sides.right)]
            firsts.append(labels[0])
            lasts.append(labels[-1])
            after += labels[1:]
            before += labels[:-1]
        # A mark of lines stands at their first labels alone; part of a label also at others.
        for where, pattern, ends, others in (
            ("begin", _PREFIX, firsts, after),
            ("end", _SUFFIX, lasts, before),
        ):
            often = _often(pattern, ends, others)
            if often is not None:
                raise refusal(
                    self._path,
                    f"many lines {where} as with {often.strip()[:40]!r}, which may be a mark or "
                    "part of a label",
                    "lines",
                    "Remove it from the lines.",
                )

    def __iter__(self) -> Iterator[Entry]:
        """Yield recipes, lines that are none, and headings."""
        for number, line in enumerate(io.StringIO(self._text, newline=""), start=1):
            if not line.strip():
                continue
            if is_directive(line):
                fault = read_directive(self, number, line)
                if fault is not None:
                    yield fault
            elif _is_heading(line):
                yield LeftOut(number, "headings or comments")
            elif len(line) > _LIMIT:
                message = f"a line of {len(line):,} characters; the limit is {_LIMIT:,}."
                yield Fault(number, "row", message, "long")
            else:
                yield from self._recipes(number, line)

    def _recipes(self, number: int, line: str) -> Iterator[Entry]:
        sides = _sides(line)
        if sides is None:
            message = (
                f"{line.strip()[:80]!r} has no sign such as = or ->, or several; expected "
                "a + b = c."
            )
            yield Fault(number, "row", message, "no sign")
            return
        total, rest = self._sum_and_result(sides)
        if self._sum_is_left:
            if "," in rest and rest in self._ingredients:
                message = f"{rest[:80]!r} may be several results, or one: an ingredient elsewhere."
                yield Fault(number, "row", message, "comma")
                return
            pairs = [(_summands(total), _unwrapped(result)) for result in rest.split(",")]
            self.several_outputs += len(pairs) > 1
        else:
            # Each part between commas makes the same result.
            pairs = [(_summands(part), _unwrapped(rest)) for part in total.split(",")]
        for ingredients, result in pairs:
            labels = [*ingredients, result]
            # Each fault once, in the order of the labels.
            faults = dict.fromkeys(filter(None, map(_label_fault, labels)))
            message = alternatives(ingredients) or " Also, ".join(faults)
            if message:
                yield Fault(number, "label", message)
            elif self._drops_nothing and NOTHING in labels:
                is_result = result == NOTHING
                yield LeftOut(number, WITH_NOTHING if is_result else FROM_NOTHING)
            else:
                yield number, labels


def _often(pattern: re.Pattern[str], ends: Sequence[str], others: Sequence[str]) -> str | None:
    """Return what the pattern finds in many of the labels at an end, and seldom in the others.

    Numbers count as equal.

    Args:
        pattern: ``_PREFIX`` or ``_SUFFIX``.
        ends: first or last label of each line.
        others: all other labels.

    Returns:
        The first such mark; None without one.
    """
    marks = _marks_in(ends, pattern)
    in_others = _marks_in(others, pattern)
    if len(in_others) > _MOSTLY * len(others):
        return None  # labels of this file begin or end so, such as with an emoji each
    elsewhere = Counter(map(_without_digits, in_others))
    # The most frequent mark alone: a loop of one round, or of none without marks.
    for shape, number in Counter(map(_without_digits, marks)).most_common(1):
        share = number / len(ends)
        # As many as there would be if the mark were part of labels, and a tenth of these.
        expected_elsewhere = share * len(others)
        is_seldom = elsewhere[shape] <= _SELDOM * expected_elsewhere
        if share >= _OFTEN and is_seldom:
            return next(mark for mark in marks if _without_digits(mark) == shape)
    return None


def _marks_in(labels: Sequence[str], pattern: re.Pattern[str]) -> list[str]:
    """Return what a pattern finds at the beginnings, or at the ends, of labels."""
    search = pattern.match if pattern is _PREFIX else pattern.search
    marks = []
    for found in map(search, labels):
        # A label that is a sign as a whole, such as an emoji, has no mark.
        if found and found[0] != found.string:
            marks.append(found[0])
    return marks


def _without_digits(text: str) -> str:
    return re.sub(r"\d+", "0", text)


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
    if not _HEADING.match(line):
        return False
    return bool(_COMMENT.match(line)) or not _is_recipe(line)


def _is_recipe(line: str) -> bool:
    sides = _sides(line)
    return sides is not None and ("+" in sides.left or "+" in sides.right)


def _sides(line: str) -> _Sides | None:
    """Return what stands left and right of a line's sign, or None without exactly one sign."""
    content = line.translate(_WIDE_SIGNS).strip()
    for _ in range(_MOST_MARKS):
        mark = _MARK.match(content)
        content = content[mark.end() :] if mark else content
    content = _END_MARK.sub("", content)
    for sign in _SIGNS:
        found = list(islice(sign.finditer(content), 2))
        if not found:
            continue
        first = found[0]
        left = content[: first.start()].strip()
        right = content[first.end() :].strip()
        # A sign at an end is a mark; a less certain sign may part the line.
        if not left or not right:
            continue
        if len(found) > 1:
            return None
        is_backward = bool(_IS_BACKWARD.match(first[0]))
        return _Sides(_unwrapped(left), _unwrapped(right), is_backward)
    return None


def _summands(text: str) -> list[str]:
    """Return the parts of a sum; a plus without spaces is part of a label if there is one with."""
    sign = " + " if " + " in text else "+"
    parts = text.split(sign)
    return [_unwrapped(part) for part in parts]


def _unwrapped(text: str) -> str:
    """Return a text without quotes or markup around all of it."""
    text = text.strip()
    for start, end in _WRAPPERS:
        if not text.startswith(start) or not text.endswith(end):
            continue
        inner = text[len(start) : -len(end)]
        # A link with two names, or two quoted labels, stay as they are, and are refused.
        has_sign = start in inner or end in inner or "|" in inner
        if inner.strip() and not has_sign:
            return inner.strip()
    return text
