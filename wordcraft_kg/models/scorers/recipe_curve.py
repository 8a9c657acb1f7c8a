"""Probabilities of recipes, from recipe scores: how likely does a pair make a result?

A recipe that the model was trained on has probability 1. Any other recipe has the logistic function
of its score, with a slope for all recipes and an intercept for each kind: is the result made by any
known recipe? The curve is fitted on folds of the train recipes, by models trained without each
fold. So a book's habits count: in a by-goal split, a goal that train recipes make has no unseen
recipe. Whether the pair makes anything known is left to the score: among random pairs such pairs
are those of frequent entities, which says nothing on a table, where frequent entities abound.

Source: Platt 1999 (the sigmoid); King and Zeng 2001 (weights for sampled negatives); Saerens,
Latinne and Decaestecker 2002 (change of base rate).
"""

import math
from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.special import expit
from torch import Tensor, nn

from wordcraft_kg.base.records import Coefficient, Record, Slope
from wordcraft_kg.graphs.arrays import Ids, recipe_keys
from wordcraft_kg.graphs.folds import Folds
from wordcraft_kg.models.scorers.neighbours.knowledge import RecipeKnowledge
from wordcraft_kg.models.scorers.neighbours.pair_features import pairs_of
from wordcraft_kg.models.scorers.ranking import sampled
from wordcraft_kg.models.scorers.recipes import RecipeScorer

KINDS = 2
"""Kinds of recipes, by number: whether a known recipe makes the result."""
_WIDTH = 0.05
"""Bin width of the histogram, in nats."""
_CENTRES = np.arange(-20, 30.01, _WIDTH)
"""Centres of the histogram's bins, in nats; scores beyond the ends count in the last bins."""
_FEWEST_TABLES = 4
"""Fewest sampled tables of a fold; in a large book, results are sampled instead."""
SAMPLED = 2_500
"""Results of a fold that are scored on random tables, about."""
_SLOTS = 12
"""Entities on a sampled table."""
MOST_OF_FOLD = 2**16
"""Most recipes of a fold, and most of its triples of a relation, that are scored.

A curve has at most four parameters; more would take minutes in a book of millions of recipes.
"""
_RIDGE = 1e-3
"""Weight of squared parameters in the loss: the intercept of a kind without data stays finite."""

_Floats = NDArray[np.float64]


class RecipeCurve(Record, frozen=True, kw_only=True):
    """The probability ``σ(α_kind + β s)`` of a recipe with the score s, in nats.

    Attributes:
        intercepts: α of each kind, see :data:`KINDS`, in nats.
        slope: β, 0 or more.
        shift: is added to α for the model trained on all folds, which leaves another number of
            recipes unseen.
    """

    intercepts: tuple[Coefficient, Coefficient]
    slope: Slope
    shift: Coefficient

    def log_probabilities(
        self,
        knowledge: RecipeKnowledge,
        goal: Tensor,
        table: Tensor,
        model: Tensor,
        pairs: tuple[Tensor, Tensor] | None = None,
        *,
        prior: float = 0.0,
    ) -> Tensor:
        """Return the log-probability that each pair of slots makes the goal.

        Args:
            knowledge: features and rankers of M models.
            goal: ids, shape (B,).
            table: entity ids in the slots, shape (B, A), E for empty slots.
            model: which model to use, shape (B,). Model 0 was trained on all folds, the others
                without a fold.
            pairs: first and second slot of P pairs, shape (P,) each; None for all pairs.
            prior: is added to α, in nats, for results that are more likely than results of random
                pairs.

        Returns:
            shape (B, P), in nats: 0 for known recipes. Pairs with an empty slot have no meaning.
        """
        features = knowledge.features(goal, table, model, pairs)
        scores = knowledge.scores(features, model)
        of_kinds = torch.tensor(self.intercepts, device=scores.device)
        kinds = kinds_of(knowledge, features)
        intercepts = of_kinds[kinds]
        of_model = torch.where(model == 0, self.shift, 0.0)
        shift = of_model[:, None] + prior
        log_odds = intercepts + shift + self.slope * scores
        is_known = knowledge.feature(features, "makes") > 0
        # A known recipe is certain: log 1 = 0.
        return nn.functional.logsigmoid(log_odds).masked_fill(is_known, 0)


def kinds_of(knowledge: RecipeKnowledge, features: Tensor) -> Tensor:
    """Return each recipe's kind, see :data:`KINDS`, from its features (F, ...)."""
    return (knowledge.feature(features, "goal_made") > 0).long()


def score_histogram(scorer: RecipeScorer, folds: Folds, fold: int, *, seed: int = 0) -> _Floats:
    """Count scores of recipes that the scorer has not seen, by kind.

    Args:
        scorer: trained without ``fold``.
        folds: folds of the train recipes.
        fold: number of the fold that the scorer was trained without.
        seed: seed of the random tables.

    Returns:
        shape (KINDS, 2, bins). Axis 1: pairs on random tables with each result, without train
        recipes, weighted so that they stand for all pairs; and the recipes of the fold.
    """
    knowledge = scorer.knowledge
    size = len(scorer.entities)
    counts = np.zeros((KINDS, 2, len(_CENTRES)))
    train_keys = recipe_keys(*folds.recipes().T, num_entities=size)

    def scored(goal: Tensor, table: Tensor, pairs: tuple[Tensor, Tensor] | None) -> tuple[Ids, Ids]:
        """Return kinds and bins of slot pairs for goals.

        Args:
            goal: ids, shape (B,).
            table: ids, shape (B, A).
            pairs: first and second slot of P pairs, shape (P,) each; None for all pairs.

        Returns:
            shape (B, P) each.
        """
        model = torch.zeros_like(goal)
        features = knowledge.features(goal, table, model, pairs)
        scores = knowledge.scores(features, model).cpu().numpy()
        kinds = kinds_of(knowledge, features).cpu().numpy()
        lowest = _CENTRES[0]
        highest = _CENTRES[-1]
        inside = np.clip(scores, lowest, highest)
        widths = (inside - lowest) / _WIDTH
        bins = np.rint(widths).astype(np.int64)
        return kinds, bins

    def count_table(goal: Tensor, slots: Tensor, weights: _Floats) -> None:
        """Count all slot pairs on a table for each goal, without train recipes.

        Args:
            goal: ids, shape (B,).
            slots: ids on the table, shape (A,).
            weights: how many pairs of entities each slot pair stands for, shape (P,).
        """
        table = slots.expand(len(goal), len(slots))
        kinds, bins = scored(goal, table, None)
        first, second = pairs_of(len(slots), slots.device)
        one = slots[None, first].numpy()
        other = slots[None, second].numpy()
        results = goal.numpy()[:, None]
        keys = recipe_keys(one, other, results, num_entities=size)
        is_train = np.isin(keys, train_keys)
        # A result on the table is no goal, and no task teaches the ranker that a + b makes no a.
        makes_itself = (one == results) | (other == results)
        counted = ~is_train & ~makes_itself
        of_pairs = np.broadcast_to(weights, bins.shape)
        cells = (kinds[counted], bins[counted])
        # Unlike `counts[cells] += 1`, `add.at` counts a cell each time it occurs.
        np.add.at(counts[:, 0], cells, of_pairs[counted])

    with torch.no_grad():
        of_fold = folds.recipes_of(fold)
        recipes = sampled(of_fold, MOST_OF_FOLD, seed)
        # In a large book, each sampled recipe stands for several.
        weight = len(of_fold) / max(len(recipes), 1)
        own = torch.from_numpy(recipes.copy())
        # A recipe is a table of two slots, and its only pair that counts is slot 0 with slot 1.
        only_pair = (torch.tensor([0]), torch.tensor([1]))
        made = own[:, 2]
        ingredients = own[:, :2]
        cells = scored(made, ingredients, only_pair)
        np.add.at(counts[:, 1], cells, weight)

        slots = min(_SLOTS, size)
        entities = torch.arange(size)
        tables = max(SAMPLED // size, _FEWEST_TABLES)
        rng = np.random.default_rng([seed, fold])
        most = SAMPLED // _FEWEST_TABLES
        if size > most:
            entities = torch.from_numpy(rng.permutation(size)[:most])
        tables_per_result = tables * len(entities) / size
        weights = _weights(slots, size, tables_per_result)
        for _ in range(tables):
            table = torch.from_numpy(rng.permutation(size)[:slots])
            count_table(entities, table, weights)
    return counts


def _weights(slots: int, size: int, tables: float) -> _Floats:
    """Return how many pairs of entities each slot pair of a random table stands for, shape (P,).

    A sampled result stands for several results, so ``tables`` is the number of tables for each of
    all results, and may be a fraction.
    """
    first, second = pairs_of(slots, torch.device("cpu"))
    one = first.numpy()
    other = second.numpy()
    # Pairs of an entity with itself are far rarer than others, but not on a table: each has its own
    # weight.
    is_self = one == other
    drawn = (~is_self).sum() * tables
    pairs = size * (size - 1) / 2
    of_different = pairs / max(drawn, 1)
    of_itself = size / (slots * tables)
    return np.where(is_self, of_itself, of_different)


def fit_recipe_curve(histograms: Sequence[_Floats], folds: Folds) -> RecipeCurve:
    """Fit a curve to each fold's :func:`score_histogram`, by maximum likelihood."""
    counts = np.sum(histograms, axis=0)
    # Shape (KINDS, bins) each.
    others = counts[:, 0]
    recipes = counts[:, 1]
    pairs = counts.sum(axis=1)

    def loss(values: _Floats) -> tuple[float, _Floats]:
        """Return the regularised negative log-likelihood and its gradient."""
        intercepts = values[:KINDS, None]
        slope = values[KINDS]
        log_odds = intercepts + slope * _CENTRES
        # Expected minus observed recipes in each bin: the derivative by the log-odds.
        expected = pairs * expit(log_odds)
        error = expected - recipes
        # The negative log-probabilities of "makes nothing" and of "makes the result".
        of_others = others * np.logaddexp(0, log_odds)
        of_recipes = recipes * np.logaddexp(0, -log_odds)
        total = (of_others + of_recipes).sum()
        by_intercept = error.sum(axis=1)
        by_slope = (error * _CENTRES).sum()
        gradient = np.append(by_intercept, by_slope)
        penalty = _RIDGE / 2 * values @ values
        return float(total + penalty), gradient + _RIDGE * values

    # Few pairs make a given result, so the search starts at small probabilities. A higher score
    # never makes a recipe less likely, so the slope is bounded.
    start = np.array([-12.0] * KINDS + [1.0])
    any_number = (None, None)
    not_negative = (0, None)
    bounds = [any_number] * KINDS + [not_negative]
    best = minimize(loss, start, jac=True, method="L-BFGS-B", bounds=bounds)
    new, made, slope = best.x.tolist()
    # The curve was fitted where a fold's recipes are unseen, seen / count of them on average. With
    # all folds, the recipes outside train are.
    is_seen = folds.seen()
    num_seen = max(int(is_seen.sum()), 1)
    num_unseen = max(int((~is_seen).sum()), 1)
    shift = math.log(num_unseen * folds.count / num_seen)
    return RecipeCurve(intercepts=(new, made), slope=slope, shift=shift)
