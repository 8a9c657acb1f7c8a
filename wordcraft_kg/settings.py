"""Checking settings."""

import difflib
import operator
from collections.abc import Iterable
from typing import Any

from wordcraft_kg.errors import ConfigError


def whole(name: str, value: Any, low: int, high: int | None = None) -> int:
    """Return a whole number of any integer type.

    Raises:
        ConfigError: if it is none, or outside its range.
    """
    allowed = f"{low} or more" if high is None else f"{low} to {high}"
    try:
        number = operator.index(value)
    except TypeError:
        number = low - 1
    if isinstance(value, bool) or number < low or (high is not None and number > high):
        raise ConfigError(f"{name} {value!r}: expected a whole number, {allowed}.")
    return number


def nearest(label: str, known: Iterable[str], limit: int = 3) -> str:
    """Return " Did you mean 'a', 'b'?" for the labels closest to ``label``, or "" when none is close."""
    matches = difflib.get_close_matches(label, list(known), n=limit, cutoff=0.6)
    return f" Did you mean {', '.join(repr(m) for m in matches)}?" if matches else ""
