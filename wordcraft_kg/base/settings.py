"""Checking settings: one idiom for all, with errors that name the setting.

An error names a setting in backticks, as Python spells it: `learning_rate` -1: expected a number above 0. The command
line replaces that name by its option, ``--learning-rate``.
"""

import difflib
import operator
import os
from collections.abc import Iterable, Sequence
from typing import Any

from wordcraft_kg.base.errors import ConfigError

LARGEST = 3e38
"""What torch multiplies with is of 32 bits."""
SMALLEST = 1e-38
"""Smaller ones are 0 among 32-bit floats, or lose their digits."""
MOST = 2**63 - 1
"""Limit of seeds, and of counts that cost nothing but time."""
MAX_SIZE = 2**24
"""Limit of what is held in memory at once: batches, draws."""
MAX_DIM = 2**16
"""Limit of the dimensions of a vector."""
MAX_THREADS = 1_024


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
    """Return a whole number of any integer type; without ``high`` the limit is :data:`MOST`.

    Raises:
        ConfigError: if it is not one, or outside its range.
    """
    try:
        number = operator.index(value)
    except TypeError:
        number = low - 1
    limit = MOST if high is None else high
    if isinstance(value, bool) or not low <= number <= limit:
        # A limit that only keeps numbers within the machine is no news to who is below the range.
        is_open = number < low and limit >= MAX_DIM
        raise refuse(name, value, f"a whole number, {low} " + ("or more" if is_open else f"to {limit}"))
    return number


def number_in(name: str, value: Any, low: float, high: float, expected: str) -> None:
    """Check a number that is from ``low`` to ``high``, ends included; NaN is in no range, and a truth value no number.

    Raises:
        ConfigError: saying what was expected.
    """
    if isinstance(value, bool) or not isinstance(value, int | float) or not low <= value <= high:
        raise refuse(name, value, expected)


def positive(name: str, value: Any) -> float:
    """Return a number above 0 that a 32-bit float can hold.

    Raises:
        ConfigError: if it is not one.
    """
    if isinstance(value, bool) or not isinstance(value, int | float) or not SMALLEST <= value < LARGEST:
        raise refuse(name, value, "a number above 0")
    return float(value)


def check_memory(name: str, value: int, what: str, needed: int) -> None:
    """Refuse a size whose arrays do not fit into this machine's memory.

    Args:
        name: name of the setting.
        value: its value.
        what: what takes the memory.
        needed: bytes, at the least.

    Raises:
        ConfigError: saying what the size costs.
    """
    there = memory()
    if needed > there:
        raise ConfigError(
            f"`{name}` {value:,}: {what} would take {needed / 2**30:,.1f} GiB, and {there / 2**30:,.1f} GiB are there."
        )


def memory() -> int:
    """Return the bytes of memory that this process may use at most."""
    try:
        import resource

        there = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
        limit, _ = resource.getrlimit(resource.RLIMIT_AS)
    except (ImportError, ValueError, OSError):  # not a Unix
        return MOST
    return there if limit == resource.RLIM_INFINITY else min(there, limit)


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
