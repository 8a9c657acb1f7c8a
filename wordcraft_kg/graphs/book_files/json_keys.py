"""What the keys of JSON objects stand for: labels, properties of things, or several labels."""

import ast
import json
from collections.abc import Collection, Iterable, Mapping, Sequence
from itertools import islice
from pathlib import Path
from typing import Any

from wordcraft_kg.graphs.book_files.columns import names_ingredient, names_property
from wordcraft_kg.graphs.book_files.guide import refusal

LOOKED_AT = 1_000
"""Entries by which a shape is judged."""
_FEW = 3  # objects by which a common key is told from an ingredient
_MAX_KEY = 4_000  # characters of a key that may be a list; a label has at most 1,000
_SIGNS = (",", ";", "|", "/", "&")


def first_keys(rows: Iterable[Mapping[str, Any]]) -> list[str]:
    """Return the different keys of the first objects, in the order of the file."""
    # A dict keeps the order, which a set would not.
    keys: dict[str, None] = {}
    for row in islice(rows, LOOKED_AT):
        keys |= dict.fromkeys(row)
    return list(keys)


def property_keys(rows: Iterable[Mapping[str, Any]], labels: Collection[str]) -> list[str]:
    """Return keys that may be properties of things rather than ingredients; empty without any.

    Every object has a key with the name of a property, such as ``emoji``, or all objects share a
    key that stands nowhere else. Two objects must have the same keys: one common partner of two
    ingredients is usual.

    Args:
        rows: the objects; empty ones do not count.
        labels: labels of the file, which are no properties.
    """
    filled = [row for row in rows if row]
    if not filled:
        return []
    unlabelled = [key for key in first_keys(filled) if key not in labels]
    named = list(filter(names_property, unlabelled))
    if named and not any(row.keys().isdisjoint(named) for row in filled):
        return named
    first = filled[0]
    is_alike = all(row.keys() == first.keys() for row in filled)
    # Different objects share a key more easily by chance than equal ones.
    fewest = 2 if is_alike else _FEW
    if len(filled) < fewest:
        return []
    common = set(first).intersection(*filled).difference(labels)
    return [key for key in first if key in common]


def pair_keys(value: Mapping[str, Any]) -> list[str]:
    """Return the keys of an object's ingredients, such as ``a`` and ``b``; empty without two."""
    keys = []
    for key, each in value.items():
        is_bool = isinstance(each, bool)  # to Python, an integer
        may_be_label = isinstance(each, (str, int, dict)) and not is_bool
        if may_be_label and names_ingredient(key):
            keys.append(key)
    return keys if len(keys) > 1 else []


def listed_parts(key: str) -> list[str] | None:
    """Return the labels in a key that is a list, as Python or JSON writes it; None for another.

    Example:
        >>> listed_parts("('water', 'earth')"), listed_parts('["water", "earth"]')
        (['water', 'earth'], ['water', 'earth'])
    """
    brackets = key[:1] + key[-1:]
    if brackets not in ("()", "[]") or len(key) > _MAX_KEY:
        return None
    try:
        # `literal_eval` reads values alone and runs nothing; deep nesting may exhaust its stack.
        parts = json.loads(key) if key.startswith("[") else ast.literal_eval(key)
    except (ValueError, SyntaxError, RecursionError, MemoryError):
        return None
    if not isinstance(parts, (list, tuple)) or len(parts) < 2:
        return None
    are_labels = all(isinstance(part, str) for part in parts)
    return list(parts) if are_labels else None


def common_sign(values: Sequence[Any]) -> str:
    """Return a sign such as a comma that parts every text in recipes of texts; empty without one.

    Such a text may be a label, or several ingredients.

    Args:
        values: texts, or lists of texts.
    """
    texts: list[Any] = []
    for value in islice(values, LOOKED_AT):
        texts += value if isinstance(value, list) else [value]
    if not texts or not all(isinstance(text, str) for text in texts):
        return ""
    for sign in _SIGNS:
        # Between other characters: a sign at an end parts nothing.
        if all(sign in text[1:-1] for text in texts):
            return sign
    return ""


def refuse_joined(path: Path, values: Sequence[Any]) -> None:
    """Refuse texts that all hold a sign such as a comma: they may be labels or pairs.

    Args:
        path: the file, for errors.
        values: texts, or lists of texts; empty ones do not count.

    Raises:
        RecipeFileError: with both readings of the first text.
    """
    filled = [value for value in values if value]
    sign = common_sign(filled)
    if not sign:
        return
    first = filled[0]
    text = first[0] if isinstance(first, list) else first
    labels = " + ".join(label.strip() for label in text.split(sign))
    raise refusal(
        path,
        f"every ingredient holds {sign!r}: {text[:60]!r} may be one label, or {labels[:60]}",
        "json",
        'Write pairs as lists, such as ["water", "earth"].',
    )
