"""Remarks about labels that may be something else: missing values, numbers, marks."""

import re
from collections.abc import Collection

from wordcraft_kg.base.wording import counted

NOTHING = "Nothing"
"""Result of pairs that make nothing in Infinite Craft."""
_MISSING = frozenset({"NA", "N/A", "n/a", "<NA>", "nan", "NaN", "NULL", "null", "None", "-", "--"})
_NUMBER = r"(?P<number>\d{1,3})"  # four digits are rather a year
_LABEL = r"(?P<label>[^\W\d].*|\W*[^\W\d].*)"
_COUNTS = tuple(
    re.compile(pattern)
    for pattern in (
        rf"{_NUMBER}\s*[x×*]?\s+{_LABEL}",  # 2 water, 2x water
        rf"[x×]\s?{_NUMBER}\s+{_LABEL}",  # x2 water
        rf"{_LABEL}(?:\s+x\s?|\s*[×*]\s?){_NUMBER}",  # water x2, water*2
        rf"{_LABEL}\s*\(\s*[x×]?\s?{_NUMBER}\s?[x×]?\s*\)",  # water (2), water (x2)
    )
)
_CLEAR = 0.2  # share of the labels with numbers that is worth a remark
_MARK = re.compile(
    r"^(?:[*†‡✓✔☆★⭐✅]+\ufe0f?)\s*(?=\S)|^\d+[.)]\s*(?=[^\W\d])|(?<=\S)\s*(?:[*†‡✓✔☆★⭐🆕✅]+\ufe0f?|\[\d+\])$"
)
"""What lists put before or behind a label: stars, ticks, numbers of footnotes."""
HTML_ENTITY = re.compile(r"&(?:#\d+|#x[0-9a-fA-F]+|[A-Za-z]\w+);")


def is_missing(cell: str) -> bool:
    """Return whether a cell is what programs write for an empty one."""
    return cell in _MISSING


def count_in(cell: str) -> tuple[str, int] | None:
    """Return the label and the number of pieces in a cell, or None without a number.

    Example:
        >>> count_in("2 water"), count_in("water x2"), count_in("water (2)"), count_in("H2")
        (('water', 2), ('water', 2), ('water', 2), None)
    """
    # Most cells hold no digit, and need no pattern.
    if not any(char.isdigit() for char in cell):
        return None
    for pattern in _COUNTS:
        match = pattern.fullmatch(cell)
        if match:
            return match["label"].strip(), int(match["number"])
    return None


def notes_about(labels: Collection[str]) -> list[str]:
    """Return remarks about labels that may be something else, for the line about the file."""
    return [
        *note_of_missing(labels),
        *note_of_numbers(labels),
        *note_of_marks(labels),
    ]


def note_of_missing(labels: Collection[str]) -> list[str]:
    """Return a remark, or none, about labels that often stand for nothing, such as NA."""
    missing_like_labels = sorted(label for label in labels if label == NOTHING or is_missing(label))
    if not missing_like_labels:
        return []
    names = ", ".join(map(_quoted, missing_like_labels))
    noun = "an entity" if len(missing_like_labels) == 1 else "entities"
    return [f"{names} kept as {noun}"]


def note_of_numbers(labels: Collection[str]) -> list[str]:
    """Return a remark, or none, about numbers of pieces that may be in labels.

    One label is enough if it stands beside the label without the number.
    """
    label_set = set(labels)
    numbered = []
    beside = []
    for label in labels:
        counted_label = count_in(label)
        if counted_label:
            numbered.append(label)
            if counted_label[0] in label_set:
                beside.append(label)
    if not beside and len(numbered) <= _CLEAR * len(label_set):
        return []
    example = _quoted(min(beside or numbered))
    also = " beside the label without it" if beside else ""
    return [
        f"{counted(len(numbered), 'label')} with numbers, such as {example}{also}; numbers of "
        "pieces are no part of a label"
    ]


def note_of_marks(labels: Collection[str]) -> list[str]:
    """Return a remark, or none, about labels with marks of lists, such as a star."""
    marked = sorted(filter(_has_mark, labels))
    if not marked:
        return []
    return [
        f"{counted(len(marked), 'label')} with a mark, such as {_quoted(marked[0])}; remove it if "
        "it is no part of the label"
    ]


def _has_mark(label: str) -> bool:
    # Most labels begin with a letter and end in one, and need no pattern.
    if label[0].isalpha() and label[-1].isalpha():
        return False
    bare = _MARK.sub("", label)
    return bare != label and any(map(str.isalnum, bare))


def _quoted(label: str) -> str:
    return f"'{label[:60]}'"
