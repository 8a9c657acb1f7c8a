"""The map."""

from collections.abc import Mapping, Sequence
from operator import attrgetter
from typing import Any, Literal

import msgspec
import numpy as np
from numpy.typing import NDArray

from wordcraft_kg.apps.explorer.explored import Explored
from wordcraft_kg.apps.explorer.page import Addresses, Page, PageState
from wordcraft_kg.apps.explorer.pages import entity
from wordcraft_kg.apps.explorer.pages.entities import layers_of
from wordcraft_kg.base.progress import stage
from wordcraft_kg.base.records import Count, Record
from wordcraft_kg.graphs.arrays import Ids
from wordcraft_kg.graphs.recipe_graph import RecipeGraph
from wordcraft_kg.graphs.triples import COMBINES_WITH, COMPONENT_OF
from wordcraft_kg.reports import charts
from wordcraft_kg.reports.charts.scales import Labels, shortened

PLACED = 1_000
"""Maximum number of placed entities, by uses: layout time and memory grow quadratically."""
GUESTS = 60
"""Maximum number of guests: a chosen entity and neighbours without a place."""
LISTED = 60
NAMED = 3
"""Typical members that name a group."""
DRAWN = 200
"""Maximum number of drawn links of a kind: more are indistinguishable."""
ALL_LINKS = 15_000
"""Maximum number of links between placed entities; a larger map holds only the chosen entity's links."""
WIDTH, HEIGHT = 2_000, 1_400
"""Size of the map; places are whole numbers."""
PULL = 6.0
"""Strength of links within a group, relative to links between groups."""
ROUNDS = 100
"""Rounds of the layout; the picture hardly changes afterwards."""
SIDE, EDGE, RIGHT = 50, 40, 190
LONGEST = 24
"""Letters of a shown label; the tooltip has a longer one."""
LETTER, LINE = 11.0, 22
"""Letter width and line height, in map units at page width."""
SIZES = (5, 15, 40, 100)
SHADES = 4
"""Layer colours, in addition to the base colour."""


class MapState(PageState):
    """Page settings: an entity whose links are shown, and whether dot colours mark groups or crafting layers."""

    entity: str = ""
    colour: Literal["group", "layer"] = "group"


class Spot(Record):
    """An entity's dot on the map; the layer is -1 if it cannot be made.

    Guests, entities with too few uses for the map that are added for a chosen entity, have group -1.
    """

    entity: str
    x: Count
    y: Count
    uses: Count
    group: int
    layer: int


class Group(Record):
    """Entities that are crafted together, named after typical members, with their median place."""

    names: tuple[str, ...]
    size: Count
    x: Count
    y: Count


class Partners(Record):
    """An entity's neighbours by one link kind: number, most used labels, and spots on the map."""

    total: Count
    listed: tuple[str, ...]
    placed: tuple[Count, ...]


class Links(Record):
    """Links to draw: dot numbers for the chosen entity and its partners, products and ingredients."""

    entity: Count
    combines: Partners
    makes: Partners
    made_of: Partners


class MapView(Record):
    """The map's dots, groups and lines.

    Attributes:
        spots: dots for the most used entities in descending order, then for guests.
        combines: dot pairs whose entities combine; empty for more than :data:`ALL_LINKS` lines.
        components: (ingredient, product) pairs; likewise.
    """

    graph: str
    entities: Count
    spots: tuple[Spot, ...]
    groups: tuple[Group, ...]
    layers: Count
    combines: tuple[tuple[Count, Count], ...]
    components: tuple[tuple[Count, Count], ...]
    chosen: Links | None


@stage("laying out the map")
def map_of(graph: RecipeGraph) -> MapView:
    """Place and group a graph's most used entities, at most :data:`PLACED`; equal graphs have equal maps."""
    ids = np.argsort(-graph.use_counts, kind="stable")[:PLACED]
    combines, components = (
        _links_among(graph, ids, relation) for relation in (COMBINES_WITH, COMPONENT_OF)
    )
    combines = combines[combines[:, 0] < combines[:, 1]]
    links = np.unique(np.sort(np.concatenate([combines, components]), axis=1), axis=0)
    uses, layer = graph.use_counts[ids], layers_of(graph)
    group_of, typical = communities_of(len(ids), links)
    places = _places(len(ids), links, group_of)
    columns = (ids, *places.T, uses, group_of, layer[ids])
    groups = []
    for number, members in enumerate(typical):
        x, y = np.median(places[group_of == number], axis=0).round().astype(int).tolist()
        groups.append(Group(graph.labels(ids[members[:NAMED]]), len(members), x, y))
    is_small = len(combines) + len(components) <= ALL_LINKS
    return MapView(
        graph=graph.name,
        entities=graph.num_entities,
        spots=tuple(
            Spot(graph.entities[entity], *numbers)
            for entity, *numbers in zip(*(column.tolist() for column in columns), strict=True)
        ),
        groups=tuple(groups),
        layers=int(layer.max(initial=0)),
        combines=tuple(map(tuple, combines.tolist())) if is_small else (),
        components=tuple(map(tuple, components.tolist())) if is_small else (),
        chosen=None,
    )


def communities_of(size: int, links: Ids) -> tuple[Ids, list[Ids]]:
    """Find communities in an undirected graph by the Louvain method; ``links`` are pairs of nodes, shape (L, 2).

    Returns each node's group, shape (size,), group 0 the largest, and the nodes of each group, most typical first: the
    product of the number of links within the group and their share of all links is high.

    Source: Blondel et al. 2008, "Fast unfolding of communities in large networks".
    """
    import networkx as nx

    plain = nx.Graph()
    plain.add_nodes_from(range(size))
    plain.add_edges_from(links.tolist())
    groups = sorted(
        nx.community.louvain_communities(plain, seed=0), key=lambda group: (-len(group), min(group))
    )
    group_of = np.zeros(size, dtype=np.int64)
    for number, group in enumerate(groups):
        group_of[list(group)] = number
    ends = np.array([(a, b) for a, b in plain.edges if a != b], dtype=np.int64).reshape(-1, 2)
    is_within = group_of[ends[:, 0]] == group_of[ends[:, 1]]
    within, degree = (np.bincount(some.ravel(), minlength=size) for some in (ends[is_within], ends))
    typical = np.argsort(-(within**2) / np.maximum(degree, 1), kind="stable")
    return group_of, [typical[group_of[typical] == number] for number in range(len(groups))]


def _links_among(graph: RecipeGraph, ids: Ids, relation: int) -> Ids:
    number = np.full(graph.num_entities, -1)
    number[ids] = np.arange(len(ids))
    triples = graph.triples
    ends = number[triples[triples[:, 1] == relation][:, [0, 2]]]
    return np.unique(ends[(ends >= 0).all(axis=1) & (ends[:, 0] != ends[:, 1])], axis=0)


def _places(number: int, links: Ids, group_of: Ids) -> Ids:
    """Lay out entities with ForceAtlas2, and fill the map evenly; shape (number, 2), whole numbers.

    Links to frequent entities weigh less, since they would pull all others together; links within a group weigh more.

    Source: Jacomy et al. 2014, "ForceAtlas2, a continuous graph layout algorithm".
    """
    import networkx as nx

    if number < 2:
        return np.full((number, 2), [WIDTH // 2, HEIGHT // 2])
    degree = np.bincount(links.ravel(), minlength=number)
    weight = 1 / np.sqrt(degree[links].prod(axis=1))
    weight[group_of[links[:, 0]] == group_of[links[:, 1]]] *= PULL
    weighted = nx.Graph()
    weighted.add_nodes_from(range(number))
    weighted.add_weighted_edges_from(
        (a, b, w) for (a, b), w in zip(links.tolist(), weight.tolist(), strict=True)
    )
    layout = nx.forceatlas2_layout(weighted, max_iter=ROUNDS, weight="weight", seed=0)
    places = np.array([layout[entity] for entity in range(number)])
    # Mean of position and rank: true distances leave the map mostly empty, ranks alone hide gaps.
    low, high = places.min(axis=0), places.max(axis=0)
    rank = places.argsort(axis=0, kind="stable").argsort(axis=0, kind="stable") / (number - 1)
    even = ((places - low) / np.where(high > low, high - low, 1) + rank) / 2
    return (even * [WIDTH, HEIGHT]).round().astype(np.int64)


def view_map(graph: RecipeGraph, whole: MapView, entity: str = "") -> MapView:
    """Return a graph's map (``whole``), optionally with an entity's links, and guests if its partners have no place."""
    if not entity:
        return whole
    chosen = graph.id_of(entity)
    kinds = _partners(graph, chosen)
    spot_of = {graph.id_of(spot.entity): spot for spot in whole.spots}
    number_of, spots = {placed: number for number, placed in enumerate(spot_of)}, list(whole.spots)
    wanted = dict.fromkeys([chosen, *np.concatenate(kinds).tolist()])
    for guest in [one for one in wanted if one not in number_of][:GUESTS]:
        number_of[guest] = len(spots)
        spots.append(_guest(graph, spot_of, guest))
    combines, makes, made_of = (
        Partners(
            len(kind),
            graph.labels(kind[:LISTED].tolist()),
            tuple(number_of[one] for one in kind.tolist() if one in number_of)[:DRAWN],
        )
        for kind in kinds
    )
    links = Links(number_of[chosen], combines, makes, made_of)
    return msgspec.structs.replace(whole, spots=tuple(spots), chosen=links)


def _partners(graph: RecipeGraph, entity: int) -> tuple[Ids, Ids, Ids]:
    used = graph.recipes[graph.uses_of(entity)]
    others = used[:, :2].sum(axis=1) - entity
    made_of = graph.recipes[graph.recipes_of(entity), :2]
    kinds = (np.unique(ids) for ids in (others, used[:, 2], made_of))
    one, two, three = (ids[np.argsort(-graph.use_counts[ids], kind="stable")] for ids in kinds)
    return one, two, three


def _guest(graph: RecipeGraph, spot_of: Mapping[int, Spot], entity: int) -> Spot:
    neighbours = np.unique(np.concatenate(_partners(graph, entity))).tolist()
    near = [(spot_of[one].x, spot_of[one].y) for one in neighbours if one in spot_of]
    middle = np.mean(near or [(WIDTH // 2, HEIGHT // 2)], axis=0)
    # Offset by the golden angle, so that guests with equal partners do not overlap.
    angle = 2.4 * entity
    aside: NDArray[np.float64] = 40 * np.array([np.cos(angle), np.sin(angle)])
    x, y = (middle + aside).clip(0, [WIDTH, HEIGHT]).round().astype(int).tolist()
    return Spot(
        graph.entities[entity],
        x,
        y,
        int(graph.use_counts[entity]),
        -1,
        int(layers_of(graph)[entity]),
    )


def _view(explored: Explored, state: MapState) -> MapView:
    graph = explored.opened.graph
    return view_map(graph, explored.once("map", lambda: map_of(graph)), state.entity)


def _draw(view: MapView, state: MapState, address: Addresses) -> Mapping[str, Any]:
    has_groups, chosen, roles = state.colour == "group", view.chosen, dict[int, str]()
    if chosen is not None:
        near = (*chosen.combines.placed, *chosen.makes.placed, *chosen.made_of.placed)
        roles = {**dict.fromkeys(near, " near"), chosen.entity: " chosen"}
    # A chosen entity and its partners are named first, then those with the most uses.
    room = Labels(LINE)
    order = sorted(range(len(view.spots)), key=lambda number: number not in roles)
    named = {number for number in order if room.take(*_place_of_label(view.spots[number]))}
    dots = []
    for number, spot in enumerate(view.spots):
        style = charts.colour_of(spot.group) if has_groups else _shade_of(spot, view.layers)
        size = 1 + sum(spot.uses >= least for least in SIZES)
        # A static site has entity pages, but no map for each entity.
        href = address(PAGE, MapState(entity=spot.entity, colour=state.colour))
        href = href or address(entity.PAGE, entity.EntityState(entity=spot.entity))
        dots.append(
            (spot, href, f"{style} r{size}{roles.get(number, '')}{' far' * (number not in named)}")
        )
    links = {"combines": view.combines, "components": view.components}
    return {
        "box": (-SIDE, -EDGE, WIDTH + SIDE + RIGHT, HEIGHT + 2 * EDGE),
        "dots": dots,
        "links": {kind: _others(pairs, len(dots)) for kind, pairs in links.items()},
        "shortened": lambda label: shortened(label, LONGEST),
        "legend": _groups(view) if has_groups else _layers(view),
    }


def _place_of_label(spot: Spot) -> tuple[float, float, int]:
    return spot.x - 8, spot.x + 14 + LETTER * min(len(spot.entity), LONGEST), spot.y


def _others(pairs: Sequence[tuple[int, int]], size: int) -> list[list[int]]:
    others: list[list[int]] = [[] for _ in range(size)]
    for one, other in pairs:
        others[one].append(other)
    return others


def _groups(view: MapView) -> list[tuple[str, str, int]]:
    shown = [
        (charts.colour_of(number), ", ".join(group.names), group.size)
        for number, group in enumerate(view.groups)
    ]
    others = sum(size for _, _, size in shown[charts.COLOURS :])
    return shown[: charts.COLOURS] + ([("series-other", "other groups", others)] if others else [])


def _layers(view: MapView) -> list[tuple[str, str, int]]:
    layers_of: dict[str, list[int]] = {}
    for spot in view.spots:
        layers_of.setdefault(_shade_of(spot, view.layers), []).append(spot.layer)
    legend = []
    for shade, members in sorted(layers_of.items(), key=lambda entry: entry[1][0]):
        low, high = min(members), max(members)
        name = "cannot be made" if low < 0 else "base" if high == 0 else f"layer {low}"
        legend.append((shade, name if low == high else f"layers {low} to {high}", len(members)))
    return legend


def _shade_of(spot: Spot, layers: int) -> str:
    if spot.layer < 0:
        return "series-other"
    return f"shade-{0 if spot.layer == 0 else 1 + (spot.layer - 1) * SHADES // layers}"


PAGE = Page(
    "map",
    MapState,
    _view,
    title="Map",
    draw=_draw,
    exported=lambda _: (MapState(), MapState(colour="layer")),
    questions=lambda _: [("Which entities are crafted together?", MapState())],
    is_there=attrgetter("opened.graph.num_entities"),
)
