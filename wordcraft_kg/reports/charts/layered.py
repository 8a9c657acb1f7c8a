"""Derivations as a layered graph, from left to right."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from itertools import chain

from markupsafe import Markup

from wordcraft_kg.reports.charts.chart import element, shortened, spread, titled

LETTER = 5.9
SMALL_LETTER = 5.2
"""Mean letter widths in pixels, for labels and for the ingredients below them."""
_LONGEST = 16
"""Most letters for a label in a box; a shortened label's tooltip is complete."""
_LONGEST_PART = 11
"""Most letters for an ingredient below a box."""
_BOX = 22
"""Height of a box in pixels."""
_GAP = 46
"""Least distance between the middles of two boxes of a layer: room for ingredients and arrows."""
_BETWEEN = 20
"""Distance between two layers, for the arrows' curves."""
_NARROWEST = 50
"""Least width of a layer."""
MARGIN = 8
_SWEEPS = 24
"""Passes that move boxes towards linked boxes, from the left and from the right in turn."""


@dataclass(frozen=True)
class Made:
    """An entity that is made.

    Attributes:
        label: the entity.
        href: address that its box links to, or empty.
        layer: number of the layer, from 1; the ingredients lie in earlier layers or belong to the
            base.
        of: labels of the ingredients.
        style: CSS class of the box, or empty.
        title: tooltip; empty for the label.
    """

    label: str
    href: str
    layer: int
    of: tuple[str, ...]
    style: str = ""
    title: str = ""


@dataclass
class _Place:
    """A node in the drawing: an entity, or the point where an arrow crosses a layer.

    Attributes:
        column: number of the layer in the drawing, from 0.
        before: nodes in the layer before from which an arrow comes.
        after: nodes in the next layer to which an arrow goes.
        y: height of the middle, in pixels.
    """

    column: int
    before: "list[_Place]"
    after: "list[_Place]"
    y: float = 0.0


def layered(things: Sequence[Made], given: Collection[str], description: str) -> Markup:
    """Draw entities in crafting order as boxes, with ingredients and arrows.

    Args:
        things: the entities, each with its layer and its ingredients.
        given: labels of the base entities; they have no box, and are bold among the ingredients.
        description: text alternative for people who do not see the drawing.
    """
    layers = [thing.layer for thing in things] or [1]
    first = min(layers)
    num_layers = max(layers) - first + 1
    columns: list[list[_Place]] = [[] for _ in range(num_layers)]
    place_of = {}
    for thing in things:
        place = _Place(thing.layer - first, [], [])
        place_of[thing.label] = place
        columns[place.column].append(place)
    arrows = _arrows(things, place_of, columns)
    _settle(columns)
    widths = _widths(things, first, num_layers)
    lefts = []
    x = MARGIN
    for width in widths:
        lefts.append(x)
        x += width + _BETWEEN
    places = list(chain.from_iterable(columns))
    heights = [place.y for place in places] or [0.0]
    top = min(heights) - _BOX / 2 - MARGIN
    lowest_middle = max(heights) - top
    # Below the last box lie its ingredients.
    bottom = lowest_middle + _GAP - _BOX / 2 + 6
    for place in places:
        place.y = round(place.y - top)
    width = lefts[-1] + widths[-1] + MARGIN
    height = round(bottom) + 18  # a line for the layers' numbers
    parts = []
    columns_of_page = zip(lefts, widths, strict=True)
    for number, (x, wide) in enumerate(columns_of_page, start=first):
        middle = x + wide / 2
        parts.append(_small(f"layer {number}", middle, height - 6))
    for title, route in arrows:
        curve = _curve(route, lefts, widths)
        parts.append(element("path", titled(title), d=curve, class_="arrow"))
    for thing in things:
        place = place_of[thing.label]
        x = lefts[place.column]
        thing_width = widths[place.column]
        parts += _box(thing, given, x, thing_width, int(place.y))
    return element(
        "svg",
        *parts,
        viewBox=f"0 0 {width} {height}",
        width=width,
        height=height,
        class_="layered",
        role="group",
        aria_label=description,
    )


def _small(text: str, middle: float, y: int) -> Markup:
    """Return a small text, or ready elements, around a middle."""
    return element("text", text, x=f"{middle:g}", y=y, class_="small middle")


def _widths(things: Sequence[Made], first: int, columns: int) -> list[int]:
    """Return each layer's width in pixels: that of its longest label or list of ingredients."""
    widths = [_NARROWEST] * columns
    for thing in things:
        label = shortened(thing.label, _LONGEST)
        ingredients = " + ".join(shortened(part, _LONGEST_PART) for part in thing.of)
        label_width = LETTER * len(label)
        ingredients_width = SMALL_LETTER * len(ingredients)
        # Four pixels on each side of a text keep it off the frame of its box.
        width = round(max(label_width, ingredients_width)) + 8
        column = thing.layer - first
        widths[column] = max(widths[column], width)
    return widths


def _arrows(
    things: Sequence[Made], place_of: dict[str, _Place], columns: list[list[_Place]]
) -> list[tuple[str, list[_Place]]]:
    """Link the places of ingredients and results, and return each arrow's tooltip and route.

    An arrow over several layers crosses each layer between at a place of its own, so that boxes
    make room for it. Arrows from the same entity share these places.
    """
    passing: dict[tuple[str, int], _Place] = {}
    arrows = []
    for thing in things:
        to = place_of[thing.label]
        # An ingredient that is used twice has one arrow; the base has none.
        for part in dict.fromkeys(thing.of):
            if part not in place_of:
                continue
            last = place_of[part]
            route = [last]
            for column in range(last.column + 1, to.column):
                crossing = passing.get((part, column))
                if crossing is None:
                    crossing = _Place(column, [last], [])
                    passing[part, column] = crossing
                    last.after.append(crossing)
                    columns[column].append(crossing)
                route.append(crossing)
                last = crossing
            last.after.append(to)
            to.before.append(last)
            title = f"{part} → {thing.label}"
            arrows.append((title, [*route, to]))
    return arrows


def _settle(layers: list[list[_Place]]) -> None:
    """Move nodes towards the mean of their neighbours, with gaps.

    Source: the sweeps of Sugiyama et al. 1981, "Methods for visual understanding of hierarchical
    system structures".
    """
    for layer in layers:
        centre = (len(layer) - 1) / 2
        for number, place in enumerate(layer):
            place.y = _GAP * (number - centre)
    for sweep in range(_SWEEPS):
        from_left = sweep % 2 == 0
        # Late sweeps use both sides; the last sweep straightens arrows to a single box.
        from_both_sides = _SWEEPS - 8 <= sweep < _SWEEPS - 1
        for layer in layers if from_left else reversed(layers):
            means = [_mean(place, from_left, from_both_sides) for place in layer]
            # Bounds so wide that they move nothing: only the gaps count.
            farthest = max(map(abs, means), default=0.0)
            reach = _GAP * len(layer) + farthest
            heights = spread(means, _GAP, -reach, reach)
            for place, y in zip(layer, heights, strict=True):
                place.y = y


def _mean(place: _Place, from_left: bool, both: bool) -> float:
    """Return the mean height of a node's neighbours on one side or on both.

    Without neighbours, it is the node's own height.
    """
    if both:
        near = place.before + place.after
    else:
        near = place.before if from_left else place.after
    if not near:
        return place.y
    total = sum(neighbour.y for neighbour in near)
    return total / len(near)


def _curve(route: list[_Place], lefts: list[int], widths: list[int]) -> str:
    """Return an arrow's SVG path: straight through the layers, curved between them, with a head."""
    start, *stops = route
    y = int(start.y)
    right = lefts[start.column] + widths[start.column]
    path = [f"M{right} {y}"]
    for place in stops:
        x = lefts[place.column]
        end = int(place.y)
        # Both control points lie half-way, at the height of their end: an S without overshoot.
        half = x - _BETWEEN / 2
        leaving = f"{half:g} {y}"
        arriving = f"{half:g} {end}"
        path.append(f"C{leaving} {arriving} {x} {end}")
        y = end
        if place is not route[-1]:
            right = x + widths[place.column]
            path.append(f"H{right}")
    return "".join(path) + "l-6-3m6 3l-6 3"


def _box(thing: Made, given: Collection[str], left: int, width: int, y: int) -> list[Markup]:
    """Return a box with its label, and the ingredients below, as SVG elements."""
    ingredients = []
    for part in thing.of:
        style = "given" if part in given else "made"
        shown = shortened(part, _LONGEST_PART)
        ingredients.append(element("tspan", shown, class_=style))
    of = Markup(" + ").join(ingredients)
    tooltip = titled(thing.title or thing.label)
    half = _BOX // 2
    frame = element(
        "rect",
        x=left,
        y=y - half,
        width=width,
        height=_BOX,
        rx=4,
        class_=thing.style,
    )
    middle = left + width / 2
    label = element(
        "text",
        shortened(thing.label, _LONGEST),
        x=f"{middle:g}",
        y=y + 4,
        class_=f"middle {thing.style}",
    )
    inside = [tooltip, frame, label]
    if thing.href:
        box = element("a", *inside, href=thing.href)
    else:
        box = element("g", *inside)
    # The base line of the ingredients, below the box.
    below = y + half + 12
    return [box, _small(of, middle, below)]
