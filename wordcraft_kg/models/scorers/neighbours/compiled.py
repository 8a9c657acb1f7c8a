"""Compilation of inner loops by numba, once for each machine.

A loop that is called for each pair takes the arrays that it reads, not all lists: a call copies
each array's address and shape, and for 30 arrays that takes longer than the work of a short loop.
"""

from collections.abc import Callable
from typing import Any, TypeVar

import numba

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
    return _compiled(function, {"nogil": True, "fastmath": _SUMS_IN_ANY_ORDER})


def compiled(function: F) -> F:
    """Compile a function of arrays and numbers when it is first called.

    The machine code is kept on the disk, beside the source or in the user's cache. Where neither
    can be written, each process compiles again, which takes some seconds.

    Args:
        function: uses only what numba supports, and never writes to the same place as another
            thread: it runs without Python's lock.
    """
    return _compiled(function, {"nogil": True})


def _compiled(function: F, options: dict[str, Any]) -> F:
    try:
        made = numba.njit(cache=True, **options)(function)
    except RuntimeError:  # no folder for the machine code
        made = numba.njit(**options)(function)
    result: F = made
    return result
