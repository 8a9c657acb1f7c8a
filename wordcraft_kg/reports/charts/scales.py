"""Axis ticks, number formats for axes and tooltips, and placement of labels without overlap."""

import math
from collections.abc import Sequence

Estimate = tuple[float, float | None, float | None]


def round_ticks(low: float, high: float, most: int = 5) -> list[float]:
    """Return multiples of 1, 2 or 5 times a power of ten that cover ``low`` to ``high`` in at most ``most`` steps."""
    span = high - low or abs(high) or 1.0
    unit = 10 ** math.floor(math.log10(span / most))
    step = next(size * unit for size in (1, 2, 5, 10) if span / (size * unit) <= most * (1 + 1e-9))
    # The tolerance keeps rounding errors from adding a tick beyond a bound.
    first, last = math.floor(low / step + 1e-9), math.ceil(high / step - 1e-9)
    return [i * step for i in range(first, max(last, first + 1) + 1)]


def amounts(values: Sequence[float]) -> list[str]:
    """Format numbers in the largest number's unit: 0, 0.5M, 1M."""
    highest = max(map(abs, values), default=0)
    size, unit = next(
        ((size, unit) for size, unit in ((1e9, "B"), (1e6, "M"), (1e3, "k")) if highest >= size),
        (1, ""),
    )
    return [f"{value / size:.10g}{unit}" if value else "0" for value in values]


def estimate(value: Estimate, percent: bool) -> str:
    """Format a value with its bounds."""
    centre, low, high = (
        None if number is None else f"{number:.1%}" if percent else f"{number:.3g}"
        for number in value
    )
    return f"{centre}" if low is None or high is None else f"{centre} [{low}, {high}]"


def shortened(text: str, letters: int) -> str:
    """Shorten a text to a number of letters, with an ellipsis."""
    return text if len(text) <= letters else text[: max(letters - 1, 1)].rstrip() + "…"


def spread(wanted: Sequence[float], gap: float, low: float, high: float) -> list[float]:
    """Return positions within bounds, at least ``gap`` apart, in the order of the wanted positions and closest to them.

    Least squares by pooling adjacent violators. The gap shrinks if the bounds are too narrow.

    Source: Barlow et al. 1972, "Statistical inference under order restrictions", for the pooling.
    """
    if not wanted:
        return []
    gap = min(gap, (high - low) / max(len(wanted) - 1, 1))
    order = sorted(range(len(wanted)), key=wanted.__getitem__)
    # After subtracting rank * gap, places must not decrease. Pools of equal places are kept as (sum, number).
    pools: list[tuple[float, int]] = []
    for rank, i in enumerate(order):
        total, size = wanted[i] - rank * gap, 1
        while pools and pools[-1][0] / pools[-1][1] >= total / size:
            total, size = total + pools[-1][0], size + pools[-1][1]
            pools.pop()
        pools.append((total, size))
    means = [total / size for total, size in pools for _ in range(size)]
    places = [0.0] * len(wanted)
    for rank, i in enumerate(order):
        places[i] = min(max(means[rank], low), high - (len(wanted) - 1) * gap) + rank * gap
    return places


class Labels:
    """The space already taken by texts in a chart, so that later texts do not overlap earlier texts."""

    def __init__(self, line: float):
        self._line = line
        self._taken: dict[int, list[tuple[float, float, float]]] = {}

    def take(self, left: float, right: float, y: float) -> bool:
        """Reserve space for a text from ``left`` to ``right`` at height ``y``; return False if the space is taken."""
        row = int(y // self._line)
        others = [one for near in (row - 1, row, row + 1) for one in self._taken.get(near, ())]
        fits = all(
            left > end or right < start or abs(y - at) >= self._line for start, end, at in others
        )
        if fits:
            self._taken.setdefault(row, []).append((left, right, y))
        return fits
