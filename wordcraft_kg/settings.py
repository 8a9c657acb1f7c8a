"""Checking settings: one idiom for all, with errors that name the setting.

An error names a setting in backticks, as Python spells it: `learning_rate` -1: expected a number above 0. The command
line replaces that name by its option, ``--learning-rate``.
"""

import difflib
import operator
from collections.abc import Iterable, Sequence
from typing import Any

from wordcraft_kg.errors import ConfigError

LARGEST = 3e38
"""What torch multiplies with is of 32 bits."""


def refuse(name: str, value: Any, expected: str, hint: str = "") -> ConfigError:
    """Return the error for a setting's value: what was found, and what was expected."""
    return ConfigError(f"`{name}` {value!r}: expected {expected}.{hint}")


def require(config: Any, name: str, holds: bool, expected: str) -> None:
    """Check one setting of a configuration.

    Raises:
        ConfigError: naming the setting, its value and what was expected.
    """
    if not holds:
        raise refuse(name, getattr(config, name), expected)


def whole(name: str, value: Any, low: int, high: int | None = None) -> int:
    """Return a whole number of any integer type.

    Raises:
        ConfigError: if it is not one, or outside its range.
    """
    try:
        number = operator.index(value)
    except TypeError:
        number = low - 1
    if isinstance(value, bool) or number < low or (high is not None and number > high):
        raise refuse(
            name, value, f"a whole number, {low} or more" if high is None else f"a whole number, {low} to {high}"
        )
    return number


def positive(name: str, value: Any) -> float:
    """Return a number above 0 that a 32-bit float can hold.

    Raises:
        ConfigError: if it is not one.
    """
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0 < value < LARGEST:
        raise refuse(name, value, "a number above 0")
    return float(value)


def one_of(name: str, value: Any, allowed: Sequence[str]) -> None:
    """Check a choice.

    Raises:
        ConfigError: naming the choices, with the nearest ones.
    """
    if value not in allowed:
        hint = nearest(value, allowed) if isinstance(value, str) else ""
        raise refuse(name, value, f"one of {', '.join(allowed)}", hint)


def nearest(label: str, known: Iterable[str], limit: int = 3) -> str:
    """Return " Did you mean 'a', 'b'?" for the labels closest to ``label``, or "" when none is close."""
    matches = difflib.get_close_matches(label, list(known), n=limit, cutoff=0.6)
    return f" Did you mean {', '.join(repr(m) for m in matches)}?" if matches else ""
