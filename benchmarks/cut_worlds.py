"""Worlds: small books cut out of a book, and books whose recipes contradict it.

    python benchmarks/cut_worlds.py everyday 8 graphs/world-8
    wordcraft-kg discover graphs/world-8 --book little-alchemy-2 --attempts 500 --runs 10

Writes world 8 of ``everyday`` as a graph folder, which every command takes. ``--way topic`` chooses
the way to cut, and ``--wrong 30`` first exchanges the results of 30 % of the book's recipes.

A single book measures luck: one entity may be needed for most others, and a player either learns
it or not. Many worlds of one book have many such entities; ``discovery_worlds.py`` plays them.
"""

import argparse
import math
import sys
from collections.abc import Iterable
from dataclasses import replace
from hashlib import sha256
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from wordcraft_kg.base.errors import ConfigError, RecipeFileError, WordCraftKGError
from wordcraft_kg.base.settings import one_of, whole
from wordcraft_kg.graphs.arrays import Ids
from wordcraft_kg.graphs.folder import default_split, write_graph_folder
from wordcraft_kg.graphs.library import open_book
from wordcraft_kg.graphs.planner import Planner, layers
from wordcraft_kg.graphs.recipe_graph import Entity, RecipeGraph
from wordcraft_kg.graphs.recipes import Recipe, RecipeBook

PREFIX = "world"
"""Begin of a world's name, as in ``world-7-everyday``."""
WRONG = "wrong"
"""Begin of the name of a book with wrong recipes, as in ``wrong-30-everyday``."""
WAYS = ("base", "topic", "closure")
"""Ways to cut a world, which take turns with the seed; see :func:`cut_world`."""
SIZES = (200, 700)
"""Fewest and most entities of a world: as many as Little Alchemy 2 has, or fewer."""
BASES = (4, 6)
"""Fewest and most base entities: Infinite Craft has 4, ``everyday`` 5."""

_DRAWS = 20  # of a base; about one in twenty of ``everyday`` makes too little
_EXCHANGES = 60  # of base entities: ten for each, of which about two in ``everyday`` are possible
_RESTART = 0.3  # probability of a random walk to go back to the topic; it then takes 3 steps
_STEPS = 20  # of the walk: all but 0.7^20 = 0.1 % of its probability has gone back by then
_TRIED = 5  # candidates for a topic's world, in sizes of the world: most add a long derivation
_REPAIRS = 100  # rounds of exchanges for wrong results that fit no pair


def cut_world(
    book: RecipeBook,
    seed: int,
    way: str | None = None,
    *,
    sizes: tuple[int, int] = SIZES,
) -> RecipeBook:
    """Cut a world out of a book: all its recipes among some entities, all reachable from a base.

    The number of entities is drawn between ``sizes``. The ways:

    - ``base``: exchange the book's base entities for entities drawn by their number of uses, where
      enough can be made from these, and keep the entities of the first rounds;
    - ``topic``: draw an entity, and keep its neighbours in the graph with the cheapest derivations
      from the book's base. Closeness is the probability of a random walk with restart, divided by
      the square root of an entity's number of neighbours, so that hubs are not close to all;
    - ``closure``: from the book's base, add a random entity that can be made, again and again.

    A book with fewer than 4 or more than 6 base entities gets a drawn base in all ways. A world
    depends on the book's recipes and base, the seed and the way alone.

    Args:
        book: the book.
        seed: random seed, 0 or more.
        way: one of :data:`WAYS`; None takes turns with the seed.
        sizes: fewest and most entities.

    Raises:
        ConfigError: for an unknown way, or a seed or size out of range.
        RecipeFileError: if no base reaches ``sizes[0]`` entities of the book.

    Source: the random walk is the personalised PageRank of Page et al. 1999, "The PageRank citation
    ranking: bringing order to the web".
    """
    whole("seed", seed, 0)
    fewest, most = sizes
    whole("sizes", fewest, BASES[1] + 1, most)
    if way is None:
        named = f"{PREFIX}-{seed}"
        way = WAYS[seed % len(WAYS)]
    else:
        named = f"{PREFIX}-{way}-{seed}"
        one_of("way", way, WAYS)
    graph = RecipeGraph.from_book(book)
    rng = np.random.default_rng([seed, WAYS.index(way)])
    size = int(rng.integers(fewest, most + 1))
    has_base = BASES[0] <= len(graph.base_ids) <= BASES[1]
    base = graph.base_ids
    if way == "base" or not has_base:
        for _ in range(_DRAWS):
            base = _drawn_base(graph, rng, size)
            if _num_reachable(graph, base.tolist()) >= fewest:
                break
    layer = layers(graph, base.tolist())
    reachable = int((layer >= 0).sum())
    if reachable < fewest:
        raise RecipeFileError(
            f"no world of at least {fewest} entities in {book.name}: {reachable:,} of its "
            f"{graph.num_entities:,} entities can be made from {len(base)} base entities. Take a "
            "book in which more can be made, or smaller `sizes`."
        )
    if way == "base":
        kept = _first_made(layer, rng, size)
    elif way == "topic":
        kept = _around_topic(graph, base, rng, size)
        if len(kept) < fewest:  # the topic lies in a corner of the book
            kept = _grown(graph, kept, rng, fewest)
    else:
        kept = _grown(graph, base, rng, size)
    return _part_of(book, graph, kept, base, named)


def _part_of(book: RecipeBook, graph: RecipeGraph, kept: Ids, base: Ids, named: str) -> RecipeBook:
    """Return a book of the recipes among ``kept`` entities, and the base, both given by ids."""
    is_kept = np.zeros(graph.num_entities, dtype=bool)
    is_kept[kept] = True
    is_whole = is_kept[graph.recipes].all(axis=1)
    recipes = graph.recipe_labels(graph.recipes[is_whole])
    world = RecipeBook.of(
        f"{named}-{book.name}",
        recipes,
        base=graph.labels(base.tolist()),
        keep_self_results=True,
        sha256=_hash_of(book, named),
    )
    kinds = {recipe: book.kinds[recipe] for recipe in world.recipes if recipe in book.kinds}
    return replace(world, kinds=kinds)


def _drawn_base(graph: RecipeGraph, rng: np.random.Generator, size: int) -> Ids:
    """Return 4 to 6 ids from which ``size`` entities can be made, or else as many as possible.

    Random bases make next to nothing in most books. So entities of the book's base are exchanged
    for drawn ones, one at a time, as long as enough can be made.
    """
    uses = graph.use_counts
    users = int((uses > 0).sum())
    if users == 0:  # a book without recipes
        return graph.base_ids[: BASES[1]]
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
        # In this order: worlds of a seed must stay what they are.
        drawn = int(rng.choice(len(uses), p=chances))
        place = int(rng.integers(number))
        other = list(base)
        other[place] = drawn
        if len(set(other)) < number:
            continue
        now = _num_reachable(graph, other)
        # Beyond `size` a base need not grow, so that bases differ from seed to seed.
        if now >= min(size, reached):
            base = other
            reached = now
    return np.array(sorted(base), dtype=np.int64)


def _num_reachable(graph: RecipeGraph, base: Iterable[Entity]) -> int:
    """Return how many entities can be made from a base, the base included."""
    is_reachable = layers(graph, base) >= 0
    return int(is_reachable.sum())


def _first_made(layer: Ids, rng: np.random.Generator, size: int) -> Ids:
    """Return the ids of the ``size`` entities with the fewest rounds, of the last round some."""
    # An entity needs entities of earlier rounds only, so any part of the last round will do.
    chance = rng.random(len(layer))
    # The last key sorts first: by round, then at random.
    order = np.lexsort((chance, layer))
    made = order[layer[order] >= 0]
    return made[:size]


def _grown(graph: RecipeGraph, start: Ids, rng: np.random.Generator, size: int) -> Ids:
    """Add random entities, each made of two that are there, until ``size`` are there."""
    known = dict.fromkeys(start.tolist())
    # Entities that can be made, as a list to draw from and a set to look up.
    open_list: list[int] = []
    seen = set(known)

    def extend(entity: int) -> None:
        for a, b, result in graph.recipes[graph.uses_of(entity)].tolist():
            if a in known and b in known and result not in seen:
                seen.add(result)
                open_list.append(result)

    for entity in list(known):
        extend(entity)
    while open_list and len(known) < size:
        place = int(rng.integers(len(open_list)))
        # The last one takes the drawn one's place: removal in the middle would move all others.
        open_list[place], open_list[-1] = open_list[-1], open_list[place]
        entity = open_list.pop()
        known[entity] = None
        extend(entity)
    return np.array(list(known), dtype=np.int64)


def _around_topic(graph: RecipeGraph, base: Ids, rng: np.random.Generator, size: int) -> Ids:
    """Return the entities closest to a drawn topic, with all that their derivations need."""
    planner = Planner(graph, base.tolist())
    # In Python: a cost is a whole number that may be larger than any float.
    can_be_made = np.array([cost < math.inf for cost in planner.costs])
    # A topic that no recipe uses has few neighbours.
    is_used = graph.use_counts > 0
    topics = np.flatnonzero(can_be_made & is_used)
    topic = int(topics[rng.integers(len(topics))])
    # The closest first, equal closeness by id; the last ones are those that nothing makes.
    distance = np.where(can_be_made, -_closeness(graph, topic), np.inf)
    order = np.argsort(distance, kind="stable")
    # A dict as an ordered set.
    kept = dict.fromkeys(base.tolist())
    # Derivations cost time, so distant entities are not tried in a large book.
    tried = min(_TRIED * size, int(can_be_made.sum()))
    for entity in order[:tried].tolist():
        if entity in kept:
            continue
        steps = planner.derivation(entity).steps
        needed = [graph.id_of(recipe.result) for recipe in steps]
        new = [each for each in needed if each not in kept]
        if len(kept) + len(new) <= size:
            kept |= dict.fromkeys(new)
        if len(kept) == size:
            break
    return np.array(list(kept), dtype=np.int64)


def _closeness(graph: RecipeGraph, topic: int) -> NDArray[np.floating]:
    """Return how close each entity is to a topic, shape (num_entities,)."""
    a, b, result = graph.recipes.T
    # Entities of a recipe are neighbours of each other, once for each recipe that they share.
    heads = np.concatenate([a, b, a, result, b, result])
    tails = np.concatenate([b, a, result, a, result, b])
    size = graph.num_entities
    # An entity in no recipe has no neighbours; 1 in place of 0 avoids a division by 0.
    degrees = np.maximum(np.bincount(heads, minlength=size), 1)
    walk: NDArray[np.floating] = np.zeros(size)
    walk[topic] = 1
    for _ in range(_STEPS):
        # A walker at an entity goes to each of its neighbours with the same probability.
        shares = walk / degrees
        flow = np.bincount(tails, weights=shares[heads], minlength=size)
        walk = (1 - _RESTART) * flow
        walk[topic] += _RESTART
    return walk / np.sqrt(degrees)


def with_wrong_recipes(book: RecipeBook, percent: int, seed: int = 0) -> RecipeBook:
    """Return a copy of a book in which some recipes make something else.

    The recipes are drawn at random, and exchange their results, so that each entity is made as
    often as before. No pair keeps a result of the original, and no result is an ingredient. A
    player who knows the original is wrong about this share; the rest is as before.

    Args:
        book: the book.
        percent: share of the recipes with another result, 1 to 100. A few fewer are changed where
            no result fits.
        seed: random seed, 0 or more.

    Raises:
        ConfigError: if a number is out of range, or the book has too few recipes for an exchange.
    """
    whole("percent", percent, 1, 100)
    whole("seed", seed, 0)
    rng = np.random.default_rng([seed, percent])
    number = round(len(book.recipes) * percent / 100)
    chosen = rng.choice(len(book.recipes), size=number, replace=False)
    rows = [book.recipes[place] for place in chosen.tolist()]
    results = [row.result for row in rows]
    # A permutation keeps how often each entity is made.
    rng.shuffle(results)

    def exchanged(place: int) -> Recipe:
        """Return a chosen recipe with the result that it has at the moment."""
        return Recipe(rows[place].ingredients, results[place])

    # What each pair makes: the original's results, and the wrong ones as they are accepted.
    originals = set(book.recipes)
    taken: set[Recipe] = set()
    open_rows = list(range(number))
    for _ in range(_REPAIRS):
        left = []
        for place in open_rows:
            wrong = exchanged(place)
            if wrong in originals or wrong in taken or wrong.is_self_result:
                left.append(place)
            else:
                taken.add(wrong)
        open_rows = left
        if not open_rows:
            break
        # Each of the rest exchanges its result with any other, which is checked again.
        for place in list(open_rows):
            other = int(rng.integers(number))
            # An accepted row gives up its result, and is tried again with the new one.
            if other not in open_rows:
                taken.discard(exchanged(other))
                open_rows.append(other)
            results[place], results[other] = results[other], results[place]
    # A result that fits nowhere stays where it was.
    kept = {rows[place] for place in open_rows}
    changed = [place for place in range(number) if rows[place] not in kept]
    if not changed:
        raise ConfigError(
            f"`percent` {percent} of the {len(book.recipes):,} recipes in {book.name} cannot be "
            "exchanged; expected at least two recipes with results that fit other pairs."
        )
    replaced = {rows[place] for place in changed}
    wrong_rows = [exchanged(place) for place in changed]
    right_rows = [recipe for recipe in book.recipes if recipe not in replaced]
    named = f"{WRONG}-{percent}-{seed}" if seed else f"{WRONG}-{percent}"
    wrong_book = RecipeBook.of(
        f"{named}-{book.name}",
        right_rows + wrong_rows,
        base=book.base,
        listed=book.entities,
        keep_self_results=True,
        sha256=_hash_of(book, named),
    )
    # The kind of reasoning behind a recipe says nothing of the result that it has now.
    return replace(wrong_book, kinds={})


def _hash_of(book: RecipeBook, named: str) -> str | None:
    """Return the hash of a book made of another one: the same for the same original and name.

    Args:
        book: the original; without a file it has no hash, and neither has the new book.
        named: how the new book was made, with the seed.
    """
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
    parser.add_argument("--way", choices=WAYS, help="by default, the ways take turns")
    parser.add_argument("--wrong", type=int, help="per cent of the recipes with another result")
    options = parser.parse_args()
    try:
        book = open_book(options.book)
        if options.wrong is not None:
            book = with_wrong_recipes(book, options.wrong)
        world = cut_world(book, options.seed, options.way)
        write_graph_folder(options.folder, world, default_split(RecipeGraph.from_book(world)))
    except WordCraftKGError as error:
        sys.exit(f"{error.kind}: {error}")
    print(f"wrote {options.folder}/: {len(world.entities)} entities, {len(world.recipes)} recipes")


if __name__ == "__main__":
    main()
