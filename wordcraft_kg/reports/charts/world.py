"""A map of labelled dots, each a link, that a script may move and zoom; it shows the same without one."""

import json
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from html import escape

from markupsafe import Markup

from wordcraft_kg.reports.charts.palette import COLOURS
from wordcraft_kg.reports.charts.scales import shortened

LONGEST = 24
"""Letters of a label; longer ones are cut, but complete in the tooltip."""
LETTER, LINE = 11.0, 22
"""Width of a letter and height of a line, in units of the map, where it is as wide as a page."""
SIDE, EDGE, RIGHT = 50, 40, 190
"""Margins left, above and below, and at the right, where labels need room."""


@dataclass(frozen=True)
class Dot:
    """A thing on the map.

    Attributes:
        label: its name.
        href: where it leads to; may be empty.
        x: place from the left.
        y: place from above.
        size: 1 to 5.
        style: class of its colour.
        title: its tooltip.
    """

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
    """Draw a map.

    Args:
        dots: the things, the most important first: their labels are placed first, those of the others where they fit.
        regions: names behind the dots.
        size: width and height of the map.
        description: text for readers who cannot see it.
        links: by kind, which dots are linked, by their numbers; none is drawn, but a script shows those of the dot
            under the pointer. It finds, by kind and for each dot, the list of those that it is linked to.
        chosen: number of a dot whose links are drawn.
        partners: by kind, the dots that it is linked to. A kind is a class.
    """
    partners = partners or {}
    near = {number for ends in partners.values() for number in ends} | ({chosen} if chosen is not None else set())
    width, height = size[0] + SIDE + RIGHT, size[1] + 2 * EDGE
    parts = [
        f'<svg viewBox="{-SIDE} {-EDGE} {width} {height}" class="world{" has-chosen" if near else ""}" role="group" '
        f'aria-label="{escape(description)}"><g class="view"><g class="regions">'
    ]
    parts += [f'<text x="{r.x}" y="{r.y}">{escape(shortened(r.name, LONGEST))}</text>' for r in regions]
    parts.append('</g><g class="links">')
    if chosen is not None:
        here = dots[chosen]
        for kind, ends in partners.items():
            lines = "".join(f"M{here.x} {here.y}L{dots[end].x} {dots[end].y}" for end in ends if end != chosen)
            parts.append(f'<path class="{escape(kind)}" d="{lines}"/>' if lines else "")
    parts.append('</g><g class="dots">')
    order = sorted(range(len(dots)), key=lambda number: number not in near)
    is_labelled = _labelled([dots[number] for number in order])
    shown = {number for number, is_shown in zip(order, is_labelled, strict=True) if is_shown}
    for number, dot in enumerate(dots):
        classes = [dot.style, f"r{dot.size}"]
        classes += ["chosen"] if number == chosen else ["near"] if number in near else []
        classes += [] if number in shown else ["far"]
        inside = (
            f'<title>{escape(dot.title)}</title><circle cx="{dot.x}" cy="{dot.y}"/>'
            f'<text x="{dot.x}" y="{dot.y}" dx=".8em">{escape(shortened(dot.label, LONGEST))}</text>'
        )
        start, end = (f'a href="{escape(dot.href)}"', "a") if dot.href else ("g", "g")
        parts.append(f'<{start} class="{" ".join(classes)}">{inside}</{end}>')
    others: dict[str, list[list[int]]] = {kind: [[] for _ in dots] for kind in links}
    for kind, pairs in links.items():
        for one, other in pairs:
            others[kind][one].append(other)
    encoded = json.dumps(others, separators=(",", ":"))
    parts.append(f'</g></g></svg><script type="application/json" class="world-links">{encoded}</script>')
    return Markup("".join(parts))


def _labelled(dots: Sequence[Dot]) -> list[bool]:
    """Return which dots have room for their labels, which the earlier ones take."""
    taken: dict[int, list[tuple[float, float, int]]] = {}
    found = []
    for dot in dots:
        start, end = dot.x - 8, dot.x + 14 + LETTER * min(len(dot.label), LONGEST)
        row = dot.y // LINE
        others = [one for near in (row - 1, row, row + 1) for one in taken.get(near, [])]
        fits = all(start > right or end < left or abs(dot.y - y) >= LINE for left, right, y in others)
        if fits:
            taken.setdefault(row, []).append((start, end, dot.y))
        found.append(fits)
    return found


def colour_of(number: int) -> str:
    """Return the class of a group's colour; groups beyond the colours there are, and what has none, are grey."""
    return f"series-{number}" if 0 <= number < COLOURS else "series-other"
