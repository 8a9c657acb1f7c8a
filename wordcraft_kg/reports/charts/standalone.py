"""Charts in separate SVG files."""

import re
from collections.abc import Sequence

from markupsafe import Markup

from wordcraft_kg.reports.charts.plot import DARK, LETTER, LIGHT
from wordcraft_kg.reports.charts.scales import shortened
from wordcraft_kg.reports.charts.svg import element

_INK = {
    "ink": "#1b1f24",
    "soft": "#59636e",
    "line": "#d1d9e0",
    "other": "#8c959f",
    "page": "#ffffff",
}
_INK_ON_DARK = {
    "ink": "#e6edf3",
    "soft": "#9da7b1",
    "line": "#3d444d",
    "other": "#6e7681",
    "page": "#0d1117",
}
"""The colours of reports (``style.css.j2``) on a white and on a dark page."""
_FONTS = Markup("Helvetica, Arial, 'Liberation Sans', 'DejaVu Sans', sans-serif")
_PANEL = 460
MARGIN = 16
HEAD = 40
_CAPTION = 22
"""In pixels: width of a chart, space around charts, height of the title and of a caption."""
_HOVERED = re.compile(r'<circle [^>]*class="hit">.*?</circle>')
"""Invisible points that carry a tooltip."""
_VARIABLE = re.compile(r"var\(--(\w+)\)")
"""A colour by name."""
_MIX = re.compile(r"color-mix\(in srgb, #(\w{6}) (\d+)%, #(\w{6})\)")
"""Two colours as hexadecimal digits, and the first one's share."""


def figure(title: str, panels: Sequence[tuple[str, str]], style: str) -> str:
    """Return an SVG file with a title and charts, two in a row.

    Args:
        title: title of the file, also its text alternative.
        panels: caption (or empty) and SVG of each chart.
        style: CSS rules that SVG renderers know, see :func:`with_dark_page`.
    """
    columns = min(len(panels), 2) or 1
    width = MARGIN + columns * (_PANEL + MARGIN)
    # The title's letters are larger than those of charts, about by this factor.
    letter = LETTER * 1.3
    letters = int((width - 2 * MARGIN) / letter)
    heading = shortened(title, letters)
    look = "font-size: 15px; font-weight: 600"
    parts: list[str] = [element("text", heading, x=MARGIN, y=26, style=look)]
    top = HEAD
    for first in range(0, len(panels), columns):
        row = panels[first : first + columns]
        for column, (caption, chart) in enumerate(row):
            left = MARGIN + column * (_PANEL + MARGIN)
            if caption:
                most = int(_PANEL / LETTER)
                shown = shortened(caption, most)
                base_line = top + 14
                bold = "font-weight: 600"
                parts.append(element("text", shown, x=left, y=base_line, style=bold))
            height = _height(chart)
            place = f'x="{left}" y="{top + _CAPTION}"'
            size = f'width="{_PANEL}" height="{height}"'
            # Nobody hovers over a printed figure, and the invisible points would be drawn.
            plain = _HOVERED.sub("", str(chart))
            opening = f"<svg {place} {size} "
            parts.append(plain.replace("<svg ", opening, 1))
        # The highest chart of a row makes its height.
        highest = max(_height(chart) for _, chart in row)
        top += _CAPTION + highest + MARGIN
    # The attribute serves renderers without CSS; the rule of the class follows the colour scheme.
    page = element("rect", width=width, height=top, fill=_INK["page"], class_="page")
    lines = [
        element("title", title),
        f"<style>\n{style}</style>",
        page,
        *parts,
    ]
    # A line for each element, also for the tags around them all.
    content = Markup("\n" + "\n".join(lines) + "\n")
    whole = element(
        "svg",
        content,
        xmlns="http://www.w3.org/2000/svg",
        viewBox=f"0 0 {width} {top}",
        width=width,
        height=top,
        role="img",
        aria_label=title,
        font_family=_FONTS,
    )
    return f"{whole}\n"


def _height(chart: str) -> int:
    match = re.search(r'viewBox="0 0 [\d.]+ (\d+)', chart)
    return int(match[1]) if match else 0


def with_dark_page(style: str) -> str:
    """Return CSS rules for a white page, then their colours for screens with a dark page.

    Args:
        style: rules, one a line, with the colours of reports as ``var()`` and ``color-mix()``.
    """
    colours = "".join(f"{rule}\n" for rule in style.splitlines() if "var(" in rule)
    dark = resolved(colours, on_dark=True)
    return f"{resolved(style)}@media screen and (prefers-color-scheme: dark) {{\n{dark}}}\n"


def resolved(style: str, *, on_dark: bool = False) -> str:
    """Replace ``var()`` and ``color-mix()`` in CSS rules by colours for a white or a dark page.

    Renderers of SVG files do not know these functions.
    """
    values = dict(_INK_ON_DARK if on_dark else _INK)
    for number, colour in enumerate(DARK if on_dark else LIGHT):
        values[f"s{number}"] = colour
    plain = _VARIABLE.sub(lambda match: values[match[1]], style)
    return _MIX.sub(_mixed, plain)


def _mixed(match: re.Match[str]) -> str:
    """Return the colour of ``color-mix(in srgb, #one SHARE%, #other)``, channel by channel."""
    one, percent, other = match.groups()
    share = int(percent) / 100
    one_channels = bytes.fromhex(one)
    other_channels = bytes.fromhex(other)
    mixed = []
    for a, b in zip(one_channels, other_channels, strict=True):
        mixed.append(round(share * a + (1 - share) * b))
    return "#" + bytes(mixed).hex()
