"""Pictures without axes: maps of points and of links, a bar of contributions, and a matrix as an image."""

import base64
import json
import math
import struct
import zlib
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from html import escape

import numpy as np
from markupsafe import Markup

from wordcraft_kg.reports.charts.plot import COLOURS, SMALL_LETTER
from wordcraft_kg.reports.charts.scales import Labels, shortened


def labelled_points(
    points: np.ndarray, labels: Sequence[str], groups: Sequence[int], order: Sequence[int], description: str
) -> Markup:
    """Draw a map of points coloured by group, all with tooltips; labels take their places in ``order``."""
    width, height = 940, 640
    low, high = points.min(axis=0), points.max(axis=0)
    scaled = (points - low) / np.where(high > low, high - low, 1) * [width - 110, height - 30] + [10, 15]
    places = scaled.round(1).tolist()
    parts = [f'<svg viewBox="0 0 {width} {height}" class="map" role="img" aria-label="{escape(description)}">']
    for (x, y), label, group in zip(places, labels, groups, strict=True):
        title = f"<title>{escape(label)}</title>"
        parts.append(f'<circle cx="{x}" cy="{y}" r="3.5" class="dot {colour_of(group)}">{title}</circle>')
    room = Labels(10.05)
    for i in order:
        x, y = places[i]
        if room.take(x, x + 8 + SMALL_LETTER * len(labels[i]), y):
            parts.append(f'<text x="{x + 5}" y="{y + 3}" class="small">{escape(labels[i])}</text>')
    return Markup("".join([*parts, "</svg>"]))


def contribution_bar(contributions: Mapping[str, float], scale: float, colours: Mapping[str, int]) -> Markup:
    """Draw contributions to a sum: positive ones stacked to the right of the middle, negative ones to the left.

    Args:
        contributions: values by name.
        scale: value that half the width represents.
        colours: number of each name's colour.
    """
    half, height = 70.0, 12
    ends = {True: half, False: half}
    parts = [f'<svg class="bar" viewBox="0 0 {2 * half:g} {height}" aria-hidden="true">']
    for name, value in contributions.items():
        width = min(abs(value) / scale, 1) * half if scale else 0.0
        is_positive = value >= 0
        left = ends[is_positive] if is_positive else ends[is_positive] - width
        ends[is_positive] = left + width if is_positive else left
        parts.append(
            f'<rect x="{left:.1f}" y="1" width="{width:.1f}" height="{height - 2}" class="series-{colours[name]}">'
            f"<title>{escape(name)}: {value:.2f}</title></rect>"
        )
    parts.append(f'<line x1="{half:g}" x2="{half:g}" y1="0" y2="{height}" class="grid"/></svg>')
    return Markup("".join(parts))


def matrix_image(
    values: np.ndarray, marked: np.ndarray, groups: Sequence[tuple[str, int]], description: str, size: int = 350
) -> Markup:
    """Draw a square matrix as an image, dark = low and bright = high by rank, marked cells red.

    Args:
        values: shape (N, N), float.
        marked: shape (N, N), bool.
        groups: name and size of each group of consecutive rows and columns, written along both sides where they fit.
        description: text for readers who cannot see it.
        size: largest side in pixels; larger matrices are averaged in blocks.
    """
    side, margin, line = 400, 64, 11
    step = math.ceil(len(values) / size)
    extent = math.ceil(len(values) / step) * step  # the last block may be of fewer rows, and is drawn as large
    image = base64.b64encode(_shades(values, marked, step)).decode()
    parts = [
        f'<svg viewBox="0 0 {side + margin} {side + margin}" class="matrix" data-extent="{extent}" role="img" '
        f'aria-label="{escape(description)}">',
        f'<image x="{margin}" y="{margin}" width="{side}" height="{side}" preserveAspectRatio="none" '
        f'href="data:image/png;base64,{image}"/>',
    ]
    begin, free = 0, 0.0
    for name, number in groups:
        middle, begin = margin + (begin + number / 2) / extent * side, begin + number
        edge = margin + begin / extent * side
        parts.append(f'<path d="M{margin - 6} {edge:.1f}h6M{edge:.1f} {margin - 6}v6" class="grid"/>')
        if middle >= free:
            free = middle + line
            text = f"<title>{escape(name)}</title>{escape(shortened(name, 11))}"
            parts.append(f'<text x="{margin - 8}" y="{middle + 3:.1f}" text-anchor="end" class="small">{text}</text>')
            parts.append(
                f'<text transform="translate({middle + 3:.1f} {margin - 8}) rotate(-90)" class="small">{text}</text>'
            )
    return Markup("".join([*parts, "</svg>"]))


def _shades(values: np.ndarray, marked: np.ndarray, step: int) -> bytes:
    """Return the picture of a matrix, averaged in blocks of ``step`` rows and columns, as a PNG file."""
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
    return _png(pixels, palette)


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


LONGEST = 24
"""Letters of a label; longer ones are cut, but complete in the tooltip."""
LETTER, LINE = 11.0, 22
"""Width of a letter and height of a line, in units of the map, where it is as wide as a page."""
SIDE, EDGE, RIGHT = 50, 40, 190
"""Margins left, above and below, and at the right, where labels need room."""


@dataclass(frozen=True)
class Dot:
    """A thing on the map: its place from the left and from above, its size (1 to 5), class of colour and tooltip."""

    label: str
    href: str
    x: int
    y: int
    size: int
    style: str
    title: str


@dataclass(frozen=True)
class Region:
    """The name of a part of the map, and its middle."""

    name: str
    x: int
    y: int


def world(
    dots: Sequence[Dot],
    regions: Sequence[Region],
    size: tuple[int, int],
    description: str,
    *,
    links: Mapping[str, Sequence[tuple[int, int]]],
    chosen: int | None = None,
    partners: Mapping[str, Collection[int]] | None = None,
) -> Markup:
    """Draw a map, whose links a script shows under the pointer.

    Args:
        dots: the things, in the order in which their labels take places.
        regions: names behind the dots.
        size: width and height of the map.
        description: text for readers who cannot see it.
        links: by kind, pairs of numbers of dots.
        chosen: number of a dot whose links are drawn.
        partners: by kind, which is a class, the dots that it is linked to.
    """
    partners = partners or {}
    near = {number for ends in partners.values() for number in ends} | ({chosen} if chosen is not None else set())
    width, height = size[0] + SIDE + RIGHT, size[1] + 2 * EDGE
    names = [f'<text x="{r.x}" y="{r.y}">{escape(shortened(r.name, LONGEST))}</text>' for r in regions]
    lines = [] if chosen is None else [_lines(dots, chosen, kind, ends) for kind, ends in partners.items()]
    room = Labels(LINE)
    order = sorted(range(len(dots)), key=lambda number: number not in near)
    shown = {number for number in order if room.take(*_place_of_label(dots[number]))}
    roles = dict.fromkeys(near, " near") | ({chosen: " chosen"} if chosen is not None else {})
    circles = [_circle(dot, roles.get(number, "") + " far" * (number not in shown)) for number, dot in enumerate(dots)]
    others = {kind: _others(pairs, len(dots)) for kind, pairs in links.items()}
    return Markup(
        f'<svg viewBox="{-SIDE} {-EDGE} {width} {height}" class="world{" has-chosen" if near else ""}" role="group" '
        f'aria-label="{escape(description)}"><g class="view"><g class="regions">{"".join(names)}</g>'
        f'<g class="links">{"".join(lines)}</g><g class="dots">{"".join(circles)}</g></g></svg>'
        f'<script type="application/json" class="world-links">{json.dumps(others, separators=(",", ":"))}</script>'
    )


def _others(pairs: Sequence[tuple[int, int]], size: int) -> list[list[int]]:
    others: list[list[int]] = [[] for _ in range(size)]
    for one, other in pairs:
        others[one].append(other)
    return others


def _lines(dots: Sequence[Dot], chosen: int, kind: str, ends: Collection[int]) -> str:
    here = dots[chosen]
    path = "".join(f"M{here.x} {here.y}L{dots[end].x} {dots[end].y}" for end in ends if end != chosen)
    return f'<path class="{escape(kind)}" d="{path}"/>' if path else ""


def _circle(dot: Dot, classes: str) -> str:
    start, end = (f'a href="{escape(dot.href)}"', "a") if dot.href else ("g", "g")
    return (
        f'<{start} class="{dot.style} r{dot.size}{classes}"><title>{escape(dot.title)}</title>'
        f'<circle cx="{dot.x}" cy="{dot.y}"/>'
        f'<text x="{dot.x}" y="{dot.y}" dx=".8em">{escape(shortened(dot.label, LONGEST))}</text></{end}>'
    )


def _place_of_label(dot: Dot) -> tuple[float, float, int]:
    return dot.x - 8, dot.x + 14 + LETTER * min(len(dot.label), LONGEST), dot.y


def colour_of(number: int) -> str:
    """Return the class of a group's colour; groups beyond the colours there are, and what has none, are grey."""
    return f"series-{number}" if 0 <= number < COLOURS else "series-other"
