"""Shortened labels, and their placement without overlap."""

from collections import defaultdict
from collections.abc import Sequence


def shortened(text: str, letters: int) -> str:
    """Shorten a text to a number of letters, with an ellipsis."""
    if len(text) <= letters:
        return text
    # Room for the ellipsis, but never less than the first letter.
    kept = max(letters - 1, 1)
    return text[:kept].rstrip() + "…"


def spread(
    wanted: Sequence[float],
    gap: float,
    low: float,
    high: float,
) -> list[float]:
    """Return the positions closest to the wanted ones that keep a distance from each other.

    The positions have the order of the wanted ones and the least sum of squared moves, by pooling
    adjacent violators.

    Args:
        wanted: N positions, in any order; ties keep their order.
        gap: least distance between two positions; it shrinks if the bounds are too narrow for N.
        low: least position.
        high: greatest position.

    Returns:
        N positions, each for the wanted position of the same index.

    Source: Barlow et al. 1972, "Statistical inference under order restrictions", for the pooling.
    """
    if not wanted:
        return []
    num_gaps = len(wanted) - 1
    widest = (high - low) / max(num_gaps, 1)
    gap = min(gap, widest)
    order = sorted(range(len(wanted)), key=wanted.__getitem__)
    # Without the gaps of the lower ranks (rank * gap), places only must not decrease: isotonic
    # regression. Pools of equal places are kept as (sum, number).
    pools: list[tuple[float, int]] = []
    for rank, index in enumerate(order):
        total = wanted[index] - rank * gap
        size = 1
        # A pool whose mean is not below the next one's joins it.
        while pools:
            pooled_total, pooled_size = pools[-1]
            if pooled_total / pooled_size < total / size:
                break
            pools.pop()
            total += pooled_total
            size += pooled_size
        pools.append((total, size))
    means: list[float] = []
    for total, size in pools:
        means += [total / size] * size
    # Bounds without the gaps; the lower one stays as it is.
    highest = high - num_gaps * gap
    places = [0.0] * len(wanted)
    for rank, index in enumerate(order):
        place = max(means[rank], low)
        place = min(place, highest)
        places[index] = place + rank * gap
    return places


class Labels:
    """The space taken by texts in a chart, so that later texts do not overlap earlier ones.

    Args:
        line: height of a line of text, in pixels.
    """

    def __init__(self, line: float):
        self._line = line
        # Texts as (left, right, y) by row of one line height: only three rows can overlap a text.
        self._taken = defaultdict[int, list[tuple[float, float, float]]](list)

    def take(self, left: float, right: float, y: float) -> bool:
        """Reserve space for a text, in pixels.

        Args:
            left: left end of the text.
            right: right end.
            y: height of the base line.

        Returns:
            False if the space is taken; then nothing is reserved.
        """
        row = int(y // self._line)
        for near in (row - 1, row, row + 1):
            for start, end, at in self._taken[near]:
                is_beside = left > end or right < start
                is_apart = abs(y - at) >= self._line
                if not (is_beside or is_apart):
                    return False
        self._taken[row].append((left, right, y))
        return True
