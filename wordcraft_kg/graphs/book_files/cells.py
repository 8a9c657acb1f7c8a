"""The labels in cells: pieces of a cell, and the label that each text of a file stands for.

Each different text is judged once, for all rows: characters at its ends that cannot be seen are
left out. What still looks like more than a label is a fault.
"""

import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import chain
from typing import Any

from wordcraft_kg.graphs.book_files.rows import (
    WITHOUT,
    Entry,
    LeftOut,
    Raw,
    Row,
    fault_at,
)
from wordcraft_kg.graphs.book_files.words import label_key
from wordcraft_kg.graphs.recipes import count_in, is_missing, label_fault, shown

UNSEEN = "".join(
    (
        " \u00a0\u1680\u2000\u2001\u2002\u2003\u2004\u2005\u2006\u2007\u2008\u2009\u200a\u202f",
        "\u205f\u3000",  # blanks of other widths
        "\u200b\u200c\u200d\u2060\ufeff\u00ad",  # of no width, and a hyphen that is not shown
        "\u200e\u200f\u202a\u202b\u202c\u202d\u202e\u2066\u2067\u2068\u2069",  # directions
    )
)
"""Characters at the ends of a cell that cannot be seen, and are no part of a label."""
NUMBER = "\x01"
"""Before a number of JSON, which is a label only if the user names its path; no label holds it."""
_OWN_NAMES = "ingredient_a,ingredient_b,result"
_WITHOUT_BRACKETS = (
    "leave its brackets out; of labels in quotes, in Python "
    """table["ingredients"].map(lambda cell: ";".join(ast.literal_eval(cell)))."""
)
OWN_COLUMNS = (
    "Write each ingredient in a column of its own, as in ingredient_a,ingredient_b,ingredient_c,"
    "result, and one recipe in each row."
)
"""Remedy for a cell with several things."""

# --- several labels in one cell ------------------------------------------------------------------

JOINERS = (" + ", "+", ";", "|", "\n", "<br>", ",", "、", "，")
"""Signs between ingredients in one cell, the more certain ones first; cells without are single."""
_SIGNS_IN_LABELS = (
    " and ",
    " & ",
    "&",
    " x ",
    " × ",
    "×",
    " X ",
    " und ",
    " et ",
    " y ",
    "/",
    " - ",
)
"""Signs that labels hold as well; cells that all have one are not read."""
_OFTEN = 0.5  # share of the cells with a joiner
_MOST_WITHOUT_GRID = 3  # ingredients; more may be the slots of a crafting grid
_LISTED = re.compile(r"\s*[\[({].*[\])}]\s*", re.DOTALL)
_QUOTED_LIST = re.compile(r"\s*[\[({]\s*[\"'].*[\])}]\s*", re.DOTALL)
_ALTERNATIVE = re.compile(r"[;|]| or | / |<br\s*/?>|, ", re.IGNORECASE)
_FIGURE = re.compile(rf"{NUMBER}?[-+]?\d*[.,]?\d+(?:[eE][-+]?\d+)?%?")


def is_number(value: Any) -> bool:
    """Return whether a value is a number, or a text of one."""
    if isinstance(value, str):
        return bool(_FIGURE.fullmatch(value.strip()))
    return isinstance(value, int | float) and not isinstance(value, bool)


def labels_in(value: Any, beside: dict[str, list[Any]]) -> list[str] | None:
    """Return the labels in a value of JSON: a text, a list, or an object with a name.

    Args:
        value: such as "egg", or ["egg", {"name": "flour", "amount": 2}].
        beside: gets the values of further keys in objects.

    Returns:
        The labels; None for a value whose labels no documented word names.
    """
    if value is None or value == "":
        return []
    if isinstance(value, str):
        return [value]
    if is_number(value):
        return [f"{NUMBER}{value}"]
    if isinstance(value, list):
        if _has_numbers_beside_names(value):
            return None
        parts = [None if isinstance(part, list) else labels_in(part, beside) for part in value]
        return None if None in parts else list(chain.from_iterable(filter(None, parts)))
    if not isinstance(value, dict) or any(isinstance(part, list | dict) for part in value.values()):
        return None
    name = label_key(tuple(value))
    if name is None:
        return None
    for key in value.keys() - {name}:
        beside.setdefault(key, []).append(value[key])
    return labels_in(value[name], beside)


def _has_numbers_beside_names(values: Iterable[Any]) -> bool:
    """Return whether some values are names and others numbers, such as a name and its pieces."""
    values = [value for value in values if isinstance(value, str) or is_number(value)]
    return 0 < sum(isinstance(value, str) for value in values) < len(values)


def find_joiner(cells: Sequence[str], *, in_all: bool = False) -> str | None:
    """Return the sign between ingredients in cells, or an empty text for single labels.

    Args:
        cells: texts that are not blank.
        in_all: whether a sign must be in each cell, as where each one of a list is a sum.

    Returns:
        None if a sign is in a few cells only, or one that labels hold as well is in all.
    """
    counts = {sign: sum(sign in cell for cell in cells) for sign in (*JOINERS, *_SIGNS_IN_LABELS)}
    everywhere = [sign for sign in counts if cells and counts[sign] == len(cells)]
    if everywhere:
        return everywhere[0] if everywhere[0] in JOINERS else None
    if in_all:
        return ""
    present = [sign for sign in JOINERS if counts[sign]]
    often = [sign for sign in present if counts[sign] >= _OFTEN * len(cells)]
    if often:
        return often[0]
    is_parted = bool(present) or any(
        counts[sign] > _OFTEN * len(cells) for sign in _SIGNS_IN_LABELS
    )
    return None if is_parted else ""


def ambiguity(ingredients: Sequence[str], joiner: str) -> str:
    """Return why it is not certain that the parts of a cell are one recipe's; empty if it is.

    Args:
        ingredients: parts between joiners, such as "water", "earth or rain", "dirt".
        joiner: the sign between them.
    """
    for part in ingredients:
        sign = _ALTERNATIVE.search(part)
        has_sum = joiner.strip() != "+" and " + " in part
        if has_sum or (sign and len(ingredients) > 2):
            between = "+" if sign is None else sign[0].strip()
            return (
                f"{part[:80]!r} in a sum of {len(ingredients)} may be the end of one recipe and "
                f"the start of another, with {between!r} between them; write one in each row."
            )
    return ""


class _UnsureError(Exception):
    """A row whose labels are not certain; the message says why."""


def _pieces(
    value: Any, joiner: str | None, beside: dict[str, list[Any]], *, is_alone: bool
) -> list[str]:
    """Return the texts in a cell or a value of JSON.

    Args:
        value: the cell or value.
        joiner: see :func:`find_joiner`.
        beside: gets the values of further keys in objects.
        is_alone: whether it holds all ingredients of its row.

    Raises:
        _UnsureError: if they are not certain.
    """
    labels = labels_in(value, beside)
    if labels is None:
        raise _UnsureError(f"{shown(value)} holds no label under a documented key.")
    if isinstance(value, list) and len(labels) > 1 and not is_alone:
        # A list in the place of one of several ingredients.
        raise _UnsureError(
            f"{shown(value)} may be choices of an ingredient or several ingredients; write each "
            "choice as a recipe of its own."
        )
    if not isinstance(value, str) or not value or joiner == "":
        return labels
    if _LISTED.fullmatch(value):
        raise _UnsureError(f"{value[:80]!r} is a list; {_WITHOUT_BRACKETS}")
    several = [part.strip() for part in value.split(joiner)] if joiner else [value]
    signs = (*JOINERS, *_SIGNS_IN_LABELS)
    if joiner is None or (len(several) == 1 and any(sign in value for sign in signs)):
        raise _UnsureError(
            f"{value[:80]!r} may be one ingredient or several; write {joiner or '+'} between."
        )
    reason = ambiguity(several, joiner)
    if reason:
        raise _UnsureError(reason)
    return several


def rows_of_raw(raw: Raw, joiner: str | None, beside: dict[str, list[Any]]) -> Iterator[Entry]:
    """Yield the recipes in a row, by the texts in its cells; a fault if they are not certain.

    Args:
        raw: the row.
        joiner: the sign between ingredients in one cell, see :func:`find_joiner`.
        beside: gets the values of further keys in objects.
    """
    try:
        # Spreadsheets leave blank all cells but the first of those that they merged. In a grid of
        # many slots blanks are usual.
        if raw.parts[:1] == [""] and any(raw.parts) and len(raw.parts) <= _MOST_WITHOUT_GRID:
            filled = next(filter(None, raw.parts))
            raise _UnsureError(
                f"a blank cell before {filled!r:.80}, as where cells were merged; fill it, or "
                "write a single ingredient first."
            )
        is_alone = len(raw.parts) == 1
        if not is_alone and _has_numbers_beside_names(raw.parts):
            raise _UnsureError(
                f"{shown(raw.parts)} has a number beside a name, which may be its number of pieces;"
                " name the names with --columns, such as '[].ingredients[][0],[].name'."
            )
        part_texts = [_pieces(value, joiner, beside, is_alone=is_alone) for value in raw.parts]
        result_texts = [_pieces(value, "", beside, is_alone=True) for value in raw.results]
    except _UnsureError as error:
        yield fault_at(raw.place, "label", str(error))
        return
    parts = list(chain.from_iterable(part_texts))
    results = list(chain.from_iterable(result_texts))
    if not parts or not results:
        yield LeftOut(raw.place, WITHOUT)
    else:
        yield from (Row(raw.place, parts, result, raw.kind, raw.quantities) for result in results)


# --- the label of a text -------------------------------------------------------------------------

_TIMES = re.compile(r"\d\s?[x×*]\s|(?:^|[\s(])[x×*]\s?\d|[×*]\s?\d+$")
"""A sign of multiplication beside a number."""
_WRAPPED = re.compile(
    r"“[^“”]+”|«[^«»]+»|„[^„“”]+[“”]|\*\*[^*]+\*\*|__[^_]+__|`[^`]+`"
    r"|\[\[[^\[\]|]+\]\]|\[[^\[\]]+\]\([^()\s]*\)|!\[.*|.*\(https?://[^\s()]*\)"
)
"""Quotes, markup of wikis and Markdown around a whole cell, and an image or address beside it."""
_FORMULA = re.compile(
    r"[=@]\s*[A-Z.]+\(|=\$?[A-Z]{1,3}\$?\d|#(?:REF|VALUE|NAME|DIV/0|NULL|NUM)[!?]|#N/A$"
)


def trim_unseen(cell: str) -> str:
    """Return a cell without characters at its ends that cannot be seen.

    A cell of nothing else is empty. A joiner of width zero within an emoji stays.
    """
    return cell.strip(" " if cell.isascii() else UNSEEN)


def exact_fault(label: str) -> str | None:
    """Return why a cell of our own table is no label, or None."""
    if label[:1] in ("=", "@", "#") and _FORMULA.match(label):
        return f"{label[:80]!r} is a spreadsheet's formula or its error; save the values."
    return label_fault(label)


def cell_fault(text: str) -> str | None:
    """Return why a text in JSON may be no label, or None."""
    if is_missing(text):
        return (
            f"{text!r} may be a missing value or a label. Leave the cell empty; if it is a "
            f"label, write a table with the columns {_OWN_NAMES}."
        )
    if _QUOTED_LIST.fullmatch(text):
        return f"{text[:80]!r} is a list; {_WITHOUT_BRACKETS}"
    if " + " in text:
        return (
            f"{text[:80]!r} may be several things or one. {OWN_COLUMNS} As one label, it needs a "
            f"table with the columns {_OWN_NAMES} alone."
        )
    return exact_fault(text)


def table_fault(text: str) -> str | None:
    """Return why a text in a table may be no label, or None; in JSON quotes belong to labels."""
    if _WRAPPED.fullmatch(text):
        return f"{text[:80]!r} has quotes or markup around a label, or an address beside it."
    return cell_fault(text)


def read_labels(
    entries: Sequence[Entry], fault: Callable[[str], str | None], *, is_given: bool = False
) -> tuple[list[Entry], int]:
    """Find the label of each text in the rows of a file.

    Args:
        entries: recipes by the texts in their cells, and other entries.
        fault: returns why a text is no label, or None.
        is_given: whether the user names the reading, so that numbers are labels.

    Returns:
        The entries, with recipes by labels or their faults, and the number of cells with characters
        at their ends that cannot be seen.
    """
    rows = [entry for entry in entries if isinstance(entry, Row)]
    uses = Counter(chain.from_iterable(row.ingredients for row in rows))
    uses.update(row.result for row in rows)
    label_of: dict[str, str] = {}
    faults: dict[str, str] = {}
    trimmed = 0
    for text, number in uses.items():
        name = text.removeprefix(NUMBER)
        label_of[text] = trim_unseen(name)
        trimmed += number * (label_of[text] != name)
        message = fault(label_of[text])
        if name != text and not is_given:
            message = f"{name[:80]!r} is a number; give names, or other columns with --columns."
        if message:
            faults[text] = message
    labelled: list[Entry] = []
    for entry in entries:
        if isinstance(entry, Row):
            texts = (*entry.ingredients, entry.result)
            messages = [faults[text] for text in texts if text in faults]
            if entry.kind:
                messages += filter(None, [label_fault(entry.kind)])
            if messages:
                message = " Also, ".join(dict.fromkeys(messages))
                entry = fault_at(entry.place, "label", message)
            else:
                *ingredients, result = map(label_of.__getitem__, texts)
                entry = entry._replace(ingredients=ingredients, result=result)
        labelled.append(entry)
    return labelled, trimmed


# --- labels in forms that are not read -----------------------------------------------------------

_MANY = 0.2  # share of the cells
_FEWEST = 2  # results by which labels with and without marks are the same
_FORMS = {
    "single quotes": re.compile(r"'.*'"),
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
        r".*(?:<(?:br|img|a|b|i|span|p)\b[^>]*>|!\[|\[\[|(?:File|Image):\S+ |^:\w+:|\]\().*"
        rf"|{_WRAPPED.pattern}",
        re.DOTALL,
    ),
    "a sum": re.compile(r"\S.*\S\+\S.*"),
}
_IN_NAMES = ("a number", "a choice", "the sign of a recipe", "a sum")
"""Forms that are part of names if results have them as well, such as = in formulas."""
_MARKS = re.compile(r"<[^>]*>|[^\w\s]|[\d_]")
"""What is no letter."""


def odd_label(rows: Sequence[Row]) -> str:
    """Return what many labels hold beside a name, with an example; empty without such labels.

    A few such cells may be labels: of a game, or of Infinite Craft, whose players name anything.

    Args:
        rows: the recipes.
    """
    ingredients = Counter(chain.from_iterable(row.ingredients for row in rows))
    results = Counter(row.result for row in rows)
    pieces = _pieces_in(ingredients, results)
    if pieces:
        return f"{pieces[:80]!r} holds a number of pieces"
    for form, pattern in _FORMS.items():
        odd = [_often(pattern, labels) for labels in (ingredients, results)]
        is_in_names = bool(odd[1]) and form in _IN_NAMES
        if any(odd) and not is_in_names:
            return f"{(odd[0] or odd[1])[:80]!r} holds {form}"
    if not ingredients.keys().isdisjoint(results):
        return ""
    # Results that are ingredients only without their numbers or signs.
    bare = {_letters(cell): cell for cell in ingredients}
    bare_matches = {cell: bare[_letters(cell)] for cell in results if _letters(cell) in bare}
    bare_matches.pop("", None)
    if len(bare_matches) >= max(_FEWEST, _MANY * len(results)):
        result, ingredient = next(iter(bare_matches.items()))
        return f"{ingredient[:80]!r} may be the ingredient {result[:80]!r}, with other signs"
    signs = [cell for cell in results if not any(map(str.isalnum, cell))]
    if len(signs) > len(results) / 2 and any(bare):
        return f"{signs[0][:80]!r} is a sign, and ingredients are words"
    return ""


def _pieces_in(*columns: Counter[str]) -> str:
    """Return a label with a number of pieces, if many cells of a column have one; else none.

    A number such as in 7 Up is part of a name: it has no sign, and no other number or none stands
    beside the same word.
    """
    counted_labels = {text: count_in(text) for text in set().union(*columns)}
    forms = Counter(label[0] if label else text for text, label in counted_labels.items())
    with_counts = {text: label for text, label in counted_labels.items() if label}
    is_clear = any(
        _TIMES.search(text) or forms[label] > 1 for text, (label, _) in with_counts.items()
    )
    for uses in columns:
        in_column = [text for text in uses if text in with_counts]
        if is_clear and sum(map(uses.__getitem__, in_column)) >= max(_MANY * uses.total(), 1):
            return in_column[0]
    return ""


def _often(pattern: re.Pattern[str], labels: Counter[str]) -> str:
    """Return a label that a pattern matches, if it matches many of them; else an empty text."""
    odd = {label: number for label, number in labels.items() if pattern.fullmatch(label)}
    return next(iter(odd), "") if sum(odd.values()) >= _MANY * labels.total() else ""


def _letters(cell: str) -> str:
    return " ".join(_MARKS.sub(" ", cell).split())
