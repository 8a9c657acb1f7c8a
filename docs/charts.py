"""Pictures of values with intervals for README, the evidence pages and the results.

They follow the reader's colour scheme, and keep their words readable on a phone.
"""

import re
from collections.abc import Sequence
from html import escape
from typing import NamedTuple

NUMBER = r"(?<![\d.,])[-+]?(?:\d{1,3}(?:,\d{3})+|\d*\.\d+|\d+)"
INTERVAL = re.compile(rf"({NUMBER})\**(?: \[({NUMBER}), ({NUMBER})\])?")
WIDTH, LINE, LONGEST, SCALE = 400, 16, 44, 1.15
"""Units of the picture (a phone shows most of them as a pixel), and letters of a label's line,
and pixels of a unit on a wide screen."""
STYLE = """
.ground { fill: #ffffff; } text { fill: #1b1f24; font-size: 13px; } .grid { stroke: #d0d7de; }
.s0 { fill: #0072b2; stroke: #0072b2; } .s1 { fill: #b84700; stroke: #b84700; }
text.s0, text.s1 { stroke: none; font-weight: 600; }
@media (prefers-color-scheme: dark) {
.ground { fill: #1e2129; } text { fill: #e6edf3; } .grid { stroke: #444c56; }
.s0 { fill: #6cb8f0; stroke: #6cb8f0; } .s1 { fill: #ffa657; stroke: #ffa657; } }
"""
"""Colours of the picture; its own ground keeps it readable where a page has another scheme."""


class Mark(NamedTuple):
    """A value with its interval; the ends equal the value without one."""

    value: float
    low: float
    high: float
    text: str


def read_mark(cell: str) -> Mark | None:
    """Return the first value of a table's cell; None if the cell has no number."""
    found = INTERVAL.search(cell)
    if found is None:
        return None
    value, low, high = (
        float(part.replace(",", ""))
        for part in (found[1], found[2] or found[1], found[3] or found[1])
    )
    return Mark(value, min(low, value), max(high, value), found[1])


def wrapped(label: str) -> list[str]:
    """Return a label in lines that fit above its marks."""
    lines = [""]
    for word in label.split():
        if lines[-1] and len(lines[-1]) + 1 + len(word) > LONGEST:
            lines.append("")
        lines[-1] = f"{lines[-1]} {word}".strip()
    return lines


def chart(
    title: str, series: Sequence[str], rows: Sequence[tuple[str, Sequence[Mark | None]]]
) -> str:
    """Return a picture of values with intervals: a label above each row, a line for each series.

    Labels stand above their marks, so that a narrow screen shows both in a readable size.

    Raises:
        ValueError: for more than two series; no further one has a colour.
    """
    if len(series) > 2:
        raise ValueError(f"'{title}' has {len(series)} series; expected one or two")
    marks = [mark for _, row in rows for mark in row if mark]
    low = min(0.0, *(mark.low for mark in marks))
    high = max(mark.high for mark in marks)
    high = 1.0 if 0.5 < high <= 1 and low == 0 else high
    left, right = 14, WIDTH - 24 - 8 * max(len(mark.text) for mark in marks)
    scale = (right - left) / (high - low)
    y = 26 + LINE * len(wrapped(title))
    parts: list[str] = []
    if len(series) > 1:
        x = left
        for number, name in enumerate(series):
            parts.append(f'<text x="{x}" y="{y}" class="s{number}">{escape(name)}</text>')
            x += 9 * len(name) + 16
        y += LINE + 6
    for label, row in rows:
        for line in wrapped(label):
            parts.append(f'<text x="{left}" y="{y + 4}">{escape(line)}</text>')
            y += LINE
        for number, mark in enumerate(row):
            if mark is None:
                continue
            at, first, last = (
                left + scale * (end - low) for end in (mark.value, mark.low, mark.high)
            )
            zero = left + scale * (0 - low)
            begin, end = sorted((zero, at))
            parts.append(
                f'<line x1="{zero:.1f}" x2="{zero:.1f}" y1="{y - 8}" y2="{y + 8}" class="grid"/>'
            )
            parts.append(
                f'<rect x="{begin:.1f}" y="{y - 5}" width="{end - begin:.1f}" height="10" class="s{number}" '
                'style="stroke: none" fill-opacity=".35"/>'
            )
            if last > first:
                parts.append(
                    f'<line x1="{first:.1f}" x2="{last:.1f}" y1="{y}" y2="{y}" class="s{number}" stroke-width="2"/>'
                )
            parts.append(f'<circle cx="{at:.1f}" cy="{y}" r="3" class="s{number}"/>')
            parts.append(
                f'<text x="{max(last, at, zero) + 8:.1f}" y="{y + 4}" class="s{number}">{escape(mark.text)}</text>'
            )
            y += LINE + 2
        y += 8
    heading = [
        f'<text x="{left}" y="{20 + LINE * number}" style="font-weight: 600">{escape(line)}</text>'
        for number, line in enumerate(wrapped(title))
    ]
    whole = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {y}" width="{WIDTH * SCALE:.0f}" '
        f'height="{y * SCALE:.0f}" role="img" font-family="system-ui, sans-serif">',
        f"<title>{escape(title)}</title>",
        f"<style>{STYLE}</style>",
        f'<rect class="ground" width="{WIDTH}" height="{y}"/>',
        *heading,
        *parts,
        "</svg>",
    ]
    return "\n".join(whole) + "\n"


def plain(text: str) -> str:
    """Return a text without the marks of Markdown."""
    return re.sub(r"\[(.*?)\]\(.*?\)", r"\1", text).replace("*", "").replace("`", "").strip()
