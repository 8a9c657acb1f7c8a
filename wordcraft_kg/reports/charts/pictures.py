"""Pictures without axes: a map with entities and their links, and a contribution bar."""

import json
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from html import escape

from markupsafe import Markup

from wordcraft_kg.reports.charts.plot import COLOURS
from wordcraft_kg.reports.charts.scales import Labels, shortened


def contribution_bar(contributions: Mapping[str, float], scale: float, colours: Mapping[str, int]) -> Markup:
    """Draw a sum's terms by name as a bar: positive terms stacked to the right from the middle, negative to the left.

    Half the width is ``scale``; ``colours`` has colour numbers by name.
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


_LONGEST = 24
"""Longest label in letters; longer labels are shortened, with the full label as a tooltip."""
LETTER, LINE = 11.0, 22
"""Letter width and line height, in map units at page width."""
_SIDE, _EDGE, _RIGHT = 50, 40, 190
"""Margins: left, above and below, right."""


@dataclass(frozen=True)
class Dot:
    """An entity on the map: label, link target, coordinates, size (1 to 5), CSS colour class and tooltip."""

    label: str
    href: str
    x: int
    y: int
    size: int
    style: str
    title: str


@dataclass(frozen=True)
class Region:
    """A region on the map, with names in a column and the centre's coordinates."""

    names: tuple[str, ...]
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
    """Draw a map of a ``size`` (width and height); a script shows the links for the entity under the pointer.

    ``dots`` are entities by descending label priority, ``links`` dot number pairs by kind, ``chosen`` a dot number with
    visible links, and ``partners`` the dots linked to it by kind, a CSS class.
    """
    partners = partners or {}
    near = {number for ends in partners.values() for number in ends} | ({chosen} if chosen is not None else set())
    width, height = size[0] + _SIDE + _RIGHT, size[1] + 2 * _EDGE
    names = [f'<text x="{r.x}" y="{r.y}">{_stacked(r)}</text>' for r in regions]
    lines = [] if chosen is None else [_lines(dots, chosen, kind, ends) for kind, ends in partners.items()]
    room = Labels(LINE)
    order = sorted(range(len(dots)), key=lambda number: number not in near)
    shown = {number for number in order if room.take(*_place_of_label(dots[number]))}
    roles = dict.fromkeys(near, " near") | ({chosen: " chosen"} if chosen is not None else {})
    circles = [_circle(dot, roles.get(number, "") + " far" * (number not in shown)) for number, dot in enumerate(dots)]
    others = {kind: _others(pairs, len(dots)) for kind, pairs in links.items()}
    return Markup(
        f'<svg viewBox="{-_SIDE} {-_EDGE} {width} {height}" class="world{" has-chosen" if near else ""}" role="group" '
        f'aria-label="{escape(description)}"><g class="view"><g class="regions">{"".join(names)}</g>'
        f'<g class="links">{"".join(lines)}</g><g class="dots">{"".join(circles)}</g></g></svg>'
        f'<script type="application/json" class="world-links">{json.dumps(others, separators=(",", ":"))}</script>'
    )


def _stacked(region: Region) -> str:
    up = f"{-0.55 * (len(region.names) - 1):.2f}em"
    return "".join(
        f'<tspan x="{region.x}" dy="{"1.1em" if number else up}">{escape(shortened(name, _LONGEST))}</tspan>'
        for number, name in enumerate(region.names)
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
        f'<text x="{dot.x}" y="{dot.y}" dx=".8em">{escape(shortened(dot.label, _LONGEST))}</text></{end}>'
    )


def _place_of_label(dot: Dot) -> tuple[float, float, int]:
    return dot.x - 8, dot.x + 14 + LETTER * min(len(dot.label), _LONGEST), dot.y


def colour_of(number: int) -> str:
    """Return the CSS colour class for a group number; negative numbers and numbers beyond the palette are grey."""
    return f"series-{number}" if 0 <= number < COLOURS else "series-other"
