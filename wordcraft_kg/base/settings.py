"""Validation of settings, with errors that name the setting.

An error names a setting in backticks, as Python spells it: `learning_rate` -1: expected a number above 0. The command
line shows the option instead, ``--learning-rate``.
"""

import difflib
import operator
import os
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from wordcraft_kg.base.errors import ConfigError

LARGEST = 3e38  # of 32-bit floats, as torch uses
SMALLEST = 1e-38
MOST = 2**63 - 1
"""Limit for seeds, and for counts that cost only time."""
MAX_SIZE = 2**24
"""Limit for sizes in memory: batches, draws."""
MAX_DIM = 2**16
"""Limit for the dimension of a vector."""
MAX_THREADS = 1_024
_CONTAINER_LIMITS = (
    "/sys/fs/cgroup/memory.max",
    "/sys/fs/cgroup/memory/memory.limit_in_bytes",
)
"""Files with the memory limit of a Linux container, as of Docker: control groups of version 2 and version 1."""


def refuse(name: str, value: Any, expected: str, hint: str = "") -> ConfigError:
    """Return the ConfigError for an invalid setting: name, value, expected values and an optional hint."""
    return ConfigError(f"`{name}` {value!r}: expected {expected}.{hint}")


def require(config: Any, name: str, holds: bool, expected: str) -> None:
    """Raise a :class:`ConfigError` for the setting ``name`` in ``config``, unless the condition ``holds`` is True."""
    if not holds:
        raise refuse(name, getattr(config, name), expected)


def whole(name: str, value: Any, low: int, high: int | None = None) -> int:
    """Return an integer setting from ``low`` to ``high`` (default :data:`MOST`), or raise a :class:`ConfigError`."""
    try:
        number = operator.index(value)
    except TypeError:
        number = low - 1
    limit = MOST if high is None else high
    if isinstance(value, bool) or not low <= number <= limit:
        # A technical upper limit does not help with a number below the range.
        is_open = number < low and limit >= MAX_DIM
        raise refuse(
            name, value, f"a whole number, {low} " + ("or more" if is_open else f"to {limit}")
        )
    return number


def number_in(name: str, value: Any, low: float, high: float, expected: str) -> None:
    """Raise a :class:`ConfigError` for NaN, for booleans, and for numbers outside ``low`` to ``high``."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not low <= value <= high:
        raise refuse(name, value, expected)


def one_line(name: str, text: str, most: int = 500) -> None:
    """Raise a :class:`ConfigError` unless a text has 1 to ``most`` characters on one line, as for a table."""
    if not text.strip() or not text.isprintable() or len(text) > most:
        raise refuse(name, text[:100], f"1 to {most} characters on one line")


def positive(name: str, value: Any) -> float:
    """Return a setting with a positive number that a 32-bit float can hold, or raise a :class:`ConfigError`."""
    if (
        isinstance(value, bool)
        or not isinstance(value, int | float)
        or not SMALLEST <= value < LARGEST
    ):
        raise refuse(name, value, "a number above 0")
    return float(value)


def check_memory(name: str, value: int, what: str, needed: int) -> None:
    """Raise ConfigError if a setting's data, named ``what``, need more bytes than this process may use."""
    available = memory()
    if needed > available:
        gib, most = (f"{size / 2**30:,.1f} GiB" for size in (needed, available))
        raise ConfigError(f"`{name}` {value:,}: {what} would take {gib}, and {most} are there.")


def memory() -> int:
    """Return the bytes of memory that this process may use."""
    try:
        import resource

        available = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
        limit, _ = resource.getrlimit(resource.RLIMIT_AS)
    except (ImportError, ValueError, OSError):  # not a Unix
        return MOST
    available = min([available, *_container_limits()])
    if limit == resource.RLIM_INFINITY:
        return available
    # The limit counts addresses, and loaded libraries take GiB of them.
    return min(available, max(limit - _address_space(), 0))


def _container_limits() -> Iterator[int]:
    """Yield the limits of the container that this process runs in, in bytes."""
    for path in _CONTAINER_LIMITS:
        with suppress(OSError, ValueError):  # no container, or "max": no limit
            yield int(Path(path).read_text())


def _address_space() -> int:
    """Return the bytes of the address space that this process takes, 0 where the system does not say."""
    try:
        return int(Path("/proc/self/statm").read_text().split()[0]) * os.sysconf("SC_PAGE_SIZE")
    except OSError:
        return 0


def one_of(name: str, value: Any, allowed: Sequence[str]) -> None:
    """Raise a :class:`ConfigError`, with the most similar allowed values, unless ``value`` is in ``allowed``."""
    if value not in allowed:
        hint = nearest(value, allowed) if isinstance(value, str) else ""
        raise refuse(name, value, f"one of {', '.join(allowed)}", hint)


def nearest(label: str, known: Iterable[str], limit: int = 3) -> str:
    """Return a hint such as " Did you mean 'a', 'b'?" with the most similar known labels; "" if no label is similar."""
    matches = difflib.get_close_matches(label, list(known), n=limit, cutoff=0.6)
    return f" Did you mean {', '.join(repr(m) for m in matches)}?" if matches else ""
