"""Fit a recipe scorer by stacking: rankers learn from features of held-out recipes.

Rankers are small networks. Each fold's features come from the remaining folds, and a ranker learns
feature weights. The final scorer applies the ranker to features from all recipes (Wolpert 1992; van
der Laan, Polley and Hubbard 2007). For cross-fitting, a scorer without a fold is fitted in the same
way on the remaining folds.
"""

import math
from collections.abc import Callable, Collection, Sequence
from dataclasses import replace

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
"""Hidden units of a ranker."""
WEIGHT_DECAY = 1e-4
"""Weight decay of AdamW."""
_SMALL = 1e-6
"""Deviations and spans up to this number are rounding."""

Batch = tuple[Tensor, Tensor, Tensor]
"""B queries with N candidates: features (B, N, F), and masks (B, N) for competing and right
ones."""


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

    The loss per query is ``-log Σ_right softmax(scores)``, minimised with AdamW and one cycle of
    the learning rate.

    Args:
        batches: queries; each has a right candidate.
        mean: feature means, shape (F,).
        scale: standard deviations of features, shape (F,); infinity for constant features, which
            get weight 0.
        epochs: passes over all batches.
        learning_rate: the largest in the cycle.
        generator: draws initial weights, then the order of batches.

    Returns:
        a ranker of features that are not standardised.
    """
    size = len(mean)

    def drawn(*shape: int, fan: int) -> Tensor:
        weights = torch.rand(*shape, generator=generator) * 2 - 1
        return weights / math.sqrt(fan)

    # Weights are drawn in this order: another order gives other models for the same seed.
    first = drawn(size, HIDDEN, fan=size)
    first_bias = drawn(HIDDEN, fan=size)
    second = drawn(HIDDEN, fan=HIDDEN)
    bias = torch.zeros(())
    parameters = [each.requires_grad_() for each in (first, first_bias, second, bias)]
    optimizer = torch.optim.AdamW(parameters, lr=learning_rate, weight_decay=WEIGHT_DECAY)
    schedule = torch.optim.lr_scheduler.OneCycleLR(
        optimizer,
        learning_rate,
        total_steps=max(epochs * len(batches), 2),
    )

    def standardised() -> Ranker:
        # Standardise the weights instead of the features: far fewer numbers.
        scaled = first / scale[:, None]
        return Ranker(scaled, first_bias - mean @ scaled, second, bias)

    for _ in range(epochs):
        for number in torch.randperm(len(batches), generator=generator).tolist():
            features, competes, is_right = batches[number]
            scores = standardised()(features)
            log_shares = scores.masked_fill(~competes, -torch.inf).log_softmax(-1)
            of_right = log_shares.masked_fill(~is_right, -torch.inf)
            loss = -of_right.logsumexp(-1).mean()
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
            schedule.step()
    return Ranker(*(weights.detach() for weights in standardised().weights().values()))


def feature_scale(deviation: Tensor, span: Tensor) -> Tensor:
    """Return the numbers by which features are divided, shape (F,), from deviations and spans.

    A feature that the sample misses is divided by its span, a constant by infinity: weight 0.
    """
    scale = torch.where(deviation > _SMALL, deviation, span)
    return scale.masked_fill(span <= _SMALL, torch.inf)


LinkRankers = tuple[Ranker, Ranker]
"""A ranker for combinesWith links and a ranker for componentOf links."""
LINK_QUERIES = 300
"""Largest number of queries per fold, relation and side (head or tail)."""
LINK_BATCH = 32
"""Queries of a step of a link ranker, about."""
LINK_EPOCHS = 10
"""Passes of a link ranker over all queries."""
LINK_RATE = 5e-3
"""Largest learning rate of a link ranker."""
UNKNOWN = 0.1
"""Share of entities to hold out, so that rankers learn from words alone."""
TABLES = (8, 2)
"""Distractors (entities outside the recipe) on each of the tables for a held-out recipe."""
PAIR_BATCH = 256
"""Tables of a step of the recipe ranker."""
PAIR_EPOCHS = 30
"""Passes of the recipe ranker over all tables."""
PAIR_RATE = 1e-2
"""Largest learning rate of the recipe ranker."""
_MAKES = FEATURES.index("makes")
_SAMPLE = 2**20
"""Links of a table, about, from which means and deviations of features are taken."""
_EVERY = 7
"""Smallest step of this sample, for small tables too."""
_LINK_ROWS = 64
"""Heads whose links are scored at once."""
_TABLE_ROWS = 512
"""Tables whose features are computed at once."""


def fit_recipe_scorer(
    folds: Folds,
    text: Tensor,
    *,
    outside: LinkTables = NOTHING,
    left_out: Collection[int] = (),
    seed: int = 0,
    after: Callable[[], None] = lambda: None,
) -> tuple[RecipeKnowledge, LinkRankers]:
    """Fit a recipe scorer: link rankers, then a recipe ranker that uses their scores.

    Link rankers are networks that score triples. The folds are held out in turn.

    Args:
        folds: folds of the train recipes.
        text: cosines between word vectors of entities, shape (E, E); zeros without words.
        outside: link features that are the same in all folds.
        left_out: numbers of folds that the scorer must not see.
        seed: for initial weights and the sampled tables with distractors.
        after: called after each fold and each link ranker; may raise to end the fit.

    Returns:
        the feature arrays with the recipe ranker's weights, and the link rankers.
    """
    turns = _turns(folds, left_out)
    rng = np.random.default_rng([seed, *sorted(left_out)])
    # The first draw of `rng`, so that networks and tables follow from one seed.
    torch_seed = int(rng.integers(2**31))
    generator = torch.Generator().manual_seed(torch_seed)
    bases, rankers = fit_link_rankers(
        folds,
        text,
        outside=outside,
        left_out=left_out,
        rng=rng,
        generator=generator,
        after=after,
    )
    whole = Base.of(folds.recipes(left_out), text)
    examples = []
    for fold, base in zip(turns, bases, strict=True):
        # Features of a held-out recipe come from the other folds, as those of an unseen recipe.
        # Their knowledge gets no name: two of them would take twice the memory.
        held_out = folds.recipes_of(fold)
        of_fold = pair_examples(
            knowledge_from(base, rankers, outside),
            held_out,
            whole.recipes,
            rng,
        )
        examples.append(of_fold)
    features, competes, is_right = (torch.cat(parts) for parts in zip(*examples, strict=True))
    flat = features[competes]
    order = torch.randperm(len(features), generator=generator)
    batches = []
    for rows in order.split(PAIR_BATCH):
        batches.append((features[rows], competes[rows], is_right[rows]))
    mean = flat.mean(0)
    span = flat.amax(0) - flat.amin(0)
    scale = feature_scale(flat.std(0), span)
    ranker = fit_ranker(
        batches,
        mean,
        scale,
        epochs=PAIR_EPOCHS,
        learning_rate=PAIR_RATE,
        generator=generator,
    )
    knowledge = knowledge_from(whole, rankers, outside)
    # By-goal folds: no held-out goal has a known recipe.
    if scale[_MAKES].isinf():
        a, b, goal = torch.from_numpy(whole.recipes.copy()).T
        table = torch.stack([a, b], dim=1)
        # A table of two slots has the pairs (a, a), (a, b) and (b, b): the recipe is number 1.
        of_pairs = knowledge.features(goal.contiguous(), table, torch.zeros_like(goal))
        of_known = of_pairs[:, :, 1].T
        ranker = with_known(ranker, of_known, _MAKES, ranker(flat).amax())
    return knowledge.with_ranker(ranker), rankers


def knowledge_from(
    base: Base,
    rankers: LinkRankers,
    outside: LinkTables = NOTHING,
) -> RecipeKnowledge:
    """Compute the arrays for recipe features from pair tables and link rankers.

    Args:
        base: pair tables.
        rankers: score the links.
        outside: further link features, as in the rankers' training.

    Returns:
        knowledge with weights of 0 in place of a recipe ranker's.
    """
    # A generator: the features of one relation at a time, by far the largest arrays, and none of
    # them when the knowledge is made.
    by_relation = zip(rankers, link_features(base, outside), strict=True)
    pairs, parts = (_link_scores(ranker, features) for ranker, features in by_relation)
    return knowledge_of(
        base.recipes,
        base.kernel,
        base.text,
        (base.pairs, base.parts),
        (pairs, parts),
    )


def _link_scores(ranker: Ranker, features: Tensor) -> Tensor:
    """Return the scores of all links, shape (E, E), from features (E, E, F)."""
    return torch.cat([ranker(rows) for rows in features.split(_LINK_ROWS)])


def scorer_tensors(
    knowledge: RecipeKnowledge,
    rankers: LinkRankers,
    recipes: Ids,
) -> dict[str, Tensor]:
    """Return a recipe scorer's tensors by name, as they are saved.

    Args:
        knowledge: feature arrays and the recipe ranker's weights.
        rankers: link rankers, whose weights get the prefix of a relation.
        recipes: training recipes, ids (n, 3).
    """
    tensors = dict(knowledge.constants())
    for relation, ranker in zip(RELATIONS, rankers, strict=True):
        for name, weights in ranker.weights().items():
            tensors[f"{relation}.{name}"] = weights
    tensors["recipes"] = torch.from_numpy(recipes.astype("int32"))
    return tensors


# --- links ----------------------------------------------------------------------------------------


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
    """Fit a ranker for each relation.

    Rankers learn from links of held-out folds, and from links to held-out (unknown) entities.

    Args:
        folds: folds of the train recipes.
        text: cosines between word vectors of entities, shape (E, E); zeros without words.
        outside: link features that are the same in all folds.
        left_out: numbers of folds that the rankers must not see.
        rng: draws unknown entities and queries.
        generator: draws initial weights and the order of batches.
        after: called after each fold and each ranker; may raise to end the fit.

    Returns:
        for each fold the pair tables computed without the fold, and the two rankers.
    """
    size = folds.split.graph.num_entities
    turns = _turns(folds, left_out)
    bases = [Base.of(folds.recipes([*left_out, fold]), text) for fold in turns]
    known = torch.zeros(2, size, size, dtype=torch.bool)
    heads, relations, tails = torch.from_numpy(folds.triples(left_out).copy()).T
    known[relations, heads, tails] = True

    nobody = torch.zeros(size, dtype=torch.bool)
    queries = []
    for fold, base in zip(turns, bases, strict=True):
        new = _new_triples(folds.recipes_of(fold), base.recipes, size)
        queries.append((base, new, nobody))
    queries.append(_unknown_entities(folds.recipes(left_out), text, rng))

    # Lists by relation: batches, samples of features, and spans of features.
    batches: tuple[list[Batch], list[Batch]] = ([], [])
    samples: tuple[list[Tensor], list[Tensor]] = ([], [])
    spans: tuple[list[Tensor], list[Tensor]] = ([], [])
    for base, new, unknown in queries:
        by_relation = zip((COMBINES_WITH, COMPONENT_OF), link_features(base, outside), strict=True)
        for relation, features in by_relation:
            cells = features.flatten(0, 1)
            step = max(_EVERY, len(cells) // _SAMPLE)
            # A view would keep the whole tensor.
            samples[relation].append(cells[::step].clone())
            spans[relation].append(cells.amax(0) - cells.amin(0))
            # combinesWith is symmetric, so head queries equal tail queries.
            sides = ("tail",) if relation == COMBINES_WITH else ("tail", "head")
            triples = new[new[:, 1] == relation]
            for side in sides:
                for part in _drawn_parts(triples, rng):
                    batch = _link_batch(features, known[relation], unknown, part, side)
                    batches[relation].append(batch)
        after()

    fitted = []
    for of_relation, sample, span in zip(batches, samples, spans, strict=True):
        together = torch.cat(sample)
        mean = together.mean(0)
        scale = feature_scale(together.std(0), torch.stack(span).amax(0))
        ranker = fit_ranker(
            of_relation,
            mean,
            scale,
            epochs=LINK_EPOCHS,
            learning_rate=LINK_RATE,
            generator=generator,
        )
        fitted.append(ranker)
        after()
    return bases, (fitted[0], fitted[1])


def _drawn_parts(triples: Ids, rng: np.random.Generator) -> list[Ids]:
    """Draw at most :data:`LINK_QUERIES` triples, and split them into batches, none empty."""
    # Sorted, then shuffled: other draws would give other models for the same seed.
    rows = np.sort(rng.permutation(len(triples))[:LINK_QUERIES])
    chosen = triples[rows]
    rng.shuffle(chosen)
    parts = np.array_split(chosen, max(1, round(len(chosen) / LINK_BATCH)))
    return [part for part in parts if len(part)]


def _turns(folds: Folds, left_out: Collection[int]) -> list[int]:
    """Return the numbers of the folds that are held out in turn."""
    return [fold for fold in range(folds.count) if fold not in left_out]


def _new_triples(held_out: Ids, seen: Ids, size: int) -> Ids:
    """Return the triples of held-out recipes that no seen recipe has: ids (n, 3)."""
    new = recipe_triples(held_out)
    return new[~is_in(new, recipe_triples(seen), size)]


def _unknown_entities(
    recipes: Ids,
    text: Tensor,
    rng: np.random.Generator,
) -> tuple[Base, Ids, Tensor]:
    """Hold out entities with all their recipes, so that the rankers learn to use words alone.

    Args:
        recipes: ids, shape (n, 3).
        text: word cosines, shape (E, E).
        rng: draws the entities.

    Returns:
        pair tables of the other recipes; triples (n, 3) between a held-out entity and another one;
        and whether each entity is held out, shape (E,).
    """
    entities = np.unique(recipes)
    taken = rng.permutation(entities)[: round(UNKNOWN * len(entities))]
    is_left = ~np.isin(recipes, taken).any(axis=1)
    triples = recipe_triples(recipes[~is_left])
    head_taken = np.isin(triples[:, 0], taken)
    tail_taken = np.isin(triples[:, 2], taken)
    unknown = torch.zeros(len(text), dtype=torch.bool)
    unknown[torch.from_numpy(taken)] = True
    return Base.of(recipes[is_left], text), triples[head_taken != tail_taken], unknown


def _link_batch(features: Tensor, known: Tensor, unknown: Tensor, triples: Ids, side: str) -> Batch:
    """Return queries for a side of triples.

    Other known links do not compete, nor do known entities with an unknown one: a link to an entity
    with recipes is far more probable than one to an entity without.

    Args:
        features: shape (E, E, F), row = head.
        known: shape (E, E), bool: known links of the relation.
        unknown: shape (E,), bool: held-out entities.
        triples: ids, shape (B, 3).
        side: the side to predict, "tail" or "head".
    """
    heads = torch.from_numpy(triples[:, 0].copy())
    tails = torch.from_numpy(triples[:, 2].copy())
    if side == "tail":
        rows = features[heads]
        is_known = known[heads]
        target = tails
    else:
        # (E, B, F) to (B, E, F), copied once: the ranker reads each batch in every epoch.
        rows = features[:, tails].transpose(0, 1).contiguous()
        is_known = known[:, tails].T
        target = heads
    excluded = is_known | (unknown[target][:, None] & ~unknown)
    is_right = torch.zeros_like(excluded).scatter(1, target[:, None], True)
    return rows, ~excluded | is_right, is_right


# --- pairs ----------------------------------------------------------------------------------------


def pair_examples(
    knowledge: RecipeKnowledge,
    held_out: Ids,
    known: Ids,
    rng: np.random.Generator,
) -> Batch:
    """Make queries from recipes on tables with distractors.

    Args:
        knowledge: computes the features.
        held_out: recipes that ``knowledge`` has not seen, ids (n, 3).
        known: all recipes that may be known, ids (m, 3): every pair that makes the goal by one of
            them is right.
        rng: draws distractors.

    Returns:
        a query for each recipe and each entry of :data:`TABLES`, whose candidates are pairs of
        slots.
    """
    size = knowledge.num_entities
    # Distractors are drawn as environments draw them: by 1 + the number of recipes with the entity,
    # in which an entity that is combined with itself counts once.
    differ = known[:, 0] != known[:, 1]
    users = np.concatenate([known[:, 0], known[differ, 1]])
    weights = 1.0 + np.bincount(users, minlength=size)
    slots = 2 + max(TABLES)
    drawn = [_tables(held_out, distractors, slots, weights, rng) for distractors in TABLES]
    tables = torch.from_numpy(np.concatenate(drawn))
    goal = torch.from_numpy(np.tile(held_out[:, 2], len(TABLES)))
    model = torch.zeros_like(goal)

    features = []
    for rows in torch.arange(len(goal)).split(_TABLE_ROWS):
        of_rows = knowledge.features(goal[rows], tables[rows], model[rows])
        # (F, B, P) to (B, P, F): the ranker multiplies the last axis.
        features.append(of_rows.permute(1, 2, 0))

    one, other = pairs_of(slots, tables.device)
    a = tables[:, one]
    b = tables[:, other]
    competes = (a < size) & (b < size)
    keys = torch.unique(_keys(torch.from_numpy(known.copy()), size))
    goals = goal[:, None].expand_as(a)
    # Known recipes have the smaller ingredient first.
    smaller = torch.minimum(a, b)
    larger = torch.maximum(a, b)
    pair = torch.stack([smaller, larger, goals], dim=-1)
    pair_keys = _keys(pair, size)
    # A key beyond the last one is compared with the last one, and differs.
    place = torch.searchsorted(keys, pair_keys).clamp(max=len(keys) - 1)
    is_right = (keys[place] == pair_keys) & competes
    return torch.cat(features), competes, is_right


def with_known(ranker: Ranker, of_known: Tensor, makes: int, least: Tensor) -> Ranker:
    """Return a ranker that scores known recipes at least ``least``, other pairs as before.

    Scores of other pairs stay the same to the bit. Held-out goals have no known recipes, so the
    ranker learns nothing about the feature ``makes`` (a + b makes the goal), and low scores for
    known pairs, even with their own results.

    Args:
        ranker: has weights of 0 for the feature ``makes``.
        of_known: features of known recipes, shape (n, F).
        makes: number of the feature ``makes``.
        least: smallest score of a known recipe, shape ().
    """
    units = of_known @ ranker.first
    units += ranker.first_bias
    positive = ranker.second.clamp(min=0)
    # A lower bound, because relu(x) is never below x.
    negative = ranker.second - positive
    scores = units.relu() @ negative + units @ positive + ranker.bias
    lowest = scores.amin()
    first = ranker.first.clone()
    # The same lift for all units that raise the score.
    lift = (least - lowest).clamp(min=0) / positive.sum()
    first[makes] = lift * (positive > 0)
    return replace(ranker, first=first)


def _keys(recipes: Tensor, size: int) -> Tensor:
    """Return a number for each recipe, ids (..., 3) from 0 to E: different for different ones."""
    one, other, result = recipes.unbind(-1)
    return (one * (size + 1) + other) * (size + 1) + result


def _tables(
    recipes: Ids,
    distractors: int,
    slots: int,
    weights: np.ndarray,
    rng: np.random.Generator,
) -> Ids:
    """Return tables with the ingredients of recipes and drawn entities.

    Args:
        recipes: ids, shape (n, 3).
        distractors: number of drawn entities, fewer in a small graph.
        slots: A.
        weights: how likely each entity is drawn, shape (E,).
        rng: draws the entities.

    Returns:
        ids, shape (n, A); E for empty slots.
    """
    size = len(weights)
    # The smallest of exponential variables divided by weights: draws without replacement.
    keys = rng.exponential(size=(len(recipes), size)) / weights
    np.put_along_axis(keys, recipes, np.inf, axis=1)
    amount = max(min(distractors, size - 3), 0)
    drawn = np.argsort(keys, axis=1)[:, :amount]
    table = np.full((len(recipes), slots), size)
    table[:, :2] = recipes[:, :2]
    # An entity is on a table once, also if the recipe combines it with itself.
    is_twice = recipes[:, 0] == recipes[:, 1]
    table[is_twice, 1] = size
    table[:, 2 : 2 + amount] = drawn
    return table
