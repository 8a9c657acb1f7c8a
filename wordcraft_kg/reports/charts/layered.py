"""Derivations as a layered graph, from left to right."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass

from markupsafe import Markup

from wordcraft_kg.base.escaping import for_html
from wordcraft_kg.reports.charts.scales import shortened, spread

LETTER, SMALL_LETTER = 5.9, 5.2
_LONGEST = 16
"""Most letters for a label in a box; a shortened label's tooltip is complete."""
_LONGEST_PART = 11
_BOX, _GAP, _BETWEEN = 22, 46, 20
_NARROWEST = 50
MARGIN = 8
_SWEEPS = 24
"""Passes that move boxes towards linked boxes, from the left and from the right in turn."""


@dataclass(frozen=True)
class Made:
    """An entity in a layer (from 1), made from the entities ``of`` in earlier layers; ``style`` is a CSS class."""

    label: str
    href: str
    layer: int
    of: tuple[str, ...]
    style: str = ""
    title: str = ""


@dataclass
class _Place:
    """A node in the drawing: an entity, or an arrow's layer crossing, with its neighbours in adjacent layers."""

    column: int
    before: "list[_Place]"
    after: "list[_Place]"
    y: float = 0.0


def layered(things: Sequence[Made], given: Collection[str], description: str) -> Markup:
    """Draw entities in crafting order as boxes, with ingredients and arrows; the base (``given``) is bold."""
    layers = [thing.layer for thing in things] or [1]
    first = min(layers)
    columns: list[list[_Place]] = [[] for _ in range(first, max(layers) + 1)]
    place_of = {thing.label: _Place(thing.layer - first, [], []) for thing in things}
    for place in place_of.values():
        columns[place.column].append(place)
    arrows = _arrows(things, place_of, columns)
    _settle(columns)
    widths = _widths(things, first, len(columns))
    lefts = [MARGIN + sum(widths[:i]) + _BETWEEN * i for i in range(len(widths))]
    places = [place for column in columns for place in column]
    heights = [place.y for place in places] or [0.0]
    top = min(heights) - _BOX / 2 - MARGIN
    bottom = max(heights) - top + _GAP - _BOX / 2 + 6
    for place in places:
        place.y = round(place.y - top)
    width, height = lefts[-1] + widths[-1] + MARGIN, round(bottom) + 18
    parts = [
        f'<svg viewBox="0 0 {width} {height}" width="{width}" height="{height}" class="layered" role="group" '
        f'aria-label="{for_html(description)}">'
    ]
    for number, (left, wide) in enumerate(zip(lefts, widths, strict=True), start=first):
        parts.append(
            f'<text x="{left + wide / 2:g}" y="{height - 6}" class="small middle">layer {number}</text>'
        )
    parts += [
        f'<path d="{_curve(route, lefts, widths)}" class="arrow">{title}</path>'
        for title, route in arrows
    ]
    for thing in things:
        place = place_of[thing.label]
        parts += _box(thing, given, lefts[place.column], widths[place.column], int(place.y))
    return Markup("".join([*parts, "</svg>"]))


def _widths(things: Sequence[Made], first: int, columns: int) -> list[int]:
    widths = [_NARROWEST] * columns
    for thing in things:
        of = " + ".join(shortened(part, _LONGEST_PART) for part in thing.of)
        letters = max(LETTER * len(shortened(thing.label, _LONGEST)), SMALL_LETTER * len(of))
        widths[thing.layer - first] = max(widths[thing.layer - first], round(letters) + 8)
    return widths


def _arrows(
    things: Sequence[Made], place_of: dict[str, _Place], columns: list[list[_Place]]
) -> list[tuple[str, list[_Place]]]:
    passing: dict[tuple[str, int], _Place] = {}
    arrows = []
    for thing in things:
        to = place_of[thing.label]
        for part in (part for part in dict.fromkeys(thing.of) if part in place_of):
            route = [place_of[part]]
            for column in range(route[0].column + 1, to.column):
                if (part, column) not in passing:
                    passing[part, column] = place = _Place(column, [route[-1]], [])
                    route[-1].after.append(place)
                    columns[column].append(place)
                route.append(passing[part, column])
            route[-1].after.append(to)
            to.before.append(route[-1])
            arrows.append(
                (f"<title>{for_html(part)} → {for_html(thing.label)}</title>", [*route, to])
            )
    return arrows


def _settle(layers: list[list[_Place]]) -> None:
    """Move nodes towards the mean of their neighbours, with gaps."""
    for layer in layers:
        for number, place in enumerate(layer):
            place.y = _GAP * (number - (len(layer) - 1) / 2)
    for sweep in range(_SWEEPS):
        from_left = sweep % 2 == 0
        for layer in layers if from_left else reversed(layers):
            # Late sweeps use both sides; the last sweep straightens arrows to a single box.
            wanted = [
                _mean(place, from_left, _SWEEPS - 8 <= sweep < _SWEEPS - 1) for place in layer
            ]
            reach = _GAP * len(layer) + max(map(abs, wanted), default=0.0)
            for place, y in zip(layer, spread(wanted, _GAP, -reach, reach), strict=True):
                place.y = y


def _mean(place: _Place, from_left: bool, both: bool) -> float:
    near = place.before + place.after if both else place.before if from_left else place.after
    return sum(one.y for one in near) / len(near) if near else place.y


def _curve(route: list[_Place], lefts: list[int], widths: list[int]) -> str:
    y = int(route[0].y)
    path = [f"M{lefts[route[0].column] + widths[route[0].column]} {y}"]
    for place in route[1:]:
        left, end = lefts[place.column], int(place.y)
        path.append(f"C{left - _BETWEEN / 2:g} {y} {left - _BETWEEN / 2:g} {end} {left} {end}")
        y = end
        if place is not route[-1]:
            path.append(f"H{left + widths[place.column]}")
    return "".join(path) + "l-6-3m6 3l-6 3"


def _box(thing: Made, given: Collection[str], left: int, width: int, y: int) -> list[str]:
    of = " + ".join(
        f'<tspan class="{"given" if part in given else "made"}">{for_html(shortened(part, _LONGEST_PART))}</tspan>'
        for part in thing.of
    )
    middle, label = left + width / 2, for_html(shortened(thing.label, _LONGEST))
    inside = (
        f"<title>{for_html(thing.title or thing.label)}</title>"
        f'<rect x="{left}" y="{y - _BOX // 2}" width="{width}" height="{_BOX}" rx="4" class="{thing.style}"/>'
        f'<text x="{middle:g}" y="{y + 4}" class="middle {thing.style}">{label}</text>'
    )
    return [
        f'<a href="{for_html(thing.href)}">{inside}</a>' if thing.href else f"<g>{inside}</g>",
        f'<text x="{middle:g}" y="{y + _BOX // 2 + 12}" class="small middle">{of}</text>',
    ]
