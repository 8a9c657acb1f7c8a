"""Compilation of inner loops by numba, once for each machine.

A loop that is called for each pair takes the arrays that it reads, not all lists: a call copies
each array's address and shape, and for 30 arrays that takes longer than the work of a short loop.
"""

from collections.abc import Callable
from contextlib import suppress
from typing import Any, TypeVar

import numba
from numba.core.caching import FunctionCache, IndexDataCacheFile

F = TypeVar("F", bound=Callable[..., Any])

_SUMS_IN_ANY_ORDER = {"reassoc", "contract", "nsz", "arcp"}
"""Rules that LLVM may use to compute several terms of a sum at once.

Infinite numbers and NaN keep their meaning. The order of a sum depends on the machine's
instructions, never on threads.
"""


def product_of_rows(function: F) -> F:
    """Compile a function whose only loop is a product of two rows, several terms at once.

    Other loops add in a fixed order: where sums may be turned around, loops that were compiled just
    now and loops from the disk differ in their last bits.

    Args:
        function: as for :func:`compiled`.
    """
    return compiled(function, fastmath=_SUMS_IN_ANY_ORDER, _nrt=False)


def in_place(function: F) -> F:
    """Compile a function, as :func:`compiled`, that makes no arrays: it writes to its arguments.

    Numba counts no references to arrays there. Counting takes longer than a short loop, because
    threads may share the counts.

    Args:
        function: as for :func:`compiled`; calls functions alone that make no arrays, either.
    """
    return compiled(function, _nrt=False)


def compiled(function: F, **options: Any) -> F:
    """Compile a function of arrays and numbers when it is first called.

    The machine code is kept on the disk, beside the source or in the user's cache. Where neither
    can be written, each process compiles again, which takes some seconds.

    Args:
        function: uses only what numba supports, and never writes to the same place as another
            thread: it runs without Python's lock.
        options: further options of :func:`numba.njit`.
    """
    dispatcher = numba.njit(nogil=True, **options)(function)
    with suppress(RuntimeError):  # no folder for the machine code
        # As `cache=True` does, with files that are checked.
        dispatcher._cache = _Cache(function)
    result: F = dispatcher
    return result


class _Files(IndexDataCacheFile):
    """Machine code with the source and the types of arguments that it was compiled for.

    The index may lead to other code: to that for other types, where two processes compile at the
    same time, or to that of an earlier source, where a process ended before it wrote the new one.
    """

    def save(self, key: Any, data: Any) -> None:
        super().save(key, (self._source_stamp, key, data))

    def load(self, key: Any) -> Any:
        entry = super().load(key)
        if entry is None or entry[:2] != (self._source_stamp, key):
            return None
        return entry[2]


class _Cache(FunctionCache):
    """The machine code of a function on the disk; what cannot be read is compiled again."""

    def __init__(self, function: Callable[..., Any]):
        super().__init__(function)
        stamp = self._impl.locator.get_source_stamp()
        self._cache_file = _Files(self._cache_path, self._impl.filename_base, stamp)

    def load_overload(self, *arguments: Any) -> Any:
        try:
            return super().load_overload(*arguments)
        # Reading a pickle may raise anything, as after a power failure.
        except Exception:
            with suppress(OSError):
                self.flush()
            return None

    def save_overload(self, *arguments: Any) -> None:
        # Without files, as on a full disk, each process compiles.
        with suppress(OSError):
            super().save_overload(*arguments)
