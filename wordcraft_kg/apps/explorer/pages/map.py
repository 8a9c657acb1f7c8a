"""The map: all entities, those that are crafted together beside each other, and the links of a chosen one."""

from collections.abc import Mapping
from typing import Any, Literal

from wordcraft_kg.apps.explorer.explored import Explored
from wordcraft_kg.apps.explorer.page import Addresses, Page, State
from wordcraft_kg.apps.explorer.pages import entity
from wordcraft_kg.apps.explorer.views.maps import HEIGHT, WIDTH, MapView, Spot, map_of, view_map
from wordcraft_kg.reports import charts

SIZES = (5, 15, 40, 100)
"""Numbers of uses from which on a dot is larger."""
SHADES = 4
"""Colours of layers, besides that of the base."""


class Map(State):
    """The map.

    Attributes:
        entity: whose links are shown; may be none.
        colour: what the colours of the dots mean.
    """

    entity: str = ""
    colour: Literal["group", "layer"] = "group"


def _view(explored: Explored, state: Map) -> MapView:
    found = explored.once("map", lambda: map_of(explored.opened.graph))
    return view_map(found, state.entity)


def _draw(view: MapView, state: Map, address: Addresses) -> Mapping[str, Any]:
    has_groups = state.colour == "group"
    dots = [
        charts.Dot(
            label=spot.entity,
            # A static site has no map for each choice, but a page of each entity.
            href=address(PAGE, Map(entity=spot.entity, colour=state.colour))
            or address(entity.PAGE, entity.Entity(entity=spot.entity)),
            x=spot.x,
            y=spot.y,
            size=1 + sum(spot.uses >= least for least in SIZES),
            style=charts.colour_of(spot.group) if has_groups else _shade_of(spot, view.layers),
            title=f"{spot.entity} · layer {spot.layer}" if spot.layer >= 0 else f"{spot.entity} · cannot be made",
        )
        for spot in view.spots
    ]
    chosen = view.chosen
    partners = (
        {}
        if chosen is None
        else {
            "combines": chosen.combines.placed,
            "makes": chosen.makes.placed,
            "made-of": chosen.made_of.placed,
        }
    )
    picture = charts.world(
        dots,
        [charts.Region(group.name, group.x, group.y) for group in view.groups if group.size > 1],
        (WIDTH, HEIGHT),
        f"Map of {len(dots):,} entities",
        links={"combines": view.combines, "components": view.components},
        chosen=None if chosen is None else chosen.entity,
        partners=partners,
    )
    return {"map": picture, "legend": _groups(view) if has_groups else _layers(view)}


def _groups(view: MapView) -> list[tuple[str, str, int]]:
    """Return class, name and size of each group with a colour, and of all others together."""
    shown = [(charts.colour_of(number), group.name, group.size) for number, group in enumerate(view.groups)]
    others = sum(size for _, _, size in shown[charts.COLOURS :])
    return shown[: charts.COLOURS] + ([("series-other", "other groups", others)] if others else [])


def _layers(view: MapView) -> list[tuple[str, str, int]]:
    """Return class, meaning and number of entities of each colour of layers."""
    shades = [_shade_of(spot, view.layers) for spot in view.spots]
    ranges: dict[str, list[int]] = {}
    for spot, shade in zip(view.spots, shades, strict=True):
        ranges.setdefault(shade, []).append(spot.layer)
    found = []
    for shade in sorted(ranges, key=lambda shade: ranges[shade][0]):
        low, high = min(ranges[shade]), max(ranges[shade])
        name = "cannot be made" if low < 0 else "base" if high == 0 else f"layer {low}"
        found.append((shade, name if low == high else f"layers {low} to {high}", len(ranges[shade])))
    return found


def _shade_of(spot: Spot, layers: int) -> str:
    if spot.layer < 0:
        return "series-other"
    return f"shade-{0 if spot.layer == 0 else 1 + (spot.layer - 1) * SHADES // layers}"


def _is_there(explored: Explored) -> bool:
    return explored.opened.graph.num_entities > 0


def _exported(_: Explored) -> list[Map]:
    return [Map(), Map(colour="layer")]


PAGE = Page("map", Map, _view, title="Map", draw=_draw, exported=_exported, is_there=_is_there)
