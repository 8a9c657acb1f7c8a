"""Fit recipe scorers by neighbour lists, for all recipes and without each fold, with shared work.

As in :mod:`~wordcraft_kg.models.recipes.fitting`, a ranker learns from recipes of held-out folds,
whose features come from the remaining folds. The ranker without fold i learns from fold j by lists
without folds i and j; so does the ranker without fold j from fold i. These lists are made once, and
1 + K + K (K - 1) / 2 sets of lists serve K + 1 rankers.
"""

import math
from collections.abc import Callable, Collection, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from wordcraft_kg.graphs.arrays import Ids
from wordcraft_kg.graphs.folds import Folds
from wordcraft_kg.models.recipes.committee import Examples, fit_committee
from wordcraft_kg.models.recipes.fitting import TABLES, with_known
from wordcraft_kg.models.scorers.neighbours.knowledge import FEATURES, NeighbourKnowledge
from wordcraft_kg.models.scorers.neighbours.lists import Lists, Numbers, make_lists, nearest_words
from wordcraft_kg.models.scorers.pair_knowledge import pairs_of

EXAMPLES = 6_000
"""Most held-out recipes from which a ranker learns, over all folds."""
DRAWS = 2
"""Tables of each size for a held-out recipe, with different distractors."""
KNOWN = 10_000
"""Most known recipes whose scores are lifted if held-out goals have none."""
LeftOut = tuple[int, ...]
"""Folds that a scorer has not seen: none, or one."""


@dataclass(frozen=True, eq=False)
class Words:
    """What all fits share: word vectors and the nearest words.

    Attributes:
        vectors: shape (E, D), half: unit vectors as stored in a model; D is 0 without words.
        near: shape (E, K_w), from
            :func:`~wordcraft_kg.models.scorers.neighbours.lists.nearest_words`.
    """

    vectors: NDArray[np.float16]
    near: Numbers

    @classmethod
    def of(cls, vectors: NDArray[np.floating]) -> "Words":
        """Round unit vectors as a model stores them, and find the nearest words."""
        rounded = vectors.astype(np.float16)
        return cls(rounded, nearest_words(rounded.astype(np.float32)))

    def lists(self, recipes: Ids) -> Lists:
        """Return the lists of recipes, ids (n, 3)."""
        return make_lists(recipes, self.vectors.astype(np.float32), self.near)


def fit_by_neighbours(
    folds: Folds,
    words: Words,
    wanted: Sequence[LeftOut],
    *,
    seed: int = 0,
    workers: int = 1,
    after: Callable[[], None] = lambda: None,
) -> Iterator[tuple[LeftOut, NeighbourKnowledge]]:
    """Fit a scorer for each entry of ``wanted``, in this order.

    The result does not depend on the other entries, nor on ``workers``: each set of examples has
    its own seed.

    Args:
        folds: folds of the train recipes.
        words: word vectors.
        wanted: the folds to leave out, () for none.
        seed: seed of tables and initial weights.
        workers: threads; the compiled loops run beside each other.
        after: called after each set of lists, in the caller's thread; may raise to end the fits.

    Yields:
        an entry of ``wanted``, and the knowledge fitted without these folds.
    """
    # By the folds left out and the fold held out.
    examples: dict[tuple[LeftOut, int], Examples] = {}
    missing = set(wanted)
    for left_out in wanted:
        turns = [fold for fold in range(folds.count) if fold not in left_out]
        new = [turn for turn in turns if (left_out, turn) not in examples]

        # The default keeps this turn of the loop's value for the threads.
        def made(
            turn: int,
            left_out: LeftOut = left_out,
        ) -> list[tuple[tuple[LeftOut, int], Examples]]:
            without = {*left_out, turn}
            lists = words.lists(folds.recipes(without))
            of_lists = []
            # Each fold left out is held out for the ranker that leaves out the others.
            for held_out in without:
                other = tuple(sorted(without - {held_out}))
                if other in missing:
                    new_examples = _examples(folds, lists, other, held_out, seed)
                    of_lists.append(((other, held_out), new_examples))
            return of_lists

        pool = ThreadPoolExecutor(workers)
        try:
            for found in pool.map(made, new):
                examples.update(found)
                after()
        finally:
            # After Ctrl-C, sets that are not begun are never made.
            pool.shutdown(cancel_futures=True)
        parts = [examples.pop((left_out, turn)) for turn in turns]
        missing.remove(left_out)
        yield left_out, _fitted(folds, words, left_out, parts, seed)


def _fitted(
    folds: Folds,
    words: Words,
    left_out: LeftOut,
    parts: Sequence[Examples],
    seed: int,
) -> NeighbourKnowledge:
    """Fit the ranker of a scorer to its examples.

    Args:
        folds: folds of the train recipes.
        words: word vectors.
        left_out: folds that the scorer has not seen.
        parts: the examples of each held-out fold.
        seed: seed of the initial weights and the order of tables.
    """
    examples = Examples(*(torch.cat(part) for part in zip(*parts, strict=True)))
    generator = torch.Generator().manual_seed(_seed_of(seed, left_out))
    ranker = fit_committee(examples, generator)
    recipes = folds.recipes(left_out)
    knowledge = NeighbourKnowledge.of_recipes(recipes, words.vectors, words.near)
    makes = FEATURES.index("makes")
    # By-goal folds: no held-out goal has a known recipe.
    # A feature that is the same in all examples has weight 0.
    if not ranker.first[makes].any():
        chosen = recipes[:: max(1, len(recipes) // KNOWN)]
        a, b, goal = torch.from_numpy(chosen.copy()).T
        table = torch.stack([a, b], dim=1)
        # The recipe's two slots, not the pairs of a slot with itself.
        pair = (torch.tensor([0]), torch.tensor([1]))
        of_known = knowledge.features(goal, table, torch.zeros_like(goal), pair)
        highest = ranker(examples.features[examples.competes]).amax()
        ranker = with_known(ranker, of_known[:, :, 0].T, makes, highest)
    return knowledge.with_ranker(ranker)


def _examples(
    folds: Folds,
    lists: Lists,
    left_out: LeftOut,
    held_out: int,
    seed: int,
) -> Examples:
    """Make queries from a fold's recipes on tables with distractors.

    Args:
        folds: folds of the train recipes.
        lists: made without ``left_out`` and without ``held_out``.
        left_out: folds that the scorer has not seen; every pair in a recipe of the others is right.
        held_out: the fold whose recipes are asked for.
        seed: seed of the tables.
    """
    # Numba is imported for a fit alone: it takes a second.
    from wordcraft_kg.models.scorers.neighbours.feature_loops import table_features

    rng = np.random.default_rng([_seed_of(seed, left_out), held_out])
    known = folds.recipes(left_out)
    recipes = folds.recipes_of(held_out)
    # An equal share of the examples for each fold, rounded up.
    most = math.ceil(EXAMPLES / (folds.count - len(left_out)))
    rows = np.sort(rng.permutation(len(recipes))[:most])
    recipes = recipes[rows]
    goals = np.tile(recipes[:, 2], DRAWS * len(TABLES))
    size = folds.split.graph.num_entities
    drawn = [_tables(recipes, known, size, number, rng) for number in TABLES * DRAWS]
    tables = np.concatenate(drawn)
    first_slots, second_slots = pairs_of(tables.shape[1], torch.device("cpu"))
    one = first_slots.numpy()
    other = second_slots.numpy()
    # The compiled loops write into an array: (tables, pairs, features).
    shape = (len(goals), len(one), len(FEATURES))
    features = np.zeros(shape, dtype=np.float32)
    table_features(lists, goals, tables, one, other, features)
    a = tables[:, one]
    b = tables[:, other]
    competes = (a >= 0) & (b >= 0)
    first, second, results = known.T
    of_known = _codes(first, second, results, size)
    of_pairs = _codes(a, b, goals[:, None], size)
    # The code of a pair with an empty slot may be that of another recipe.
    is_right = np.isin(of_pairs, of_known) & competes
    return Examples(_tensor(features), _tensor(competes), _tensor(is_right))


def _tables(
    recipes: Ids,
    known: Ids,
    size: int,
    distractors: int,
    rng: np.random.Generator,
) -> Ids:
    """Return tables with a recipe's ingredients and drawn entities.

    Distractors are drawn by 1 + their number of recipes, as environments draw them, without the
    recipe's entities.

    Args:
        recipes: ids, shape (n, 3).
        known: recipes that are counted, ids (m, 3).
        size: E.
        distractors: number of drawn entities, fewer in a small graph.
        rng: draws the entities.

    Returns:
        ids, shape (n, 2 + most distractors); -1 is an empty slot.
    """
    # In a recipe a + a, the entity counts once.
    self_pairs = known[:, 0] == known[:, 1]
    second = known[~self_pairs, 1]
    users = np.concatenate([known[:, 0], second])
    weights = 1.0 + np.bincount(users, minlength=size)
    ends = np.cumsum(weights)
    slots = 2 + max(TABLES)
    tables = np.full((len(recipes), slots), -1, dtype=np.int64)
    tables[:, :2] = recipes[:, :2]
    # An entity is on a table once, also if the recipe combines it with itself.
    is_twice = recipes[:, 0] == recipes[:, 1]
    tables[is_twice, 1] = -1
    amount = max(min(distractors, size - 3), 0)
    # Some are drawn twice; the first draws of different entities count.
    draws = 4 * amount + 16
    shares = rng.random((len(recipes), draws)) * ends[-1]
    drawn = np.searchsorted(ends, shares, "right")
    by_recipe = zip(recipes.tolist(), drawn.tolist(), strict=True)
    for row, (recipe, entities) in enumerate(by_recipe):
        others = [entity for entity in dict.fromkeys(entities) if entity not in recipe]
        if len(others) < amount:
            # In a small book, nearly all draws may repeat a few entities.
            rest = [each for each in rng.permutation(size).tolist() if each not in recipe]
            others = list(dict.fromkeys([*others, *rest]))
        chosen = others[:amount]
        tables[row, 2 : 2 + len(chosen)] = chosen
    return tables


def _codes(a: Ids, b: Ids, result: Ids, size: int) -> Ids:
    """Return a number for each recipe, whatever the order of its ingredients."""
    smaller = np.minimum(a, b)
    larger = np.maximum(a, b)
    return (smaller * size + larger) * size + result


def _seed_of(seed: int, left_out: Collection[int]) -> int:
    """Return a seed for the scorer without these folds."""
    rng = np.random.default_rng([seed, *sorted(left_out)])
    return int(rng.integers(2**31))


def _tensor(array: NDArray[np.generic]) -> Tensor:
    return torch.from_numpy(array)
