"""Bins of whole numbers, such as 1, 2–3, 4–10 and more."""

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from wordcraft_kg.graphs.arrays import Ids

OPEN_END = 10**9
"""Upper bound of a bin that is open at the top."""
Bounds = Sequence[tuple[int, int]]


def binned(values: Ids, bounds: Bounds, *, more: str = "+") -> Iterator[tuple[str, NDArray[np.bool_]]]:
    """Yield the name of each bin and a mask of the values in it, bounds included.

    Args:
        values: shape (N,).
        bounds: lowest and highest value of each bin.
        more: what follows the lowest value in the name of a bin up to :data:`OPEN_END`.
    """
    for low, high in bounds:
        name = str(low) if low == high else f"{low}{more}" if high == OPEN_END else f"{low}–{high}"
        yield name, (values >= low) & (values <= high)
