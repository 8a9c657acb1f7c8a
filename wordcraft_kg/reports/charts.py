"""Small charts as inline SVG strings: they follow the page's light and dark colours and need no JavaScript.

Colours are CSS classes (``series-0``, ``series-1``, ...) that the page's style sheet defines, and so are the dashes of
:func:`curves` (``dash-0`` to ``dash-3``, ``dashed``).
"""

import base64
import math
import struct
import zlib
from collections.abc import Callable, Collection, Mapping, Sequence
from html import escape

import numpy as np
from markupsafe import Markup

WIDTH, HEIGHT = 460, 250
LEFT, RIGHT, TOP, BOTTOM = 46, 12, 12, 42
# A letter of the charts' 11 px text is about so wide; longer names of series are cut, and whole in the tooltip.
LETTER, LONGEST_NAME = 6.3, 26
LINE_HEIGHT = 13
COLOURS, DASHES = 8, 4
HOVER_POINTS = 60

CurvePoint = tuple[float, float, float | None, float | None]
"""x, y, and the bounds of an interval of y, or None twice."""
Estimate = tuple[float, float | None, float | None]
"""A value and the bounds of its interval, or None twice."""


def grouped_bars(labels: Sequence[str], series: dict[str, Sequence[float]], x_title: str, description: str) -> Markup:
    """Draw shares (0 to 1) as grouped bars with a legend."""
    highest = max((max(values, default=0) for values in series.values()), default=0)
    top = _round_up(highest)
    plot = _Plot((0, len(labels)), (0, top), description)
    plot.y_ticks([top * i / 4 for i in range(5)], lambda value: f"{value:.0%}")
    width = 0.8 / max(len(series), 1)
    for number, (name, values) in enumerate(series.items()):
        for i, value in enumerate(values):
            x = i + 0.1 + number * width
            plot.rectangle(x, x + width * 0.94, 0, value, f"series-{number}", f"{name}, {labels[i]}: {value:.1%}")
    plot.x_labels([(i + 0.5, label) for i, label in enumerate(labels)])
    plot.titles(x_title, "")
    return plot.done(list(series))


def lines(
    series: dict[str, Sequence[tuple[float, float]]],
    x_title: str,
    y_title: str,
    description: str,
    *,
    legend_left: bool = False,
) -> Markup:
    """Draw curves through (x, y) points; rising curves leave room for the legend on the left."""
    points = [point for values in series.values() for point in values]
    xs, ys = zip(*points, strict=True) if points else ((0, 1), (0, 1))
    low, high = min(ys), max(ys)
    margin = (high - low) * 0.05 or abs(high) * 0.1 or 1.0
    plot = _Plot((min(xs), max(xs) if max(xs) > min(xs) else min(xs) + 1), (low - margin, high + margin), description)
    plot.y_ticks(_ticks(low, high), lambda value: f"{value:.3g}")
    plot.x_labels([(x, f"{x:.0f}") for x in _ticks(min(xs), max(xs))])
    for number, values in enumerate(series.values()):
        plot.polyline(values, f"line series-{number}")
    plot.titles(x_title, y_title)
    return plot.done(list(series) if len(series) > 1 else [], left=legend_left)


def curves(
    series: Mapping[str, Sequence[CurvePoint]],
    x_title: str,
    y_title: str,
    description: str,
    *,
    percent: bool = False,
    dashed: Collection[str] | None = None,
    colours: Mapping[str, int] | None = None,
) -> Markup:
    """Draw curves with bands of uncertainty, each named at its right end; the x-axis holds 0.

    Several seeds give a curve of their means and a band of their interval. A point with bounds whose neighbours have
    none gets a whisker, and a curve of a single point a dot.

    Args:
        series: points by name, x ascending; a curve without points keeps its colour, but is not drawn.
        x_title: under the x-axis, whose numbers are shortened (0.5M).
        y_title: above the chart.
        description: for readers who do not see it.
        percent: y is a share, and its axis goes from 0 to 100 %; otherwise the axis is fitted to the data.
        dashed: names of the curves to be dashed, all others being solid (say, train beside test); by default every
            curve has a pattern of its own, so that they differ without colour too.
        colours: numbers of colours by name, for curves that share one; by default a curve's place in ``series``.
    """
    names = {name: _shortened(name, LONGEST_NAME) for name, points in series.items() if points}
    everything = [point for points in series.values() for point in points]
    xs = [point[0] for point in everything]
    ys = [value for point in everything for value in point[1:] if value is not None]
    y_ticks = [i / 5 for i in range(6)] if percent else _round_ticks(min(ys, default=0), max(ys, default=1))
    first, last = min(xs, default=0), max(xs, default=1)
    first = min(first, 0)
    last = last if last > first else first + 1
    room = round(20 + LETTER * max(map(len, names.values()), default=0))
    plot = _Plot((first, last), (y_ticks[0], y_ticks[-1]), description, top=28, right=room)
    y_texts = [f"{value:.0%}" for value in y_ticks] if percent else _amounts(y_ticks)
    plot.y_ticks(y_ticks, dict(zip(y_ticks, y_texts, strict=True)).__getitem__)
    x_ticks = [value for value in _round_ticks(first, last) if first <= value <= last]
    plot.x_labels(list(zip(x_ticks, _amounts(x_ticks), strict=True)))
    number = {name: (colours or {}).get(name, i) % COLOURS for i, name in enumerate(series)}
    for name in names:
        for run in _runs_with_bounds(series[name]):
            plot.band(run, f"band series-{number[name]}", f"whisker series-{number[name]}")
    for i, name in enumerate(series):
        if name in names:
            dash = f"dash-{i % DASHES}" if dashed is None else "dashed" if name in dashed else "dash-0"
            plot.polyline([point[:2] for point in series[name]], f"line series-{number[name]} {dash}", name)
    for name in names:
        points = series[name]
        style, radius = ("hit", 4.0) if len(points) > 1 else (f"dot series-{number[name]}", 3.6)
        every = math.ceil(len(points) / HOVER_POINTS)
        # Counted from the end, which is the point of most interest.
        for x, y, low, high in points[::-1][::every][::-1]:
            plot.circle(x, y, radius, style, f"{name}, {x:,.10g}: {_estimate((y, low, high), percent)}")
    ends = [(name, *series[name][-1][:2]) for name in names]
    plot.end_labels([(x, y, names[name], name, f"series-{number[name]}") for name, x, y in ends])
    plot.titles(x_title, y_title)
    return plot.done([])


def dots(
    labels: Sequence[str],
    series: Mapping[str, Sequence[Estimate | None]],
    x_title: str,
    y_title: str,
    description: str,
) -> Markup:
    """Draw shares (0 to 1) with the whiskers of their intervals, side by side in each category, legend on the right.

    Series differ in colour and in shape.

    Args:
        labels: of the categories; cut where they would overlap.
        series: by name a share and its interval for each category, or None where there is none.
        x_title: under the x-axis.
        y_title: above the chart.
        description: for readers who do not see it.
    """
    names = {name: _shortened(name, LONGEST_NAME) for name in series}
    room = round(30 + LETTER * max(map(len, names.values()), default=0))
    plot = _Plot((0, max(len(labels), 1)), (0, 1), description, top=28, right=room)
    plot.y_ticks([i / 5 for i in range(6)], lambda value: f"{value:.0%}")
    letters = int((plot.x(1) - plot.x(0)) / LETTER)
    plot.x_labels([(i + 0.5, _shortened(label, letters)) for i, label in enumerate(labels)])
    gap = min(0.15, 0.8 / max(len(series), 1))
    for number, (name, values) in enumerate(series.items()):
        for i, (label, value) in enumerate(zip(labels, values, strict=True)):
            if value is not None:
                x = i + 0.5 + (number - (len(series) - 1) / 2) * gap
                share, low, high = value
                if low is not None and high is not None:
                    plot.whisker(x, low, high, f"whisker series-{number % COLOURS}")
                plot.marker(plot.x(x), plot.y(share), number, f"{name}, {label}: {_estimate(value, True)}")
        left, y = WIDTH - room + 14, plot.top + 6 + 16 * number
        plot.marker(left, y, number, name)
        plot.parts.append(f'<text x="{left + 9}" y="{y + 4}">{escape(names[name])}</text>')
    plot.titles(x_title, y_title)
    return plot.done([])


def reliability(points: Sequence[tuple[float, float, int]], description: str) -> Markup:
    """Draw accuracy against confidence, axes fitted to the data, with the diagonal of perfect calibration."""
    top = _round_up(max((max(x, y) for x, y, _ in points), default=1.0))
    plot = _Plot((0, top), (0, top), description)
    ticks = [top * i / 4 for i in range(5)]
    plot.y_ticks(ticks, lambda value: f"{value:.2f}")
    plot.x_labels([(value, f"{value:.2f}") for value in ticks])
    plot.polyline([(0, 0), (top, top)], "diagonal")
    plot.polyline([(x, y) for x, y, _ in points], "line series-0")
    for x, y, count in points:
        plot.circle(x, y, 4, "series-0", f"confidence {x:.3f}, right {y:.3f}, {count} queries")
    plot.titles("confidence of the best candidate", "share that is right")
    return plot.done([])


def labelled_points(
    points: np.ndarray, labels: Sequence[str], groups: Sequence[int], order: Sequence[int], description: str
) -> Markup:
    """Draw a map of points coloured by group; all have tooltips, and labels are set in ``order`` where they fit."""
    width, height = 940, 640
    low, high = points.min(axis=0), points.max(axis=0)
    scaled = (points - low) / np.where(high > low, high - low, 1) * [width - 110, height - 30] + [10, 15]
    places = scaled.round(1).tolist()
    parts = [f'<svg viewBox="0 0 {width} {height}" role="img" aria-label="{escape(description)}">']
    for (x, y), label, group in zip(places, labels, groups, strict=True):
        title = f"<title>{escape(label)}</title>"
        parts.append(f'<circle cx="{x}" cy="{y}" r="3" class="group-{group % 8}">{title}</circle>')
    taken: list[tuple[float, float, float]] = []
    for i in order:
        (x, y), end = places[i], places[i][0] + 8 + 5.5 * len(labels[i])
        if all(x > right or end < left or abs(y - line) > 10 for left, right, line in taken):
            taken.append((x, end, y))
            parts.append(f'<text x="{x + 5}" y="{y + 3}" class="small">{escape(labels[i])}</text>')
    return Markup("".join([*parts, "</svg>"]))


def contribution_bar(contributions: Mapping[str, float], scale: float) -> Markup:
    """Draw what adds up to a number: positive parts stacked to the right of the middle, negative ones to the left.

    Args:
        contributions: parts by name, in the order of their colours.
        scale: what half the width stands for.
    """
    half, height = 70.0, 12
    ends = {True: half, False: half}
    parts = [f'<svg class="bar" viewBox="0 0 {2 * half:g} {height}" aria-hidden="true">']
    for number, (name, value) in enumerate(contributions.items()):
        width = min(abs(value) / scale, 1) * half if scale else 0.0
        is_positive = value >= 0
        left = ends[is_positive] if is_positive else ends[is_positive] - width
        ends[is_positive] = left + width if is_positive else left
        parts.append(
            f'<rect x="{left:.1f}" y="1" width="{width:.1f}" height="{height - 2}" class="series-{number}">'
            f"<title>{escape(name)}: {value:.2f}</title></rect>"
        )
    parts.append(f'<line x1="{half:g}" x2="{half:g}" y1="0" y2="{height}" class="grid"/></svg>')
    return Markup("".join(parts))


def matrix_image(values: np.ndarray, marked: np.ndarray, description: str, size: int = 350) -> Markup:
    """Draw a square matrix as an image, dark = low and bright = high by rank, marked cells red.

    Args:
        values: shape (N, N), float.
        marked: shape (N, N), bool.
        description: for readers who do not see it.
        size: largest side in pixels; larger matrices are averaged in blocks.
    """
    step = math.ceil(len(values) / size)
    edges = np.arange(0, len(values), step)
    widths = np.diff(np.append(edges, len(values)))
    means = np.add.reduceat(np.add.reduceat(values, edges, axis=0), edges, axis=1) / np.outer(widths, widths)
    hit = np.add.reduceat(np.add.reduceat(marked.astype(int), edges, axis=0), edges, axis=1) > 0
    # Ranks, since raw scores have heavy tails; 48 shades keep the picture small.
    order = means.ravel().argsort(kind="stable").argsort(kind="stable").reshape(means.shape)
    pixels = (order * 48 // order.size).astype(np.uint8)
    pixels[hit] = 48
    ramp = np.linspace(0, 1, 48)[:, None]
    palette = np.concatenate([(1 - ramp) * [32, 42, 84] + ramp * [250, 232, 150], [[214, 40, 40]]]).astype(np.uint8)
    data = base64.b64encode(_png(pixels, palette)).decode()
    return Markup('<img alt="{}" src="data:image/png;base64,{}">').format(description, Markup(data))


def _png(pixels: np.ndarray, palette: np.ndarray) -> bytes:
    """Encode an 8-bit palette picture (PNG specification, colour type 3)."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    height, width = pixels.shape
    rows = np.column_stack([np.zeros(height, dtype=np.uint8), pixels]).tobytes()
    header = struct.pack(">IIBBBBB", width, height, 8, 3, 0, 0, 0)
    return b"".join(
        [
            b"\x89PNG\r\n\x1a\n",
            chunk(b"IHDR", header),
            chunk(b"PLTE", palette.tobytes()),
            chunk(b"IDAT", zlib.compress(rows, 9)),
            chunk(b"IEND", b""),
        ]
    )


class _Plot:
    """Axes with linear scales, collecting SVG elements; ``top`` and ``right`` are margins."""

    def __init__(
        self,
        x_range: tuple[float, float],
        y_range: tuple[float, float],
        description: str,
        *,
        top: int = TOP,
        right: int = RIGHT,
    ):
        self.x_range, self.y_range, self.description = x_range, y_range, description
        self.top, self.right = top, right
        self.parts: list[str] = []

    def x(self, value: float) -> float:
        low, high = self.x_range
        return round(LEFT + (value - low) / (high - low) * (WIDTH - LEFT - self.right), 1)

    def y(self, value: float) -> float:
        low, high = self.y_range
        return round(HEIGHT - BOTTOM - (value - low) / (high - low) * (HEIGHT - self.top - BOTTOM), 1)

    def y_ticks(self, values: Sequence[float], text: Callable[[float], str]) -> None:
        for value in values:
            y = self.y(value)
            self.parts.append(f'<line x1="{LEFT}" x2="{WIDTH - self.right}" y1="{y}" y2="{y}" class="grid"/>')
            self.parts.append(f'<text x="{LEFT - 5}" y="{y + 4}" text-anchor="end">{text(value)}</text>')

    def x_labels(self, labels: Sequence[tuple[float, str]]) -> None:
        style = "small" if len(labels) > 6 else "tick"
        for value, label in labels:
            y = HEIGHT - BOTTOM + 15
            self.parts.append(
                f'<text x="{self.x(value)}" y="{y}" text-anchor="middle" class="{style}">{escape(label)}</text>'
            )

    def rectangle(self, left: float, right: float, low: float, high: float, style: str, title: str) -> None:
        x, y = self.x(left), self.y(high)
        self.parts.append(
            f'<rect x="{x}" y="{y}" width="{self.x(right) - x:.1f}" height="{self.y(low) - y:.1f}" class="{style}">'
            f"<title>{escape(title)}</title></rect>"
        )

    def polyline(self, points: Sequence[tuple[float, float]], style: str, title: str = "") -> None:
        path = " ".join(f"{self.x(x)},{self.y(y)}" for x, y in points)
        inside = f"><title>{escape(title)}</title></polyline>" if title else "/>"
        self.parts.append(f'<polyline points="{path}" class="{style}"{inside}')

    def band(self, bounds: Sequence[tuple[float, float, float]], style: str, single: str) -> None:
        """Fill what lies between the bounds (x, low, high); at one x only, draw a whisker of the style ``single``."""
        if len(bounds) == 1:
            self.whisker(*bounds[0], single)
            return
        around = [(x, high) for x, _, high in bounds] + [(x, low) for x, low, _ in reversed(bounds)]
        path = " ".join(f"{self.x(x)},{self.y(y)}" for x, y in around)
        self.parts.append(f'<polygon points="{path}" class="{style}"/>')

    def whisker(self, x: float, low: float, high: float, style: str) -> None:
        at = self.x(x)
        self.parts.append(f'<line x1="{at}" x2="{at}" y1="{self.y(low)}" y2="{self.y(high)}" class="{style}"/>')

    def marker(self, x: float, y: float, number: int, title: str) -> None:
        """Draw a circle, square, triangle or diamond at a place in pixels, by the number of the series."""
        style, inside = f"dot series-{number % COLOURS}", f"<title>{escape(title)}</title>"
        corners = (
            [],
            [(-3.2, -3.2), (3.2, -3.2), (3.2, 3.2), (-3.2, 3.2)],
            [(0, -4.2), (4, 3), (-4, 3)],
            [(0, -4.6), (4.2, 0), (0, 4.6), (-4.2, 0)],
        )[number % 4]
        path = " ".join(f"{x + dx:.1f},{y + dy:.1f}" for dx, dy in corners)
        self.parts.append(
            f'<polygon points="{path}" class="{style}">{inside}</polygon>'
            if corners
            else f'<circle cx="{x}" cy="{y}" r="3.6" class="{style}">{inside}</circle>'
        )

    def end_labels(self, ends: Sequence[tuple[float, float, str, str, str]]) -> None:
        """Name the right ends (x, y, text, whole name, style) of curves, with a thin line to names that had to move."""
        places = _spread([self.y(end[1]) for end in ends], LINE_HEIGHT, self.top, HEIGHT - BOTTOM)
        edge = WIDTH - self.right
        for (x_value, y_value, text, name, style), place in zip(ends, places, strict=True):
            x, y = self.x(x_value), self.y(y_value)
            if abs(place - y) > 2 or edge - x > 2:
                self.parts.append(f'<line x1="{x + 2:.1f}" x2="{edge + 10}" y1="{y}" y2="{place:.1f}" class="leader"/>')
            inside = escape(text) + (f"<title>{escape(name)}</title>" if name != text else "")
            self.parts.append(f'<text x="{edge + 13}" y="{place + 4:.1f}" class="{style}">{inside}</text>')

    def circle(self, x: float, y: float, radius: float, style: str, title: str) -> None:
        self.parts.append(
            f'<circle cx="{self.x(x)}" cy="{self.y(y)}" r="{radius}" class="{style}">'
            f"<title>{escape(title)}</title></circle>"
        )

    def titles(self, x_title: str, y_title: str) -> None:
        middle = (LEFT + WIDTH - self.right) / 2
        self.parts.append(f'<text x="{middle}" y="{HEIGHT - 6}" text-anchor="middle">{escape(x_title)}</text>')
        if y_title:
            # Above the curves where there is room for it, otherwise inside.
            x, y = (LEFT, self.top - 10) if self.top > TOP else (LEFT + 4, TOP + 8)
            self.parts.append(f'<text x="{x}" y="{y}" class="small">{escape(y_title)}</text>')

    def done(self, legend: Sequence[str], *, left: bool = False) -> Markup:
        x, top = (LEFT + 10, TOP + 16) if left else (WIDTH - 140, TOP + 4)
        for i, name in enumerate(legend):
            y = top + 16 * i
            self.parts.append(f'<rect x="{x}" y="{y}" width="11" height="11" class="series-{i}"/>')
            self.parts.append(f'<text x="{x + 16}" y="{y + 10}">{escape(name)}</text>')
        opening = f'<svg viewBox="0 0 {WIDTH} {HEIGHT}" role="img" aria-label="{escape(self.description)}">'
        return Markup("".join([opening, *self.parts, "</svg>"]))


def _round_up(value: float) -> float:
    """Return the smallest of 1, 2, 4, 5, 8 times a power of ten that is at least ``value``."""
    if value <= 0:
        return 1.0
    unit = 10 ** math.floor(math.log10(value))
    return next(step * unit for step in (1, 2, 4, 5, 8, 10) if step * unit >= value * (1 - 1e-9))


def _ticks(low: float, high: float, count: int = 5) -> list[float]:
    return [low + (high - low) * i / (count - 1) for i in range(count)] if high > low else [low]


def _round_ticks(low: float, high: float, most: int = 5) -> list[float]:
    """Return multiples of 1, 2 or 5 times a power of ten from at most ``low`` to at least ``high``.

    The values between the two make ``most`` steps at most.
    """
    span = high - low or abs(high) or 1.0
    unit = 10 ** math.floor(math.log10(span / most))
    step = next(size * unit for size in (1, 2, 5, 10) if span / (size * unit) <= most * (1 + 1e-9))
    # Rounding must not add a tick beyond a bound that is one itself.
    first, last = math.floor(low / step + 1e-9), math.ceil(high / step - 1e-9)
    return [i * step for i in range(first, max(last, first + 1) + 1)]


def _amounts(values: Sequence[float]) -> list[str]:
    """Return numbers in the unit of the largest: 0, 0.5M, 1M."""
    highest = max(map(abs, values), default=0)
    size, unit = next(((size, unit) for size, unit in ((1e9, "B"), (1e6, "M"), (1e3, "k")) if highest >= size), (1, ""))
    return [f"{value / size:.10g}{unit}" if value else "0" for value in values]


def _estimate(value: Estimate, percent: bool) -> str:
    centre, low, high = (
        None if number is None else f"{number:.1%}" if percent else f"{number:.3g}" for number in value
    )
    return f"{centre}" if low is None or high is None else f"{centre} [{low}, {high}]"


def _shortened(text: str, letters: int) -> str:
    return text if len(text) <= letters else text[: max(letters - 1, 1)].rstrip() + "…"


def _runs_with_bounds(points: Sequence[CurvePoint]) -> list[list[tuple[float, float, float]]]:
    """Return the stretches of points that have bounds, as (x, low, high)."""
    runs: list[list[tuple[float, float, float]]] = [[]]
    for x, _, low, high in points:
        if low is not None and high is not None:
            runs[-1].append((x, low, high))
        elif runs[-1]:
            runs.append([])
    return [run for run in runs if run]


def _spread(wanted: Sequence[float], gap: float, low: float, high: float) -> list[float]:
    """Return places at least ``gap`` apart and within bounds, in the order of those wanted and as near as can be.

    Least squares by pooling adjacent violators. Places that are too many for the bounds are nearer to each other.

    Source: Barlow et al. 1972, "Statistical inference under order restrictions", for the pooling.
    """
    if not wanted:
        return []
    gap = min(gap, (high - low) / max(len(wanted) - 1, 1))
    order = sorted(range(len(wanted)), key=wanted.__getitem__)
    # Less its rank times the gap, a place may be no lower than the one before; pools of equal places: sum and number.
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
