"""Bottlenecks: entities without which a player cannot go on, and the size of what can be made."""

from collections.abc import Iterable, Sequence
from operator import attrgetter

import numpy as np
from msgspec.structs import replace

from wordcraft_kg.base.records import Count, Record, Share
from wordcraft_kg.graphs.planner import layers, rounds
from wordcraft_kg.graphs.recipe_graph import Entity, RecipeGraph

MOST_ANALYSED = 5_000
"""Most entities of a graph with bottlenecks: each entity costs a walk through all recipes."""


class Bottleneck(Record):
    """An entity without which others cannot be made.

    Attributes:
        entity: label.
        needed_by: number of other entities that become unreachable without it.
        round: crafting round from which on it can be made.
    """

    entity: str
    needed_by: Count
    round: Count


class WorldStatistics(Record):
    """Sizes and bottlenecks of the part of a graph that can be made.

    Attributes:
        reachable: number of entities that can be made from the base, including the base.
        width: entities that become known in each round, in which all known pairs are combined;
            the first number is the base.
        success_rate: share of the unordered pairs of reachable entities, a + a among them, with a
            recipe.
        pairs: number of these pairs.
        bottlenecks: made entities that others need, those needed by most first.
        main: the main bottleneck: of the entities that half of the world needs, the one of the
            latest round; without any, the one needed by most. Earlier ones are on the way to it,
            and every player passes them. None without bottlenecks.
    """

    reachable: Count
    width: tuple[Count, ...]
    success_rate: Share
    pairs: Count
    bottlenecks: tuple[Bottleneck, ...]
    main: Bottleneck | None


def bottlenecks(graph: RecipeGraph, base: Iterable[Entity] | None = None) -> list[tuple[int, int]]:
    """Count the entities that need each made entity.

    Args:
        graph: the recipe graph; the time grows with its entities times its recipes.
        base: entities known at the start; None for the graph's base.

    Returns:
        Pairs (entity id, number of other entities that cannot be made without it), the largest
        number first, then by id; without entities that none needs.

    Raises:
        UnknownEntityError: if an entity in ``base`` is not in the graph.
    """
    layer = layers(graph, base)
    is_used = graph.use_counts > 0
    *ingredients, result = graph.sets.T
    reachable = layer >= 0
    number = int(reachable.sum())
    losses = []
    for entity in np.flatnonzero((layer > 0) & is_used).tolist():
        # Entities of the same round and of earlier ones are made without it.
        is_known = np.append(reachable & (layer <= layer[entity]), True)  # and the padding
        is_known[entity] = False
        # Round by round, all that can be made without it.
        while True:
            results = result[np.all([is_known[column] for column in ingredients], axis=0)]
            is_new = ~is_known[results] & (results != entity)
            if not is_new.any():
                break
            is_known[results[is_new]] = True
        # Without the entity itself, which is not known either.
        lost = number - int(is_known[:-1].sum()) - 1
        if lost:
            losses.append((entity, lost))
    return sorted(losses, key=lambda pair: (-pair[1], pair[0]))


def world_statistics(graph: RecipeGraph, base: Iterable[Entity] | None = None) -> WorldStatistics:
    """Describe the part of a graph that can be made.

    Args:
        graph: the recipe graph. One of more than :data:`MOST_ANALYSED` entities gets no
            bottlenecks, whose cost grows with entities times recipes.
        base: entities known at the start; None for the graph's base.

    Raises:
        UnknownEntityError: if an entity in ``base`` is not in the graph.
    """
    # Read twice below, and an iterator can be read once.
    start = None if base is None else list(base)
    layer = layers(graph, start)
    reachable = int((layer >= 0).sum())
    known_by_round = rounds(layer)
    width = np.diff([0, *known_by_round]).tolist()
    # Unordered pairs, an entity with itself included.
    pairs = reachable * (reachable + 1) // 2
    # The first recipe of each pair: a pair with several results counts once.
    firsts = graph.recipes[graph.pair_starts[:-1], :2]
    combining = int((layer[firsts] >= 0).all(axis=1).sum())
    is_small = graph.num_entities <= MOST_ANALYSED
    losses = bottlenecks(graph, start) if is_small else []
    records = []
    for entity, lost in losses:
        records.append(Bottleneck(graph.entities[entity], lost, int(layer[entity])))
    half = [bottleneck for bottleneck in records if 2 * bottleneck.needed_by >= reachable]
    # Sorted by need before, so that of the last round the one needed by most counts.
    main = max(half or records[:1], key=attrgetter("round"), default=None)
    return WorldStatistics(
        reachable=reachable,
        width=tuple(width),
        success_rate=combining / pairs if pairs else 0.0,
        pairs=pairs,
        bottlenecks=tuple(records),
        main=main,
    )


SHOWN_BOTTLENECKS = 5
"""Most bottlenecks of a world in results."""


def main_statistics(graph: RecipeGraph, base: Sequence[int]) -> WorldStatistics:
    """Return a world's statistics with its main bottleneck first, and a few further ones."""
    statistics = world_statistics(graph, base)
    main = statistics.main
    if main is None:
        return statistics
    further_bottlenecks = [
        bottleneck for bottleneck in statistics.bottlenecks if bottleneck != main
    ]
    return replace(statistics, bottlenecks=(main, *further_bottlenecks[: SHOWN_BOTTLENECKS - 1]))
