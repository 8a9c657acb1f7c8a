"""What cells hold beside labels, in forms that no reader takes off: it must not stay in labels.

A few such cells may be labels: of a game, or of Infinite Craft, whose players name anything. Where
many ingredients have them, the file is refused.
"""

import re
from collections import Counter
from collections.abc import Sequence

from wordcraft_kg.graphs.book_files.cells import Cells
from wordcraft_kg.graphs.book_files.rows import Row

_OFTEN = 0.2  # share of the cells
_FEWEST = 2  # results by which labels with and without marks are the same
_FORMS = {
    "a number of pieces": re.compile(
        r"\d+(?:[.,]\d+)?[x×*][^\W\d].*"  # 25xCopper
        r"|.*[^\W\d]\)?\s*x\d{1,3} \(.+\)"  # Iron x10 (+5 per level)
        r"|(?:.*\s)?\d+\s?(?:pcs|pieces|kg|ml|cl|tbsp|tsp)\b.*",  # 3 pcs
        re.DOTALL,
    ),
    "a number": re.compile(
        r"\d+-[^\W\d].*"  # 2-Iron
        r"|.*[^\W\d]\s*:\s?\d{1,3}"  # metal: 2
        r"|.*[^\W\d_a-zA-Z]\d{1,3}"  # 冰心2; H2 is a formula
        r"|.*\(\d{1,3}\)",  # egg (2), if it is not read as a number of pieces
        re.DOTALL,
    ),
    "a choice": re.compile(r".+(?: or |[^\W\d]/[^\W\d]|\((?:any|or)\b).*"),
    "the sign of a recipe": re.compile(r".*\w\s?(?:=|[-=]>|→)\s?\w.*"),
    "an address": re.compile(r".*https?://.*"),
    "markup": re.compile(
        r".*(?:<(?:br|img|a|b|i|span|p)\b[^>]*>|!\[|\[\[|(?:File|Image):\S+ |^:\w+:).*", re.DOTALL
    ),
}
_IN_NAMES = ("a number", "a choice", "the sign of a recipe")
"""Forms that are part of names if results have them as well, such as = in formulas."""
_MARKS = re.compile(r"<[^>]*>|[^\w\s]|[\d_]")
"""What is no letter."""


def odd_label(rows: Sequence[Row]) -> str:
    """Return what many labels hold beside a name, with an example; empty without such labels.

    Args:
        rows: the recipes as the file has them.
    """
    cells = Cells(rows)
    ingredients: Counter[str] = Counter()
    results: Counter[str] = Counter()
    for row in rows:
        ingredients.update(row.ingredients)
        results[row.result] += 1
    # As they will be read.
    ingredients = _labels(cells, ingredients)
    results = _labels(cells, results)
    for form, pattern in _FORMS.items():
        odd = [_often(pattern, labels) for labels in (ingredients, results)]
        is_in_names = bool(odd[1]) and form in _IN_NAMES
        if any(odd) and not is_in_names:
            return f"{(odd[0] or odd[1])[:80]!r} holds {form}"
    return _other_marks(ingredients, results)


def _often(pattern: re.Pattern[str], labels: Counter[str]) -> str:
    """Return a label that a pattern matches, if it matches many of them; else an empty text."""
    odd = {label: number for label, number in labels.items() if pattern.fullmatch(label)}
    return next(iter(odd), "") if sum(odd.values()) >= _OFTEN * labels.total() else ""


def _labels(cells: Cells, counts: Counter[str]) -> Counter[str]:
    labels: Counter[str] = Counter()
    for cell, number in counts.items():
        label, _ = cells.counted_label(cell)
        labels[label] += number
    return labels


def _other_marks(ingredients: Counter[str], results: Counter[str]) -> str:
    """Return what is odd if results are ingredients only without their numbers or signs."""
    if not ingredients.keys().isdisjoint(results):
        return ""
    bare = {_letters(cell): cell for cell in ingredients}
    same = {cell: bare[_letters(cell)] for cell in results if _letters(cell) in bare}
    same.pop("", None)
    if len(same) >= max(_FEWEST, _OFTEN * len(results)):
        result, ingredient = next(iter(same.items()))
        return f"{ingredient[:80]!r} may be the ingredient {result[:80]!r}, with other signs"
    signs = [cell for cell in results if not any(map(str.isalnum, cell))]
    if len(signs) > len(results) / 2 and any(bare):
        return f"{signs[0][:80]!r} is a sign, and ingredients are words"
    return ""


def _letters(cell: str) -> str:
    return " ".join(_MARKS.sub(" ", cell).split())
