"""Validation of settings, with errors that name the setting; specifications of entity features.

An error names a setting in backticks, as Python spells it: `learning_rate` -1: expected a number
above 0. The command line shows the option instead, ``--learning-rate``. Features, a vector per
entity, are specified by a reserved name or a path.
"""

import difflib
import operator
import os
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, fields
from numbers import Real
from pathlib import Path
from typing import Any, Literal, get_args, get_origin

from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.base.wording import means_another

# Bounds of 32-bit floats, in which torch computes; just inside, so that rounding stays finite.
LARGEST = 3e38
SMALLEST = 1e-38
MOST = 2**63 - 1
"""Limit for seeds, and for counts that cost only time: the largest int64."""
MAX_SIZE = 2**24
"""Limit for sizes in memory: batches, draws."""
MAX_DIM = 2**16
"""Limit for the dimension of a vector."""
MAX_THREADS = 1_024
"""Limit for CPU threads and processes."""
CORES_VARIABLE = "WORDCRAFT_KG_CORES"
"""Environment variable: number of CPU cores to use, for processes without core affinity."""
_CONTAINER_LIMITS = (
    "/sys/fs/cgroup/memory.max",
    "/sys/fs/cgroup/memory/memory.limit_in_bytes",
)
"""Files with the memory limit of a Linux container, as of Docker.

One for control groups of version 2, one for version 1.
"""


def refuse(
    name: str,
    value: Any,
    expected: str,
    hint: str = "",
) -> ConfigError:
    """Return the ConfigError for an invalid setting; the caller raises it.

    Args:
        name: the setting, as Python spells it.
        value: the value found.
        expected: the values allowed, as in "expected <...>".
        hint: a further sentence that begins with a blank, such as from :func:`nearest`.
    """
    return ConfigError(f"`{name}` {value!r}: expected {expected}.{hint}")


def require(
    config: Any,
    name: str,
    holds: bool,
    expected: str,
) -> None:
    """Check a condition on a setting.

    Args:
        config: object with the setting as an attribute.
        name: the setting.
        holds: whether the condition is met.
        expected: the values allowed, for the error.

    Raises:
        ConfigError: if ``holds`` is False.
    """
    if not holds:
        raise refuse(name, getattr(config, name), expected)


def whole(
    name: str,
    value: Any,
    low: int,
    high: int | None = None,
) -> int:
    """Return a setting as a Python integer, given as any integer type, such as NumPy's.

    Args:
        name: the setting, for the error.
        value: the value to check; a boolean is not a number here.
        low: smallest allowed value.
        high: largest allowed value; None for :data:`MOST`.

    Raises:
        ConfigError: if ``value`` is not an integer, or out of range.
    """
    try:
        number = operator.index(value)
    except TypeError:
        number = low - 1  # out of range, for the error below
    limit = MOST if high is None else high
    if isinstance(value, bool) or not low <= number <= limit:
        # A technical upper limit does not help with a number below the range.
        is_open = number < low and limit >= MAX_DIM
        expected = f"{low} or more" if is_open else f"{low} to {limit}"
        raise refuse(name, value, f"a whole number, {expected}")
    return number


def number_in(
    name: str,
    value: Any,
    low: float,
    high: float,
    expected: str,
) -> None:
    """Check that a setting is a number in a range with both ends included.

    Args:
        name: the setting, for the error.
        value: the value to check; NaN is in no range, and a boolean is not a number here.
        low: smallest allowed value.
        high: largest allowed value.
        expected: the values allowed, for the error.

    Raises:
        ConfigError: if ``value`` is not such a number.
    """
    if not _is_number(value) or not low <= value <= high:
        raise refuse(name, value, expected)


def one_line(
    name: str,
    text: str,
    most: int = 500,
) -> None:
    """Check that a text fits on a line, as for a table.

    Args:
        name: the setting, for the error.
        text: the text to check.
        most: largest number of characters.

    Raises:
        ConfigError: if ``text`` is blank, too long, or has line breaks or control characters.
    """
    if not text.strip() or not text.isprintable() or len(text) > most:
        raise refuse(name, text[:100], f"1 to {most} characters on one line")


def positive(name: str, value: Any) -> float:
    """Return a setting with a positive number that a 32-bit float can hold.

    Raises:
        ConfigError: for other values, also NaN, infinity and booleans.
    """
    if not _is_number(value) or not SMALLEST <= value < LARGEST:
        raise refuse(name, value, "a number above 0")
    return float(value)


def _is_number(value: Any) -> bool:
    # NumPy's numbers are real numbers, too, and its booleans are not.
    return isinstance(value, Real) and not isinstance(value, bool)


def check_memory(
    name: str,
    value: int,
    what: str,
    needed: int,
) -> None:
    """Refuse a size whose data would not fit into the memory that this process may use.

    Args:
        name: the setting that decides the size.
        value: its value.
        what: name of the data, for the error.
        needed: bytes that the data take at least.

    Raises:
        ConfigError: if more than :func:`memory` bytes are needed.
    """
    available = memory()
    if needed > available:
        gib = 2**30
        raise ConfigError(
            f"`{name}` {value:,}: {what} would take {needed / gib:,.1f} GiB, "
            f"and {available / gib:,.1f} GiB are there."
        )


def cores() -> int:
    """Return the number of CPU cores that this process may use."""
    text = os.environ.get(CORES_VARIABLE, "")
    if text.isdecimal():
        return max(int(text), 1)
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def memory() -> int:
    """Return the bytes of memory that this process may use: the machine's, or its container's."""
    try:
        limits = [os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")]
    except (AttributeError, ValueError, OSError):  # not a Unix
        return MOST
    for path in _CONTAINER_LIMITS:
        with suppress(OSError, ValueError):  # no container, or "max": no limit
            limits.append(int(Path(path).read_text()))
    return min(limits)


def one_of(
    name: str,
    value: Any,
    allowed: Sequence[str],
) -> None:
    """Check that a setting has one of several values.

    Args:
        name: the setting, for the error.
        value: the value to check.
        allowed: the values allowed.

    Raises:
        ConfigError: if ``value`` is not allowed; the message suggests the most similar values.
    """
    if value not in allowed:
        hint = nearest(value, allowed) if isinstance(value, str) else ""
        raise refuse(name, value, f"one of {', '.join(allowed)}", hint)


def check_choices(config: Any) -> None:
    """Check the fields of a dataclass that are one of several texts, or true or false.

    A text such as "false" from a configuration file would count as true.

    Args:
        config: settings, whose fields have the types ``Literal[...]`` or ``bool``, perhaps with
            ``| None``; fields of other types are not checked.

    Raises:
        ConfigError: if a value is none of them.
    """
    for entry in fields(config):
        value = getattr(config, entry.name, None)  # derived fields have no value yet
        kinds = (entry.type, *get_args(entry.type))
        if value is None and type(None) in kinds:
            continue
        for kind in kinds:
            if get_origin(kind) is Literal:
                one_of(entry.name, value, get_args(kind))
            elif kind is bool:
                require(config, entry.name, isinstance(value, bool), "true or false")


def nearest(
    label: str,
    known: Iterable[str],
    limit: int = 3,
) -> str:
    """Return a hint with similar labels, such as " Did you mean 'a', 'b'?".

    Another number, or a label that differs only in plus and minus signs, is no hint: it names
    another thing.

    Args:
        label: the label as written.
        known: labels to choose from.
        limit: most labels to suggest.

    Returns:
        The hint with a leading blank, or "" if no label is similar.
    """
    # 0.6 is the default of difflib: about two of three characters agree, in order. More than
    # `limit`, since some are left out.
    close = difflib.get_close_matches(label, list(known), n=4 * limit, cutoff=0.6)
    matches = [match for match in close if not means_another(label, match)][:limit]
    return f" Did you mean {', '.join(map(repr, matches))}?" if matches else ""


VECTORS = ("auto", "minilm", "glove", "one-hot", "random")
"""Reserved feature names; for a file with a reserved name, write a path such as ``./glove``."""
SHUFFLED = "shuffled:"


@dataclass(frozen=True)
class FeatureSpec:
    """A parsed specification: ``glove``, ``vectors.txt`` or ``shuffled:vectors.txt``.

    Attributes:
        source: a name in :data:`VECTORS`, or the path to a file or folder with vectors.
        prefix: ``shuffled:`` (assign the vectors to random entities), as often as written; empty
            without shuffling.
    """

    source: str
    prefix: str = ""

    @classmethod
    def parse(cls, text: str) -> "FeatureSpec":
        """Split a specification into prefix and source; whether a file exists is not checked."""
        source = text
        # Twice shuffled is shuffled twice; a specification is kept as written.
        while source.startswith(SHUFFLED):
            source = source.removeprefix(SHUFFLED)
        return cls(source, text.removesuffix(source))

    @property
    def is_path(self) -> bool:
        """Whether the source is a path, not a name in :data:`VECTORS`."""
        return self.source not in VECTORS

    def __str__(self) -> str:
        return self.prefix + self.source
