"""Small charts as inline SVG strings: they follow the page's light and dark colours and need no JavaScript.

Colours are CSS classes (``series-0``, ``series-1``, ...) that the page's style sheet defines.
"""

import base64
import math
import struct
import zlib
from collections.abc import Callable, Sequence
from html import escape

import numpy as np
from markupsafe import Markup

WIDTH, HEIGHT = 460, 250
LEFT, RIGHT, TOP, BOTTOM = 46, 12, 12, 42


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
    """Axes with linear scales, collecting SVG elements."""

    def __init__(self, x_range: tuple[float, float], y_range: tuple[float, float], description: str):
        self.x_range, self.y_range, self.description = x_range, y_range, description
        self.parts: list[str] = []

    def x(self, value: float) -> float:
        low, high = self.x_range
        return round(LEFT + (value - low) / (high - low) * (WIDTH - LEFT - RIGHT), 1)

    def y(self, value: float) -> float:
        low, high = self.y_range
        return round(HEIGHT - BOTTOM - (value - low) / (high - low) * (HEIGHT - TOP - BOTTOM), 1)

    def y_ticks(self, values: Sequence[float], text: Callable[[float], str]) -> None:
        for value in values:
            y = self.y(value)
            self.parts.append(f'<line x1="{LEFT}" x2="{WIDTH - RIGHT}" y1="{y}" y2="{y}" class="grid"/>')
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

    def polyline(self, points: Sequence[tuple[float, float]], style: str) -> None:
        path = " ".join(f"{self.x(x)},{self.y(y)}" for x, y in points)
        self.parts.append(f'<polyline points="{path}" class="{style}"/>')

    def circle(self, x: float, y: float, radius: float, style: str, title: str) -> None:
        self.parts.append(
            f'<circle cx="{self.x(x)}" cy="{self.y(y)}" r="{radius}" class="{style}">'
            f"<title>{escape(title)}</title></circle>"
        )

    def titles(self, x_title: str, y_title: str) -> None:
        middle = (LEFT + WIDTH - RIGHT) / 2
        self.parts.append(f'<text x="{middle}" y="{HEIGHT - 6}" text-anchor="middle">{escape(x_title)}</text>')
        if y_title:
            self.parts.append(f'<text x="{LEFT + 4}" y="{TOP + 8}" class="small">{escape(y_title)}</text>')

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
