"""Compilation of inner loops by numba, once for each machine.

The machine code on the disk is checked by hashes before it runs: a file that is empty, cut or
garbled, as after a power failure, is made again.

A loop that is called for each pair takes the arrays that it reads, not all lists: a call copies
each array's address and shape, and for 30 arrays that takes longer than the work of a short loop.
"""

import hashlib
import pickle
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
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
    return _compiled(function, {"nogil": True, "fastmath": _SUMS_IN_ANY_ORDER, "_nrt": False})


def compiled(function: F) -> F:
    """Compile a function of arrays and numbers when it is first called.

    The machine code is kept on the disk, beside the source or in the user's cache. Where neither
    can be written, each process compiles again, which takes some seconds.

    Args:
        function: uses only what numba supports, and never writes to the same place as another
            thread: it runs without Python's lock.
    """
    return _compiled(function, {"nogil": True})


def in_place(function: F) -> F:
    """Compile a function, as :func:`compiled`, that makes no arrays: it writes to its arguments.

    Numba counts no references to arrays there. Counting takes longer than a short loop, because
    threads may share the counts.

    Args:
        function: as for :func:`compiled`; calls functions alone that make no arrays, either.
    """
    return _compiled(function, {"nogil": True, "_nrt": False})


def _compiled(function: F, options: dict[str, Any]) -> F:
    dispatcher = numba.njit(**options)(function)
    with suppress(RuntimeError):  # no folder for the machine code
        # As `cache=True` does, with files that are checked.
        dispatcher._cache = _Cache(function)
    result: F = dispatcher
    return result


class _Files(IndexDataCacheFile):
    """Files that end with a hash of the function, its source and the content.

    It is compared when a file is read: an index may lead to a file of an earlier source, as after a
    full disk. The content names the types of arguments, too: where two processes compile for
    different types at the same time, the index may lead to the file of the other types.
    """

    def save(self, key: Any, data: Any) -> None:
        """Save the machine code for a key, which holds the types of arguments."""
        super().save(key, (key, data))

    def load(self, key: Any) -> Any:
        """Return the machine code for a key; None if there is none yet.

        Raises:
            ValueError: if a file differs from its hash, or has the code for other types.
        """
        entry = super().load(key)
        if entry is None:
            return None
        saved_key, data = entry
        if saved_key != key:
            raise ValueError(f"{self._data_name_pattern} was compiled for other types")
        return data

    def _dump(self, value: Any) -> bytes:
        content: bytes = super()._dump(value)
        # Behind the end of the pickle, where its reader stops.
        return content + self._hash(content)

    def _load_index(self) -> Any:
        if Path(self._index_path).exists():
            # The index begins with the version of numba, which is no part of the hashed content.
            self._check(self._index_path, pickle.dumps(self._version, protocol=-1))
        return super()._load_index()

    def _load_data(self, name: str) -> Any:
        self._check(self._data_path(name))
        return super()._load_data(name)

    def _hash(self, content: bytes) -> bytes:
        purpose = repr((self._index_name, self._source_stamp))
        return hashlib.sha256(purpose.encode() + content).digest()

    def _check(self, path: str, start: bytes = b"") -> None:
        """Raise ValueError if a file differs from its hash."""
        content = Path(path).read_bytes().removeprefix(start)
        length = hashlib.sha256().digest_size
        if self._hash(content[:-length]) != content[-length:]:
            raise ValueError(f"{path} differs from its hash")


class _Cache(FunctionCache):
    """The machine code of a function on the disk; what cannot be read is compiled again."""

    def __init__(self, function: Callable[..., Any]):
        super().__init__(function)
        # Names of their own: other files of this function have no hash.
        self._cache_file = _Files(
            cache_path=self._cache_path,
            filename_base=f"{self._impl.filename_base}.checked-{numba.__version__}",
            source_stamp=self._impl.locator.get_source_stamp(),
        )

    def load_overload(self, *arguments: Any) -> Any:
        try:
            return super().load_overload(*arguments)
        # Reading a pickle may raise anything, as where it names a class that has another name now.
        except Exception:
            with suppress(OSError):
                self.flush()
            return None

    def save_overload(self, *arguments: Any) -> None:
        # Without files, as where they are damaged and cannot be replaced, each process compiles.
        with suppress(OSError, ValueError):
            super().save_overload(*arguments)
