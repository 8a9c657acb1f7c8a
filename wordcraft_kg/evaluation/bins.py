"""Named ranges (bins) of integers, such as ranks or counts."""

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from wordcraft_kg.graphs.arrays import Ids

# Above any rank or count, and far below the limit of int64.
OPEN_END = 10**9
Bounds = Sequence[tuple[int, int]]


def binned(
    values: Ids, bounds: Bounds, *, more: str = "+"
) -> Iterator[tuple[str, NDArray[np.bool_]]]:
    """Sort values into bins.

    Args:
        values: integers, shape (N,).
        bounds: lowest and highest value of each bin, both included; :data:`OPEN_END` for no upper
            bound.
        more: text after the lowest value in the name of a bin without an upper bound.

    Yields:
        The name of each bin, such as ``3–4`` or ``9+``, and a mask, shape (N,).
    """
    for low, high in bounds:
        if low == high:
            name = str(low)
        elif high == OPEN_END:
            name = f"{low}{more}"
        else:
            name = f"{low}–{high}"
        yield name, (values >= low) & (values <= high)
