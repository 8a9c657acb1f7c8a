"""Named ranges (bins) of integers, such as ranks or counts."""

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from wordcraft_kg.graphs.arrays import Ids

OPEN_END = 10**9
Bounds = Sequence[tuple[int, int]]


def binned(
    values: Ids, bounds: Bounds, *, more: str = "+"
) -> Iterator[tuple[str, NDArray[np.bool_]]]:
    """Yield each bin's name, such as ``3–4`` or ``9+``, and a mask, shape (N,); ``bounds`` are inclusive."""
    for low, high in bounds:
        name = str(low) if low == high else f"{low}{more}" if high == OPEN_END else f"{low}–{high}"
        yield name, (values >= low) & (values <= high)
