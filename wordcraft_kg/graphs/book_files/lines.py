"""Lines such as ``water + earth = mud``, as in forums and chats; several results by commas.

Either side of the sign may hold the sum: ``mud = water + earth, clay + rain`` gives two recipes.
"""

import io
import re
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from wordcraft_kg.graphs.book_files.guide import refusal
from wordcraft_kg.graphs.book_files.rows import Entry, Fault, LeftOut, RowSource
from wordcraft_kg.graphs.recipes import label_fault

_SIGNS = (" => ", " -> ", " → ", " ⇒ ", " = ", " : ", "=>", "->", "→", "⇒", "=", ":")
"""Signs between ingredients and results, the more certain ones first."""
_BULLET = re.compile(r"\s*(?:[-*•–]\s+|\(?\d+[.)]\s+)?")
_HEADING = re.compile(r"\s*(?:#|//|={2,}|-{2,}|\*{2,})")
_LIMIT = 100_000  # characters in a line
_ENOUGH = 0.5  # share of the lines that are recipes, in a file of this shape


class _Sides(NamedTuple):
    """A line's two sides of the sign."""

    left: str
    right: str


def looks_like_lines(lines: list[str]) -> bool:
    """Return whether most lines, which are not blank, have a sum and a sign."""
    content = [line for line in lines if not _HEADING.match(line)]
    parted = [_sides(line[:_LIMIT]) for line in content]
    sums = [sides for sides in parted if sides and ("+" in sides.left or "+" in sides.right)]
    return bool(content) and len(sums) >= _ENOUGH * len(content)


class SumLines(RowSource):
    """A text with a sum on each line."""

    shape = "lines a + b = c"

    def __init__(self, path: Path, text: str):
        """Find on which side the sums are.

        Raises:
            RecipeFileError: if they are on both sides.
        """
        super().__init__()
        self._path, self._text = path, text
        left = right = 0
        for _, sides in self._parted():
            left += "+" in sides.left
            right += "+" in sides.right
        if left and right:
            raise refusal(path, "lines with sums on either side of the sign, or on both", "lines")
        self._sum_is_left = left >= right
        self.columns = ("sum", "result") if self._sum_is_left else ("sum", "result before it")
        self._ingredients = self._known_ingredients()

    def _parted(self) -> Iterator[tuple[int, _Sides]]:
        for number, line in enumerate(io.StringIO(self._text, newline=""), start=1):
            sides = None if _HEADING.match(line) else _sides(line)
            if sides is not None:
                yield number, sides

    def _known_ingredients(self) -> frozenset[str]:
        """Ingredients with a comma, which tell that a comma does not part results."""
        sums = (sides.left if self._sum_is_left else sides.right for _, sides in self._parted())
        return frozenset(part for each in sums if "," in each for part in _summands(each))

    def __iter__(self) -> Iterator[Entry]:
        """Yield recipes, lines that are none, and headings."""
        for number, line in enumerate(io.StringIO(self._text, newline=""), start=1):
            if not line.strip():
                continue
            if _HEADING.match(line):
                yield LeftOut(number, "headings or comments")
            elif len(line) > _LIMIT:
                message = f"a line of {len(line):,} characters; the limit is {_LIMIT:,}."
                yield Fault(number, "row", message, "long")
            else:
                yield from self._recipes(number, line)

    def _recipes(self, number: int, line: str) -> Iterator[Entry]:
        sides = _sides(line)
        if sides is None:
            message = f"{line.strip()[:80]!r} has no sign such as = or ->; expected a + b = c."
            yield Fault(number, "row", message, "no sign")
            return
        total, rest = sides if self._sum_is_left else (sides.right, sides.left)
        if self._sum_is_left:
            if "," in rest and rest in self._ingredients:
                message = f"{rest[:80]!r} may be several results, or one: an ingredient elsewhere."
                yield Fault(number, "row", message, "comma")
                return
            pairs = [(_summands(total), result.strip()) for result in rest.split(",")]
            self.several_outputs += len(pairs) > 1
        else:
            # Each part between commas makes the same result.
            pairs = [(_summands(part), rest.strip()) for part in total.split(",")]
        for ingredients, result in pairs:
            faults = list(dict.fromkeys(filter(None, map(label_fault, [*ingredients, result]))))
            if faults:
                yield Fault(number, "label", " Also, ".join(faults))
            else:
                yield number, [*ingredients, result]


def _sides(line: str) -> _Sides | None:
    """Return what stands left and right of a line's sign, or None without exactly one sign."""
    content = line.strip()
    bullet = _BULLET.match(content)
    content = content[bullet.end() :] if bullet else content
    for sign in _SIGNS:
        left, found, right = content.partition(sign)
        if found and left.strip() and right.strip():
            return None if sign in right else _Sides(left.strip(), right.strip())
    return None


def _summands(text: str) -> list[str]:
    """Return the parts of a sum; a plus without spaces is part of a label if there is one with."""
    return [part.strip() for part in text.split(" + " if " + " in text else "+")]
