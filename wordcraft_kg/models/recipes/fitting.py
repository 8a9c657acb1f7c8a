"""Fit a recipe scorer by stacking: rankers (small networks) learn from features of held-out recipes.

Each fold's features come from the remaining folds, and a ranker learns feature weights. The final scorer applies the
ranker to features from all recipes (Wolpert 1992; van der Laan, Polley and Hubbard 2007). For cross-fitting, a scorer
without a fold is fitted in the same way on the remaining folds.
"""

import math
from collections.abc import Callable, Collection, Sequence
from dataclasses import replace
from itertools import chain

import numpy as np
import torch
from torch import Tensor

from wordcraft_kg.graphs.arrays import Ids
from wordcraft_kg.graphs.folds import Folds
from wordcraft_kg.graphs.triples import (
    COMBINES_WITH,
    COMPONENT_OF,
    RELATIONS,
    is_in,
    recipe_triples,
)
from wordcraft_kg.models.recipes.base import NOTHING, Base, LinkTables, link_features
from wordcraft_kg.models.scorers.pair_features import FEATURES, RecipeKnowledge, knowledge_of
from wordcraft_kg.models.scorers.pair_knowledge import pairs_of
from wordcraft_kg.models.scorers.ranker import Ranker

HIDDEN = 32
WEIGHT_DECAY = 1e-4


Batch = tuple[Tensor, Tensor, Tensor]
"""B queries with N candidates: features (B, N, F), and two masks for competing and right candidates (B, N)."""


def fit_ranker(
    batches: Sequence[Batch],
    mean: Tensor,
    scale: Tensor,
    *,
    epochs: int,
    learning_rate: float,
    generator: torch.Generator,
) -> Ranker:
    """Fit a ranker that scores right candidates above competing candidates.

    The loss per query is ``-log Σ_right softmax(scores)``, minimised with AdamW and one cycle of the learning rate.

    ``mean`` and ``scale`` are feature means and standard deviations, shape (F,), with infinity for constant features,
    which get weight 0. ``learning_rate`` is the largest; ``generator`` draws initial weights and batch order.
    """
    size = len(mean)

    def drawn(*shape: int, fan: int) -> Tensor:
        return (torch.rand(*shape, generator=generator) * 2 - 1) / math.sqrt(fan)

    first, first_bias = drawn(size, HIDDEN, fan=size), drawn(HIDDEN, fan=size)
    second, bias = drawn(HIDDEN, fan=HIDDEN), torch.zeros(())
    parameters = [each.requires_grad_() for each in (first, first_bias, second, bias)]
    optimizer = torch.optim.AdamW(parameters, lr=learning_rate, weight_decay=WEIGHT_DECAY)
    schedule = torch.optim.lr_scheduler.OneCycleLR(
        optimizer, learning_rate, total_steps=max(epochs * len(batches), 2)
    )

    def standardised() -> Ranker:
        # Standardise the weights instead of the features: far fewer numbers.
        scaled = first / scale[:, None]
        return Ranker(scaled, first_bias - mean @ scaled, second, bias)

    shuffled = (torch.randperm(len(batches), generator=generator).tolist() for _ in range(epochs))
    for number in chain.from_iterable(shuffled):
        features, competes, is_right = batches[number]
        scores = standardised()(features)
        log_shares = scores.masked_fill(~competes, -torch.inf).log_softmax(-1)
        loss = -log_shares.masked_fill(~is_right, -torch.inf).logsumexp(-1).mean()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        schedule.step()
    return Ranker(*(weights.detach() for weights in standardised().weights().values()))


def feature_scale(deviation: Tensor, span: Tensor) -> Tensor:
    """Return deviations, spans where the sample misses a feature, and inf for constants, whose weight is 0 then."""
    return torch.where(deviation > 1e-6, deviation, span).masked_fill(span <= 1e-6, torch.inf)


LinkRankers = tuple[Ranker, Ranker]
"""A ranker for combinesWith links and a ranker for componentOf links."""
LINK_QUERIES = 300
"""Largest number of queries per fold, relation and side (head or tail)."""
LINK_BATCH = 32
LINK_EPOCHS = 10
LINK_RATE = 5e-3
UNKNOWN = 0.1
"""Share of entities to hold out, so that rankers learn from words alone."""
TABLES = (8, 2)
"""Numbers of distractors (entities outside the recipe) on the two tables for each held-out recipe."""
PAIR_BATCH = 256
PAIR_EPOCHS = 30
PAIR_RATE = 1e-2
_MAKES = FEATURES.index("makes")


def fit_recipe_scorer(
    folds: Folds,
    text: Tensor,
    *,
    outside: LinkTables = NOTHING,
    left_out: Collection[int] = (),
    seed: int = 0,
    after: Callable[[], None] = lambda: None,
) -> tuple[RecipeKnowledge, LinkRankers]:
    """Fit a recipe scorer: link rankers (networks that score triples), then a recipe ranker that uses their scores.

    The ``folds`` of train recipes, except those with numbers in ``left_out``, are held out in turn. ``text`` holds
    cosines between word vectors of entities, shape (E, E), zeros without words; ``outside`` adds link features that are
    the same in all folds. ``seed`` is for initial weights and the sampled tables with distractors. ``after`` is called
    after each fold, and may raise to end the fit.

    Returns the feature arrays with the recipe ranker's weights, and the link rankers.
    """
    turns = _turns(folds, left_out)
    rng = np.random.default_rng([seed, *sorted(left_out)])
    generator = torch.Generator().manual_seed(int(rng.integers(2**31)))
    bases, rankers = fit_link_rankers(
        folds, text, outside=outside, left_out=left_out, rng=rng, generator=generator, after=after
    )
    whole = Base.of(folds.recipes(left_out), text)
    examples = [
        pair_examples(
            knowledge_from(base, rankers, outside), folds.recipes_of(fold), whole.recipes, rng
        )
        for fold, base in zip(turns, bases, strict=True)
    ]
    features, competes, is_right = (torch.cat(parts) for parts in zip(*examples, strict=True))
    flat = features[competes]
    order = torch.randperm(len(features), generator=generator)
    batches = [(features[rows], competes[rows], is_right[rows]) for rows in order.split(PAIR_BATCH)]
    mean, scale = flat.mean(0), feature_scale(flat.std(0), flat.amax(0) - flat.amin(0))
    ranker = fit_ranker(
        batches, mean, scale, epochs=PAIR_EPOCHS, learning_rate=PAIR_RATE, generator=generator
    )
    knowledge = knowledge_from(whole, rankers, outside)
    if scale[_MAKES].isinf():
        a, b, goal = torch.from_numpy(whole.recipes.copy()).T
        table = torch.stack([a, b], dim=1)
        of_known = knowledge.features(goal.contiguous(), table, torch.zeros_like(goal))[:, :, 1].T
        ranker = with_known(ranker, of_known, _MAKES, ranker(flat).amax())
    return knowledge.with_ranker(ranker), rankers


def knowledge_from(
    base: Base, rankers: LinkRankers, outside: LinkTables = NOTHING
) -> RecipeKnowledge:
    """Compute the arrays for recipe features from pair tables and link rankers; the recipe ranker's weights are 0."""
    pairs, parts = (
        torch.cat([ranker(rows) for rows in features.split(64)])
        for ranker, features in zip(rankers, link_features(base, outside), strict=True)
    )
    return knowledge_of(
        base.recipes, base.kernel, base.text, (base.pairs, base.parts), (pairs, parts)
    )


def scorer_tensors(
    knowledge: RecipeKnowledge, rankers: LinkRankers, recipes: Ids
) -> dict[str, Tensor]:
    """Return a recipe scorer's tensors by name: feature arrays, weights of all rankers, training recipes (n, 3)."""
    return {
        **knowledge.constants(),
        **{
            f"{relation}.{name}": weights
            for relation, ranker in zip(RELATIONS, rankers, strict=True)
            for name, weights in ranker.weights().items()
        },
        "recipes": torch.from_numpy(recipes.astype("int32")),
    }


# --- links -----------------------------------------------------------------------------------------------------------


def fit_link_rankers(
    folds: Folds,
    text: Tensor,
    *,
    outside: LinkTables = NOTHING,
    left_out: Collection[int] = (),
    rng: np.random.Generator,
    generator: torch.Generator,
    after: Callable[[], None] = lambda: None,
) -> tuple[list[Base], LinkRankers]:
    """Fit a ranker for each relation, on links from held-out folds and links to held-out (unknown) entities.

    Arguments as for :func:`fit_recipe_scorer`; ``rng`` draws queries and unknown entities, ``generator`` initial
    weights. Returns for each fold the pair tables computed without the fold, and the two rankers.
    """
    size = folds.split.graph.num_entities
    turns = _turns(folds, left_out)
    bases = [Base.of(folds.recipes([*left_out, fold]), text) for fold in turns]
    known = torch.zeros(2, size, size, dtype=torch.bool)
    heads, relations, tails = torch.from_numpy(folds.triples(left_out).copy()).T
    known[relations, heads, tails] = True
    batches: tuple[list[Batch], list[Batch]] = ([], [])
    moments: tuple[list[Tensor], list[Tensor]] = ([], [])
    spans: tuple[list[Tensor], list[Tensor]] = ([], [])
    nobody = torch.zeros(size, dtype=torch.bool)
    queries = [
        (base, _new_triples(folds.recipes_of(fold), base.recipes, size), nobody)
        for fold, base in zip(turns, bases, strict=True)
    ]
    queries.append(_unknown_entities(folds.recipes(left_out), text, rng))
    for base, new, unknown in queries:
        for relation, features in zip(
            (COMBINES_WITH, COMPONENT_OF), link_features(base, outside), strict=True
        ):
            cells = features.flatten(0, 1)
            # A view would keep the whole tensor.
            moments[relation].append(cells[:: max(7, len(cells) // 2**20)].clone())
            spans[relation].append(cells.amax(0) - cells.amin(0))
            # combinesWith is symmetric, so head queries equal tail queries.
            for side in ("tail",) if relation == COMBINES_WITH else ("tail", "head"):
                triples = new[new[:, 1] == relation]
                triples = triples[np.sort(rng.permutation(len(triples))[:LINK_QUERIES])]
                rng.shuffle(triples)
                for part in np.array_split(triples, max(1, round(len(triples) / LINK_BATCH))):
                    if len(part):
                        batches[relation].append(
                            _link_batch(features, known[relation], unknown, part, side)
                        )
        after()
    fitted = []
    for of_relation, seen, span in zip(batches, moments, spans, strict=True):
        together = torch.cat(seen)
        mean, scale = together.mean(0), feature_scale(together.std(0), torch.stack(span).amax(0))
        fitted.append(
            fit_ranker(
                of_relation,
                mean,
                scale,
                epochs=LINK_EPOCHS,
                learning_rate=LINK_RATE,
                generator=generator,
            )
        )
        after()
    return bases, (fitted[0], fitted[1])


def _turns(folds: Folds, left_out: Collection[int]) -> list[int]:
    return [fold for fold in range(folds.count) if fold not in left_out]


def _new_triples(held_out: Ids, seen: Ids, size: int) -> Ids:
    new = recipe_triples(held_out)
    return new[~is_in(new, recipe_triples(seen), size)]


def _unknown_entities(
    recipes: Ids, text: Tensor, rng: np.random.Generator
) -> tuple[Base, Ids, Tensor]:
    """Hold out entities with all recipes, so that the rankers learn to use words alone; return rest, links and mask."""
    entities = np.unique(recipes)
    taken = rng.permutation(entities)[: round(UNKNOWN * len(entities))]
    is_left = ~np.isin(recipes, taken).any(axis=1)
    triples = recipe_triples(recipes[~is_left])
    head_taken, tail_taken = (np.isin(triples[:, side], taken) for side in (0, 2))
    unknown = torch.zeros(len(text), dtype=torch.bool)
    unknown[torch.from_numpy(taken)] = True
    return Base.of(recipes[is_left], text), triples[head_taken != tail_taken], unknown


def _link_batch(features: Tensor, known: Tensor, unknown: Tensor, triples: Ids, side: str) -> Batch:
    """Return queries for a side; known links are left out, so only unknown entities compete with unknown ones."""
    heads, tails = torch.from_numpy(triples[:, 0].copy()), torch.from_numpy(triples[:, 2].copy())
    if side == "tail":
        rows, others, target = features[heads], known[heads], tails
    else:
        rows, others, target = (
            features[:, tails].transpose(0, 1).contiguous(),
            known[:, tails].T,
            heads,
        )
    others = others | (unknown[target][:, None] & ~unknown)
    is_right = torch.zeros_like(others).scatter(1, target[:, None], True)
    return rows, ~others | is_right, is_right


# --- pairs -----------------------------------------------------------------------------------------------------------


def pair_examples(
    knowledge: RecipeKnowledge, held_out: Ids, known: Ids, rng: np.random.Generator
) -> Batch:
    """Make queries from recipes on tables with distractors; every pair in a known recipe is right."""
    size = knowledge.num_entities
    weights = 1.0 + np.bincount(
        np.concatenate([known[:, 0], known[known[:, 0] != known[:, 1], 1]]), minlength=size
    )
    slots = 2 + max(TABLES)
    table = np.full((len(TABLES) * len(held_out), slots), size)
    for number, distractors in enumerate(TABLES):
        rows = slice(number * len(held_out), (number + 1) * len(held_out))
        table[rows] = _tables(held_out, distractors, slots, weights, rng)
    goal = torch.from_numpy(np.tile(held_out[:, 2], len(TABLES)))
    tables = torch.from_numpy(table)
    one, other = pairs_of(slots, tables.device)
    a, b = tables[:, one], tables[:, other]
    model = torch.zeros_like(goal)
    features = torch.cat(
        [
            knowledge.features(*part).permute(1, 2, 0)
            for part in zip(goal.split(512), tables.split(512), model.split(512), strict=True)
        ]
    )
    competes = (a < size) & (b < size)
    keys = torch.unique(_keys(torch.from_numpy(known.copy()), size))
    pair = torch.stack(
        [torch.minimum(a, b), torch.maximum(a, b), goal[:, None].expand_as(a)], dim=-1
    )
    pair_keys = _keys(pair, size)
    place = torch.searchsorted(keys, pair_keys).clamp(max=len(keys) - 1)
    return features, competes, (keys[place] == pair_keys) & competes


def with_known(ranker: Ranker, of_known: Tensor, makes: int, least: Tensor) -> Ranker:
    """Return a ranker that scores known recipes at least ``least``, and all other pairs as before, to the bit.

    Held-out goals have no known recipes, so the ranker learns nothing about the feature ``makes`` (a + b makes the
    goal), and low scores for known pairs, even with their own results. ``of_known`` are features of known recipes,
    shape (n, F), and ``makes`` is the feature's number.
    """
    units = of_known @ ranker.first
    units += ranker.first_bias
    positive = ranker.second.clamp(min=0)
    # A lower bound, because relu(x) is never below x.
    lowest = (units.relu() @ (ranker.second - positive) + units @ positive + ranker.bias).amin()
    first = ranker.first.clone()
    first[makes] = (least - lowest).clamp(min=0) / positive.sum() * (positive > 0)
    return replace(ranker, first=first)


def _keys(recipes: Tensor, size: int) -> Tensor:
    one, other, result = recipes.unbind(-1)
    return (one * (size + 1) + other) * (size + 1) + result


def _tables(
    recipes: Ids, distractors: int, slots: int, weights: np.ndarray, rng: np.random.Generator
) -> Ids:
    size = len(weights)
    keys = rng.exponential(size=(len(recipes), size)) / weights
    np.put_along_axis(keys, recipes, np.inf, axis=1)
    amount = max(min(distractors, size - 3), 0)
    drawn = np.argsort(keys, axis=1)[:, :amount]
    table = np.full((len(recipes), slots), size)
    table[:, :2] = recipes[:, :2]
    table[recipes[:, 0] == recipes[:, 1], 1] = size
    table[:, 2 : 2 + amount] = drawn
    return table
