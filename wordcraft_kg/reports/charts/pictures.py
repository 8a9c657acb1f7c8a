"""Pictures without axes: a map of points, a bar of contributions, and a matrix as an image."""

import base64
import math
import struct
import zlib
from collections.abc import Mapping, Sequence
from html import escape

import numpy as np
from markupsafe import Markup


def labelled_points(
    points: np.ndarray, labels: Sequence[str], groups: Sequence[int], order: Sequence[int], description: str
) -> Markup:
    """Draw a map of points coloured by group; all have tooltips; labels are placed in ``order`` where they fit."""
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
    """Draw contributions to a sum: positive ones stacked to the right of the middle, negative ones to the left.

    Args:
        contributions: values by name, in the order of their colours.
        scale: value that half the width represents.
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
        description: text for readers who cannot see it.
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
