"""Remarks about labels that may be something else: missing values, numbers of pieces, marks, HTML."""

import re
from collections.abc import Collection

from wordcraft_kg.base.wording import counted
from wordcraft_kg.graphs.book_files.cells import count_in
from wordcraft_kg.graphs.book_files.rows import NOTHING, is_missing

_CLEAR = 0.2  # share of the labels with numbers that is worth a remark
_MARK = re.compile(
    r"^(?:[*†‡✓✔☆★⭐✅]+\ufe0f?)\s*(?=\S)|^\d+[.)]\s*(?=[^\W\d])|(?<=\S)\s*(?:[*†‡✓✔☆★⭐🆕✅]+\ufe0f?|\[\d+\])$"
)
"""What lists put before or behind a label: stars, ticks, numbers of footnotes."""
_WEAK_MARK = re.compile(r"(?<=\w)\s*(?:[!?]+|\((?:new|new!|first|wip)\))$", re.IGNORECASE)
"""Marks that are also usual parts of labels, unless the label without them exists, too."""
HTML_ENTITY = re.compile(r"&(?:#\d+|#x[0-9a-fA-F]+|[A-Za-z]\w+);")


def notes_about(labels: Collection[str]) -> list[str]:
    """Return remarks about labels that may be something else, for the line about the file."""
    return [
        *note_of_missing(labels),
        *note_of_numbers(labels),
        *note_of_marks(labels),
        *_note_of_html(labels),
    ]


def note_of_missing(labels: Collection[str]) -> list[str]:
    """Return a remark, or none, about labels that often stand for nothing, such as NA."""
    kept = sorted(label for label in labels if label == NOTHING or is_missing(label))
    if not kept:
        return []
    names = ", ".join(map(_quoted, kept))
    noun = "an entity" if len(kept) == 1 else "entities"
    return [f"{names} kept as {noun}"]


def note_of_numbers(labels: Collection[str]) -> list[str]:
    """Return a remark, or none, about numbers of pieces that may be in labels.

    One label is enough if it stands beside the label without the number.
    """
    known = set(labels)
    numbered = []
    beside = []
    for label in labels:
        found = count_in(label)
        if found:
            numbered.append(label)
            if found[0] in known:
                beside.append(label)
    if not beside and len(numbered) <= _CLEAR * len(known):
        return []
    example = _quoted(min(beside or numbered))
    also = " beside the label without it" if beside else ""
    return [
        f"{counted(len(numbered), 'label')} with numbers, such as {example}{also}; numbers of "
        "pieces are no part of a label"
    ]


def note_of_marks(labels: Collection[str]) -> list[str]:
    """Return a remark, or none, about labels with marks of lists, such as a star."""
    known = set(labels)
    marked = sorted(label for label in labels if _has_mark(label, known))
    if not marked:
        return []
    return [
        f"{counted(len(marked), 'label')} with a mark, such as {_quoted(marked[0])}; remove it if "
        "it is no part of the label"
    ]


def _has_mark(label: str, known: Collection[str]) -> bool:
    # Most labels begin with a letter and end in one, and need no pattern.
    if label[0].isalpha() and label[-1].isalpha():
        return False
    bare = _MARK.sub("", label)
    if bare != label:
        return any(char.isalnum() for char in bare)
    bare = _WEAK_MARK.sub("", label)
    return bare != label and bare in known


def _note_of_html(labels: Collection[str]) -> list[str]:
    html = [label for label in labels if "&" in label and HTML_ENTITY.search(label)]
    if not html:
        return []
    return [f"{len(html):,} labels with HTML entities, such as {html[0][:60]!r}"]


def _quoted(label: str) -> str:
    return f"'{label[:60]}'"
