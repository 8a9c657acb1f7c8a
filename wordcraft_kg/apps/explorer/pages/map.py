"""The map: entities that are crafted together lie together; a chosen entity shows its links."""

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
from wordcraft_kg.reports.charts.chart import Labels, shortened

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
"""Maximum number of links between placed entities; a larger map has only the chosen entity's."""
WIDTH = 2_000
HEIGHT = 1_400
"""Size of the map in its own units, which the page scales; places are whole numbers."""
PULL = 6.0
"""Strength of links within a group, relative to others: equal links would not show groups."""
ROUNDS = 100
"""Rounds of the layout; the picture hardly changes afterwards."""
SIDE = 50
EDGE = 40
RIGHT = 190
"""Margins: left and right, top and bottom, and at the right room for the last dots' labels."""
LONGEST = 24
"""Letters of a shown label; the tooltip has a longer one."""
LETTER = 11.0
LINE = 22
"""Letter width and line height, in map units at page width."""
SIZES = (5, 15, 40, 100)
"""Numbers of uses from which on a dot is a size larger."""
SHADES = 4
"""Layer colours, in addition to the base colour."""


class MapState(PageState):
    """Page settings: links and colours.

    Attributes:
        entity: label of the entity whose links are shown; empty for none.
        colour: whether dot colours mark groups or crafting layers.
    """

    entity: str = ""
    colour: Literal["group", "layer"] = "group"


class Spot(Record):
    """An entity's dot on the map.

    Guests are entities with too few uses for the map that are added for a chosen entity.

    Attributes:
        entity: label.
        x: place from the left, from 0 to :data:`WIDTH`.
        y: place from the top, from 0 to :data:`HEIGHT`.
        uses: number of recipes that use the entity.
        group: number of the group; -1 for guests, which have none.
        layer: crafting layer, 0 for the base; -1 if the entity cannot be made.
    """

    entity: str
    x: Count
    y: Count
    uses: Count
    group: int
    layer: int


class Group(Record):
    """Entities that are crafted together.

    Attributes:
        names: labels of typical members, at most :data:`NAMED`.
        size: number of members.
        x: median place of the members, from the left.
        y: median place of the members, from the top.
    """

    names: tuple[str, ...]
    size: Count
    x: Count
    y: Count


class Partners(Record):
    """An entity's neighbours by one kind of link.

    Attributes:
        total: number of neighbours.
        listed: labels of the most used neighbours, at most :data:`LISTED`.
        placed: dot numbers of the neighbours on the map, the most used first, at most
            :data:`DRAWN`.
    """

    total: Count
    listed: tuple[str, ...]
    placed: tuple[Count, ...]


class Links(Record):
    """Links of the chosen entity.

    Attributes:
        entity: dot number of the entity.
        combines: partners, with which the entity makes something.
        makes: products of the recipes that use the entity.
        made_of: ingredients of the recipes that make the entity.
    """

    entity: Count
    combines: Partners
    makes: Partners
    made_of: Partners


class MapView(Record):
    """The map's dots, groups and lines.

    Attributes:
        graph: name of the graph.
        entities: number of entities in the graph, of which the map shows the most used.
        spots: dots for the most used entities in descending order, then for guests.
        groups: groups of the placed entities, the largest first.
        layers: number of crafting layers in the graph.
        combines: dot pairs whose entities combine, the smaller number first, without guests and
            without entities that combine with themselves; empty for more than :data:`ALL_LINKS`
            lines.
        components: (ingredient, product) pairs; likewise.
        chosen: links of the chosen entity; None without one.
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
    """Place and group a graph's most used entities, at most :data:`PLACED`.

    Equal graphs have equal maps. Groups are found among the placed entities alone: others would
    give groups that the map does not show.
    """
    ids = np.argsort(-graph.use_counts, kind="stable")[:PLACED]
    combines = _links_among(graph, ids, COMBINES_WITH)
    components = _links_among(graph, ids, COMPONENT_OF)
    # combinesWith is symmetric: of both directions, one is drawn.
    combines = combines[combines[:, 0] < combines[:, 1]]
    # For groups and places, a pair that is linked in both ways counts once.
    ends = np.sort(np.concatenate([combines, components]), axis=1)
    links = np.unique(ends, axis=0)
    layer = layers_of(graph)
    group_of, typical = communities_of(len(ids), links)
    places = _places(len(ids), links, group_of)
    groups = []
    for number, members in enumerate(typical):
        # The median stays among the members, where a mean would follow a few far ones.
        median = np.median(places[group_of == number], axis=0)
        x, y = median.round().astype(int).tolist()
        names = graph.labels(ids[members[:NAMED]])
        groups.append(Group(names=names, size=len(members), x=x, y=y))
    # Columns for all dots, in the order of a dot's fields; plain numbers, not NumPy's.
    labels = graph.labels(ids.tolist())
    columns = (*places.T, graph.use_counts[ids], group_of, layer[ids])
    numbers = [column.tolist() for column in columns]
    num_links = len(combines) + len(components)
    # A browser draws so many lines too slowly; those of a chosen entity are sent with it.
    if num_links > ALL_LINKS:
        combines = combines[:0]
        components = components[:0]
    return MapView(
        graph=graph.name,
        entities=graph.num_entities,
        spots=tuple(map(Spot, labels, *numbers)),
        groups=tuple(groups),
        layers=int(layer.max(initial=0)),
        combines=tuple(map(tuple, combines.tolist())),
        components=tuple(map(tuple, components.tolist())),
        chosen=None,
    )


def communities_of(size: int, links: Ids) -> tuple[Ids, list[Ids]]:
    """Find communities in an undirected graph by the Louvain method.

    Args:
        size: number of nodes.
        links: shape (L, 2), pairs of nodes; repetitions count once.

    Returns:
        each node's group, shape (size,), group 0 the largest; and the nodes of each group, most
        typical first. Typical nodes have many links within the group, which are a large share of
        all their links.

    Source: Blondel et al. 2008, "Fast unfolding of communities in large networks".
    """
    import networkx as nx

    plain = nx.Graph()
    plain.add_nodes_from(range(size))
    plain.add_edges_from(links.tolist())
    # A fixed seed and a total order (largest first, then by least node): equal graphs have equal
    # colours.
    communities = nx.community.louvain_communities(plain, seed=0)
    groups = sorted(communities, key=lambda group: (-len(group), min(group)))
    group_of = np.zeros(size, dtype=np.int64)
    for number, group in enumerate(groups):
        group_of[list(group)] = number
    edges = [(a, b) for a, b in plain.edges if a != b]
    # The reshape gives a graph without links two columns as well.
    ends = np.array(edges, dtype=np.int64).reshape(-1, 2)
    groups_of_ends = group_of[ends]
    is_within = groups_of_ends[:, 0] == groups_of_ends[:, 1]
    degree = np.bincount(ends.ravel(), minlength=size)
    within = np.bincount(ends[is_within].ravel(), minlength=size)
    # Number times share, within * (within / degree): the number alone would name entities that are
    # used everywhere, the share alone entities with a single link.
    score = within**2 / np.maximum(degree, 1)
    typical = np.argsort(-score, kind="stable")
    # The order over all nodes, cut into the orders within groups.
    group_of_typical = group_of[typical]
    members = [typical[group_of_typical == number] for number in range(len(groups))]
    return group_of, members


def _links_among(graph: RecipeGraph, ids: Ids, relation: int) -> Ids:
    """Return a relation's links between different entities of ``ids``, as indices, shape (L, 2)."""
    # -1 marks entities that are not on the map; their links are dropped below.
    number = np.full(graph.num_entities, -1)
    number[ids] = np.arange(len(ids))
    triples = graph.triples
    links = triples[triples[:, 1] == relation]
    ends = number[links[:, [0, 2]]]
    is_placed = (ends >= 0).all(axis=1)
    # A line from a dot to itself cannot be drawn.
    is_line = ends[:, 0] != ends[:, 1]
    return np.unique(ends[is_placed & is_line], axis=0)


def _places(number: int, links: Ids, group_of: Ids) -> Ids:
    """Lay out entities with ForceAtlas2, and fill the map evenly; shape (number, 2), whole numbers.

    Links to frequent entities weigh less, since they would pull all others together; links within a
    group weigh more.

    Source: Jacomy et al. 2014, "ForceAtlas2, a continuous graph layout algorithm".
    """
    import networkx as nx

    # The ranks below divide by number - 1.
    if number < 2:
        return np.full((number, 2), [WIDTH // 2, HEIGHT // 2])
    degree = np.bincount(links.ravel(), minlength=number)
    # At least 1 at both ends, which the link itself counts: no division by 0.
    degree_product = degree[links].prod(axis=1)
    weight = 1 / np.sqrt(degree_product)
    heads, tails = links.T
    is_within = group_of[heads] == group_of[tails]
    weight[is_within] *= PULL
    weighted = nx.Graph()
    weighted.add_nodes_from(range(number))
    # All links are built in, in this order: the layout depends on it.
    edges = zip(heads.tolist(), tails.tolist(), weight.tolist(), strict=True)
    weighted.add_weighted_edges_from(edges)
    layout = nx.forceatlas2_layout(weighted, max_iter=ROUNDS, weight="weight", seed=0)
    places = np.array([layout[entity] for entity in range(number)])
    # Mean of position and rank: true distances leave the map mostly empty, ranks alone hide gaps.
    low = places.min(axis=0)
    high = places.max(axis=0)
    # All places may lie on a line, which has no width to divide by.
    extent = np.where(high > low, high - low, 1)
    position = (places - low) / extent
    # Sorting the order gives ranks.
    order = places.argsort(axis=0, kind="stable")
    rank = order.argsort(axis=0, kind="stable") / (number - 1)
    even = (position + rank) / 2
    return (even * [WIDTH, HEIGHT]).round().astype(np.int64)


def view_map(graph: RecipeGraph, whole: MapView, entity: str = "") -> MapView:
    """Return a graph's map with an entity's links.

    Args:
        graph: the graph.
        whole: map of the graph, by :func:`map_of`.
        entity: label of the entity; empty for none.

    Returns:
        the map; the entity and its partners without a place are added as guests, at most
        :data:`GUESTS`.

    Raises:
        UnknownEntityError: if the graph has no such entity.
    """
    if not entity:
        return whole
    entity_id = graph.id_of(entity)
    kinds = _partners(graph, entity_id)
    spot_of = {graph.id_of(spot.entity): spot for spot in whole.spots}
    number_of = {placed_id: number for number, placed_id in enumerate(spot_of)}
    spots = list(whole.spots)
    # The entity itself first, so that it has a place among many partners; each of them once.
    shown_ids = dict.fromkeys([entity_id, *np.concatenate(kinds).tolist()])
    without_place = [shown_id for shown_id in shown_ids if shown_id not in number_of]
    for guest in without_place[:GUESTS]:
        number_of[guest] = len(spots)
        spots.append(_guest(graph, spot_of, guest))
    combines, makes, made_of = (_shown_partners(graph, kind, number_of) for kind in kinds)
    links = Links(
        entity=number_of[entity_id],
        combines=combines,
        makes=makes,
        made_of=made_of,
    )
    return msgspec.structs.replace(whole, spots=tuple(spots), chosen=links)


def _shown_partners(graph: RecipeGraph, partners: Ids, number_of: Mapping[int, int]) -> Partners:
    spots = [number_of[partner] for partner in partners.tolist() if partner in number_of]
    return Partners(
        total=len(partners),
        listed=graph.labels(partners[:LISTED].tolist()),
        placed=tuple(spots[:DRAWN]),
    )


def _partners(graph: RecipeGraph, entity: int) -> tuple[Ids, Ids, Ids]:
    """Return an entity's partners, products and ingredients, as ids, each the most used first."""
    recipes = graph.sets[graph.uses_of(entity)]
    ingredients = recipes[:, :-1]
    # Without the entity once: one that is needed twice is its own partner.
    is_partner = np.ones(ingredients.shape, dtype=bool)
    is_partner[np.arange(len(recipes)), (ingredients == entity).argmax(axis=1)] = False
    partners = ingredients[is_partner]
    made_of = graph.sets[graph.recipes_of(entity), :-1]
    return (
        _most_used(graph, partners),
        _most_used(graph, recipes[:, -1]),
        _most_used(graph, made_of),
    )


def _most_used(graph: RecipeGraph, ids: Ids) -> Ids:
    distinct = np.unique(ids)
    # The padding of small recipes is no entity.
    distinct = distinct[distinct < graph.num_entities]
    order = np.argsort(-graph.use_counts[distinct], kind="stable")
    return distinct[order]


def _guest(graph: RecipeGraph, spot_of: Mapping[int, Spot], entity: int) -> Spot:
    """Return a dot near the middle of an entity's placed neighbours, or of the map."""
    partners = np.concatenate(_partners(graph, entity))
    near = []
    for partner in np.unique(partners).tolist():
        if partner in spot_of:
            spot = spot_of[partner]
            near.append((spot.x, spot.y))
    if not near:
        near = [(WIDTH // 2, HEIGHT // 2)]
    middle = np.mean(near, axis=0)
    # Offset by the golden angle (2.4 radians), so that guests with equal partners do not overlap:
    # its multiples are spread evenly around a circle, however many there are.
    angle = 2.4 * entity
    aside: NDArray[np.float64] = 40 * np.array([np.cos(angle), np.sin(angle)])
    place = (middle + aside).clip(0, [WIDTH, HEIGHT])
    x, y = place.round().astype(int).tolist()
    return Spot(
        entity=graph.entities[entity],
        x=x,
        y=y,
        uses=int(graph.use_counts[entity]),
        group=-1,
        layer=int(layers_of(graph)[entity]),
    )


def _view(explored: Explored, state: MapState) -> MapView:
    graph = explored.opened.graph
    # The layout takes seconds, the links of an entity hardly any time.
    whole_map = explored.once("map", lambda: map_of(graph))
    return view_map(graph, whole_map, state.entity)


def _draw(view: MapView, state: MapState, address: Addresses) -> Mapping[str, Any]:
    has_groups = state.colour == "group"
    roles = _roles(view.chosen)
    labels = _named(view.spots, roles)
    dots = []
    for number, spot in enumerate(view.spots):
        if has_groups:
            colour = charts.colour_of(spot.group)
        else:
            colour = _shade_of(spot, view.layers)
        size = 1 + sum(spot.uses >= threshold for threshold in SIZES)
        style = f"{colour} r{size}{roles.get(number, '')}"
        if number not in labels:
            style += " far"
        # A static site has entity pages, but no map for each entity.
        href = address(PAGE, MapState(entity=spot.entity, colour=state.colour))
        if not href:
            href = address(entity.PAGE, entity.EntityState(entity=spot.entity))
        dots.append((spot, href, style))
    links = {"combines": view.combines, "components": view.components}
    return {
        "box": (-SIDE, -EDGE, WIDTH + SIDE + RIGHT, HEIGHT + 2 * EDGE),
        "dots": dots,
        "links": {kind: _others(pairs, len(dots)) for kind, pairs in links.items()},
        "shortened": lambda label: shortened(label, LONGEST),
        "legend": _groups(view) if has_groups else _layers(view),
    }


def _roles(chosen: Links | None) -> dict[int, str]:
    """Return the CSS classes of the chosen entity's dot and of its partners' dots, by number."""
    if chosen is None:
        return {}
    near = (*chosen.combines.placed, *chosen.makes.placed, *chosen.made_of.placed)
    # The entity last: one that combines with itself is chosen, not near.
    return {**dict.fromkeys(near, " near"), chosen.entity: " chosen"}


def _named(spots: Sequence[Spot], roles: Mapping[int, str]) -> set[int]:
    """Return the numbers of the dots with a label; other labels appear when zooming in."""
    room = Labels(LINE)
    # A chosen entity and its partners are named first, then those with the most uses (the sort is
    # stable).
    order = sorted(range(len(spots)), key=lambda number: number not in roles)
    return {number for number in order if room.take(*_place_of_label(spots[number]))}


def _place_of_label(spot: Spot) -> tuple[float, float, int]:
    """Return left and right end and line of a dot with its label, in map units."""
    # The dot begins 8 units to the left of its place, the label 14 to the right, as in map.js.
    width = LETTER * min(len(spot.entity), LONGEST)
    return spot.x - 8, spot.x + 14 + width, spot.y


def _others(pairs: Sequence[tuple[int, int]], size: int) -> list[list[int]]:
    """Return the second dots of all pairs by the first dot: shorter in the page than pairs."""
    neighbours: list[list[int]] = [[] for _ in range(size)]
    for first_spot, second_spot in pairs:
        neighbours[first_spot].append(second_spot)
    return neighbours


def _groups(view: MapView) -> list[tuple[str, str, int]]:
    """Return class, names and size of each group with a colour, and of all others together."""
    shown = [
        (charts.colour_of(number), ", ".join(group.names), group.size)
        for number, group in enumerate(view.groups)
    ]
    legend = shown[: charts.COLOURS]
    num_rest = sum(size for _, _, size in shown[charts.COLOURS :])
    if num_rest:
        legend.append(("series-other", "other groups", num_rest))
    return legend


def _layers(view: MapView) -> list[tuple[str, str, int]]:
    """Return class, meaning and number of entities of each layer colour, by ascending layer."""
    layers_by_shade: dict[str, list[int]] = {}
    for spot in view.spots:
        layers_by_shade.setdefault(_shade_of(spot, view.layers), []).append(spot.layer)
    legend = []
    # A shade covers neighbouring layers, so any member tells its place among the shades.
    for shade, members in sorted(layers_by_shade.items(), key=lambda entry: entry[1][0]):
        name = _name_of_layers(min(members), max(members))
        legend.append((shade, name, len(members)))
    return legend


def _name_of_layers(low: int, high: int) -> str:
    if low < high:
        return f"layers {low} to {high}"
    if low < 0:
        return "cannot be made"
    return "base" if low == 0 else f"layer {low}"


def _shade_of(spot: Spot, layers: int) -> str:
    if spot.layer < 0:
        return "series-other"
    if spot.layer == 0:
        return "shade-0"
    # Layers 1 to ``layers`` in equal steps over the shades from 1.
    return f"shade-{1 + (spot.layer - 1) * SHADES // layers}"


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
