"""Bins of whole numbers."""

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from wordcraft_kg.graphs.arrays import Ids

OPEN_END = 10**9
"""Upper bound of a bin that is open at the top."""
Bounds = Sequence[tuple[int, int]]


def binned(values: Ids, bounds: Bounds, *, more: str = "+") -> Iterator[tuple[str, NDArray[np.bool_]]]:
    """Yield name and mask, shape (N,), of each bin; bounds are inclusive, ``more`` ends the name of an open bin."""
    for low, high in bounds:
        name = str(low) if low == high else f"{low}{more}" if high == OPEN_END else f"{low}–{high}"
        yield name, (values >= low) & (values <= high)
