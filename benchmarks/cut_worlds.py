"""Worlds: small books cut out of a book, which share as little as the book allows.

    python benchmarks/cut_worlds.py everyday 8 graphs/world-8
    wordcraft-kg discover graphs/world-8 --book little-alchemy-2 --attempts 150 --runs 10

Writes world 8 of ``everyday`` as a graph folder, which every command takes.

A single book measures luck: one entity may be needed for most others, and a player either learns
it or not. Many worlds of one book have many such entities; ``discovery_worlds.py`` plays those that
share few recipes.
"""

import argparse
import sys
from collections.abc import Iterable, Set
from dataclasses import replace
from hashlib import sha256
from itertools import combinations
from pathlib import Path

import numpy as np

from wordcraft_kg.base.errors import ConfigError, WordCraftKGError
from wordcraft_kg.base.settings import whole
from wordcraft_kg.graphs.arrays import Ids
from wordcraft_kg.graphs.graph_folder import default_split, write_graph_folder
from wordcraft_kg.graphs.library import open_book
from wordcraft_kg.graphs.planner import layers
from wordcraft_kg.graphs.recipe_graph import Entity, RecipeGraph
from wordcraft_kg.graphs.recipes import RecipeBook

SIZES = (60, 100)
"""Fewest and most entities of a world.

Of 300 worlds with 60 to 100 entities of ``everyday``, 11 share at most :data:`MOST_SHARED`; of
those with 100 to 150 entities 6, and worlds with 200 to 700 entities share .69 on average.
"""
BASES = (4, 6)
"""Fewest and most base entities: Infinite Craft has 4, ``everyday`` 5."""
MOST_SHARED = 0.2
"""Largest share of recipes that two separate worlds have in common, of the smaller world."""
CANDIDATES = 300
"""Worlds that are cut before the separate ones are chosen."""

_DRAWS = 20  # of a base; about one in twenty of `everyday` makes too little
_EXCHANGES = 150  # of base entities: more leave fewer of the book's base, which all worlds share


def cut_world(book: RecipeBook, seed: int, *, sizes: tuple[int, int] = SIZES) -> RecipeBook:
    """Cut a world out of a book: all its recipes among some entities, all reachable from a base.

    Base entities of the book are exchanged for entities drawn by their number of uses, where enough
    can be made from these, and the entities of the first rounds stay. The number of entities is
    drawn between ``sizes``. A world depends on the book's recipes and base and the seed alone.

    Args:
        book: the book.
        seed: random seed, 0 or more.
        sizes: fewest and most entities.

    Raises:
        ConfigError: for a seed or size out of range, or if fewer than ``sizes[0]`` entities of the
            book can be made.
    """
    whole("seed", seed, 0)
    fewest, most = sizes
    whole("sizes", fewest, BASES[1] + 1, most)
    graph = RecipeGraph.from_book(book)
    rng = np.random.default_rng([seed, 0])
    size = int(rng.integers(fewest, most + 1))
    for _ in range(_DRAWS):
        base = _drawn_base(graph, rng, size)
        if _num_reachable(graph, base) >= fewest:
            break
    else:
        # The book's own base makes the most.
        base = graph.base_ids.tolist()[: BASES[1]]
    layer = layers(graph, base)
    reachable = int((layer >= 0).sum())
    if reachable < fewest:
        raise ConfigError(
            f"`sizes` {sizes}: {reachable:,} of the {graph.num_entities:,} entities of {book.name} "
            f"can be made from {len(base)} base entities; expected at least {fewest}. Take smaller "
            "sizes."
        )
    return _part_of(book, graph, _first_made(layer, rng, size), base, f"world-{seed}")


def shared_part(left: Set[object], right: Set[object]) -> float:
    """Return how many members two sets share, as a share of the smaller one."""
    return len(left & right) / min(len(left), len(right))


def separate_worlds(
    book: RecipeBook,
    *,
    candidates: int = CANDIDATES,
    most: int | None = None,
    sizes: tuple[int, int] = SIZES,
) -> list[RecipeBook]:
    """Return worlds of a book of which no two share more than :data:`MOST_SHARED` of the recipes.

    Of the two worlds that share most, the one that shares more with all others is left out, until
    the rest is separate; so few worlds are left of a small book.

    Args:
        book: the book.
        candidates: number of worlds to choose from, with the seeds from 0.
        most: largest number of worlds; None for all that are separate.
        sizes: fewest and most entities.
    """
    worlds = [cut_world(book, seed, sizes=sizes) for seed in range(candidates)]
    recipes = [set(world.recipes) for world in worlds]
    shared = np.zeros((candidates, candidates))
    for i, j in combinations(range(candidates), 2):
        shared[i, j] = shared_part(recipes[i], recipes[j])
        shared[j, i] = shared[i, j]
    left = np.arange(candidates)
    while len(left) > 1:
        part = shared[np.ix_(left, left)]
        is_separate = part.max() <= MOST_SHARED
        if is_separate and (most is None or len(left) <= most):
            break
        first, second = np.unravel_index(part.argmax(), part.shape)
        place = max(first, second, key=lambda index: part[index].sum())
        left = np.delete(left, place)
    return [worlds[place] for place in left.tolist()]


def _part_of(
    book: RecipeBook, graph: RecipeGraph, chosen: Ids, base: list[Entity], named: str
) -> RecipeBook:
    """Return a book of the recipes among ``chosen`` entities, and the base, both given by ids."""
    is_inside = np.zeros(graph.num_entities, dtype=bool)
    is_inside[chosen] = True
    is_whole = is_inside[graph.recipes].all(axis=1)
    world = RecipeBook.of(
        f"{named}-{book.name}",
        graph.recipe_labels(graph.recipes[is_whole]),
        base=graph.labels(base),
        keep_self_results=True,
        sha256=_hash_of(book, named),
    )
    kinds = {recipe: book.kinds[recipe] for recipe in world.recipes if recipe in book.kinds}
    return replace(world, kinds=kinds)


def _drawn_base(graph: RecipeGraph, rng: np.random.Generator, size: int) -> list[Entity]:
    """Return 4 to 6 ids from which ``size`` entities can be made, or else as many as possible.

    Random bases make next to nothing in most books. So entities of the book's base are exchanged
    for drawn ones, one at a time, as long as enough can be made.
    """
    uses = graph.use_counts
    users = int((uses > 0).sum())
    if users == 0:  # a book without recipes
        return graph.base_ids[: BASES[1]].tolist()
    chances = uses / uses.sum()
    # Not more than entities with a chance: the loop below would draw for ever.
    number = min(int(rng.integers(BASES[0], BASES[1] + 1)), users)
    base = rng.permutation(graph.base_ids)[:number].tolist()
    while len(base) < number:
        drawn = int(rng.choice(len(uses), p=chances))
        if drawn not in base:
            base.append(drawn)
    reached = _num_reachable(graph, base)
    for _ in range(_EXCHANGES):
        exchanged = list(base)
        exchanged[int(rng.integers(number))] = int(rng.choice(len(uses), p=chances))
        if len(set(exchanged)) < number:
            continue
        reached_now = _num_reachable(graph, exchanged)
        # Beyond `size` a base need not grow, so that bases differ from seed to seed.
        if reached_now >= min(size, reached):
            base = exchanged
            reached = reached_now
    return sorted(base)


def _num_reachable(graph: RecipeGraph, base: Iterable[Entity]) -> int:
    """Return how many entities can be made from a base, the base included."""
    return int((layers(graph, base) >= 0).sum())


def _first_made(layer: Ids, rng: np.random.Generator, size: int) -> Ids:
    """Return the ids of the ``size`` entities with the fewest rounds, of the last round some."""
    # An entity needs entities of earlier rounds only, so any part of the last round will do.
    chance = rng.random(len(layer))
    # The last key sorts first: by round, then at random.
    order = np.lexsort((chance, layer))
    made = order[layer[order] >= 0]
    return made[:size]


def _hash_of(book: RecipeBook, named: str) -> str | None:
    """Return the hash of a world: the same for the same book and name; None without a file."""
    if book.sha256 is None:
        return None
    return sha256(f"{named} {book.sha256}".encode()).hexdigest()


def main() -> None:
    """Cut a world and write its graph folder."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("book", help="the book to cut a world out of")
    parser.add_argument("seed", type=int, help="number of the world")
    parser.add_argument("folder", type=Path, help="graph folder to write")
    options = parser.parse_args()
    try:
        world = cut_world(open_book(options.book), options.seed)
        write_graph_folder(options.folder, world, default_split(RecipeGraph.from_book(world)))
    except WordCraftKGError as error:
        sys.exit(f"{error.kind}: {error}")
    print(f"wrote {options.folder}/: {len(world.entities)} entities, {len(world.recipes)} recipes")


if __name__ == "__main__":
    main()
