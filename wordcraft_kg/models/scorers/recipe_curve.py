"""Probabilities of recipes, from recipe scores: how likely does a pair make a result?

A recipe that the model was trained on has probability 1. Any other recipe has the logistic function of its score, with
a slope for all recipes and an intercept for each kind: does the pair make anything known, and is the result made by any
known recipe? The curve is fitted on folds of the train recipes, by models trained without each fold. So a book's
habits count: in a by-goal split, a goal that train recipes make has no unseen recipe.

Source: Platt 1999 (the sigmoid); King and Zeng 2001 (weights for sampled negatives); Saerens, Latinne and Decaestecker
2002 (change of base rate).
"""

import math
from collections.abc import Sequence

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.special import expit
from torch import Tensor, nn

from wordcraft_kg.base.records import Record
from wordcraft_kg.graphs.folds import Folds
from wordcraft_kg.models.scorers.pair_knowledge import PairKnowledge, pairs_of
from wordcraft_kg.models.scorers.recipes import RecipeScorer

KINDS = 4
"""Kinds of recipes, ``2 * (the pair makes something known) + (a known recipe makes the result)``."""
_CENTRES = np.arange(-20, 30.01, 0.05)
_FEWEST_TABLES = 4
"""Fewest sampled tables of a fold; in a large book, results are sampled instead."""
_SLOTS = 12
"""Entities on a sampled table."""
_RIDGE = 1e-3

_Floats = NDArray[np.float64]


class RecipeCurve(Record, frozen=True, kw_only=True):
    """The probability ``σ(α_kind + β s)`` of a recipe score s in nats; ``shift`` is added to α with all folds."""

    intercepts: tuple[float, float, float, float]
    slope: float
    shift: float

    def log_probabilities(
        self,
        knowledge: PairKnowledge,
        goal: Tensor,
        table: Tensor,
        model: Tensor,
        pairs: tuple[Tensor, Tensor] | None = None,
        *,
        prior: float = 0.0,
    ) -> Tensor:
        """Return the log-probability that each pair of slots makes the goal, shape (B, P); arguments as for features.

        ``prior`` is added to α, for results that are more likely than results of random pairs. Model 0 was trained on
        all folds, the others without a fold. Pairs with an empty slot have no meaning.
        """
        features = knowledge.features(goal, table, model, pairs)
        scores = knowledge.scores(features, model)
        intercepts = torch.tensor(self.intercepts, device=scores.device)[
            kinds_of(knowledge, features)
        ]
        shift = torch.where(model == 0, self.shift, 0.0)[:, None] + prior
        return nn.functional.logsigmoid(intercepts + shift + self.slope * scores).masked_fill(
            knowledge.feature(features, "makes") > 0, 0
        )


def kinds_of(knowledge: PairKnowledge, features: Tensor) -> Tensor:
    """Return each recipe's kind, see :data:`KINDS`, from its features (F, ...)."""
    is_known = knowledge.feature(features, "known") > 0
    is_made = knowledge.feature(features, knowledge.made_name) > 0
    return 2 * is_known.long() + is_made.long()


def score_histogram(scorer: RecipeScorer, folds: Folds, fold: int, *, seed: int = 0) -> _Floats:
    """Count scores without ``fold``, (kinds, 2, bins): pairs on random tables, weighted, and its recipes."""
    knowledge, size = scorer.knowledge, len(scorer.entities)
    counts = np.zeros((KINDS, 2, len(_CENTRES)))
    train = folds.recipes()
    is_train = _codes(train, size)

    def count(
        goal: Tensor, table: Tensor, pairs: tuple[Tensor, Tensor] | None, weights: _Floats | None
    ) -> None:
        model = torch.zeros_like(goal)
        features = knowledge.features(goal, table, model, pairs)
        scores, kinds = (
            knowledge.scores(features, model).cpu().numpy(),
            kinds_of(knowledge, features).cpu().numpy(),
        )
        bins = np.rint((np.clip(scores, _CENTRES[0], _CENTRES[-1]) - _CENTRES[0]) / 0.05).astype(
            np.int64
        )
        if weights is None:
            np.add.at(counts[:, 1], (kinds, bins), 1)
            return
        one, other = (table[:1, slots].numpy() for slots in pairs_of(table.shape[1], table.device))
        recipes = np.broadcast_arrays(
            np.minimum(one, other), np.maximum(one, other), goal.numpy()[:, None]
        )
        is_other = ~np.isin(
            _codes(np.stack(recipes, axis=-1).reshape(-1, 3), size), is_train
        ).reshape(scores.shape)
        np.add.at(
            counts[:, 0],
            (kinds[is_other], bins[is_other]),
            np.broadcast_to(weights, scores.shape)[is_other],
        )

    with torch.no_grad():
        own = torch.from_numpy(folds.recipes_of(fold).copy())
        first, second = torch.tensor([0]), torch.tensor([1])
        count(own[:, 2], own[:, :2], (first, second), None)
        slots, entities = min(_SLOTS, size), torch.arange(size)
        tables = max(knowledge.sampled_results // size, _FEWEST_TABLES)
        one, other = (part.numpy() for part in pairs_of(slots, entities.device))
        rng = np.random.default_rng([seed, fold])
        most = knowledge.sampled_results // _FEWEST_TABLES
        if size > most:
            entities = torch.from_numpy(rng.permutation(size)[:most])
        # A sampled result stands for several results.
        tables_of_all = tables * len(entities) / size
        rest = size * (size - 1) / 2 / max((one != other).sum() * tables_of_all, 1)
        weights = np.where(one == other, size / (slots * tables_of_all), rest)
        for _ in range(tables):
            table = torch.from_numpy(rng.permutation(size)[:slots])
            count(entities, table.expand(len(entities), slots), None, weights)
    return counts


def fit_recipe_curve(histograms: Sequence[_Floats], folds: Folds) -> RecipeCurve:
    """Fit a curve to each fold's :func:`score_histogram`, by maximum likelihood."""
    counts = np.sum(histograms, axis=0)

    def loss(values: _Floats) -> tuple[float, _Floats]:
        log_odds = values[:KINDS, None] + values[KINDS] * _CENTRES
        error = counts.sum(axis=1) * expit(log_odds) - counts[:, 1]
        total = (
            counts[:, 0] * np.logaddexp(0, log_odds) + counts[:, 1] * np.logaddexp(0, -log_odds)
        ).sum()
        slopes = np.append(error.sum(axis=1), (error * _CENTRES).sum())
        return float(total + _RIDGE / 2 * values @ values), slopes + _RIDGE * values

    start = np.array([-12.0] * KINDS + [1.0])
    *intercepts, slope = minimize(
        loss, start, jac=True, method="L-BFGS-B", bounds=[(None, None)] * KINDS + [(0, None)]
    ).x
    seen = folds.seen()
    shift = math.log(max(int((~seen).sum()), 1) * folds.count / max(int(seen.sum()), 1))
    a, b, c, d = map(float, intercepts)
    return RecipeCurve(intercepts=(a, b, c, d), slope=float(slope), shift=shift)


def _codes(recipes: NDArray[np.int64], size: int) -> NDArray[np.int64]:
    return (recipes[:, 0] * size + recipes[:, 1]) * size + recipes[:, 2]
