"""Cross-fitting: scores for train recipes by models trained without these recipes.

Scorers remember their training recipes, so agents that learn from these scores overrate the scorer. The train recipes
are cut into folds (:mod:`wordcraft_kg.graphs.folds`); each fold has a model trained on the remaining folds.

Source: Wolpert 1992 (stacking); Breiman 1996; van der Laan, Polley and Hubbard 2007; Chernozhukov et al. 2018.
"""

from collections.abc import Callable, Sequence
from functools import partial
from typing import Literal

import numpy as np
import torch
from numpy.typing import NDArray

from wordcraft_kg.base.errors import ConfigError, GraphMismatchError, LeakError
from wordcraft_kg.base.records import Count, Hash, Record, Share
from wordcraft_kg.graphs.arrays import Ids, frozen
from wordcraft_kg.graphs.folds import OUTSIDE, SEVERAL, Folds, fold_of_tasks, make_folds
from wordcraft_kg.graphs.recipe_graph import RecipeGraph
from wordcraft_kg.graphs.splits import Split
from wordcraft_kg.graphs.tasks import TaskSet
from wordcraft_kg.graphs.train_samples import TrainSample
from wordcraft_kg.graphs.triples import recipe_triples, triples_hash
from wordcraft_kg.models.scorers.calibration import Probabilities
from wordcraft_kg.models.scorers.protocol import FactoredScorer, TripleScorer
from wordcraft_kg.models.scorers.recipes import RecipeScores
from wordcraft_kg.models.scorers.scorer import EntityIds, RelationIds, Scorer


class Fold(Record, frozen=True, kw_only=True):
    """A model without one fold: hash of its triples, and MRR on the fold's queries, also in sample."""

    trained_on: Hash
    triples: Count
    queries: Count
    mrr: Share | None
    in_sample_mrr: Share | None


class FoldsRecord(Record, frozen=True, kw_only=True):
    """The file ``folds.json``: the seed and hash of the folds, and the model trained without each fold."""

    format: Literal["wordcraft-kg folds 1"] = "wordcraft-kg folds 1"
    seed: Count
    hash: Hash
    folds: tuple[Fold, ...]

    @property
    def count(self) -> int:
        """Number of folds."""
        return len(self.folds)

    @property
    def queries(self) -> int:
        """Number of ranking queries, summed over folds."""
        return sum(fold.queries for fold in self.folds)

    @property
    def mrr(self) -> float | None:
        """Mean reciprocal rank on train triples by models without the triple's fold; no forecast of the test MRR."""
        return self._mean([fold.mrr for fold in self.folds])

    @property
    def in_sample_mrr(self) -> float | None:
        """Mean reciprocal rank on the triples of :attr:`mrr` by the model trained on all folds."""
        return self._mean([fold.in_sample_mrr for fold in self.folds])

    def _mean(self, values: Sequence[float | None]) -> float | None:
        sums = [
            value * fold.queries
            for value, fold in zip(values, self.folds, strict=True)
            if value is not None
        ]
        return sum(sums) / self.queries if sums else None


class CrossFitted(Scorer):
    """A scorer trained on all train recipes, with K fold scorers: one trained without each of K folds.

    Scores and tables come from ``whole``; if ``whole`` is a recipe scorer, so do ``score_recipes``,
    ``supporting_recipes`` and ``recipes``. Agents that learn on train tasks need :meth:`left_out`;
    :func:`~wordcraft_kg.models.policies.sources.registry.make_sources` chooses the fold to leave out.

    Made from ``whole`` and ``folds``: a function per fold that returns the scorer trained without this fold.

    Attributes:
        record: fold seed, hash and metrics.
        of_recipe: each recipe's fold, shape (num_recipes,); :data:`~wordcraft_kg.graphs.folds.OUTSIDE` for recipes
            outside train.
        probabilities: maps scores to probabilities; None before a model folder is written, or if it has none.
        train_results: training results if some recipes were left out or made wrong, see
            :class:`~wordcraft_kg.graphs.train_samples.TrainSample`; None for unchanged train recipes.
    """

    def __init__(
        self,
        whole: Scorer,
        folds: Sequence[Callable[[], Scorer]],
        of_recipe: Ids,
        record: FoldsRecord,
        probabilities: Probabilities | None = None,
        train_results: Ids | None = None,
    ):
        super().__init__(whole.entities, whole.graph_hash, whole.device, whole.name)
        self._whole, self.record, self.probabilities = whole, record, probabilities
        self.of_recipe = frozen(np.asarray(of_recipe, dtype=np.int64))
        self.train_results = (
            None if train_results is None else frozen(np.asarray(train_results, dtype=np.int64))
        )
        self._makers = tuple(folds)
        self._made: dict[int, Scorer] = {}
        if isinstance(whole, FactoredScorer):  # makes this scorer a FactoredScorer
            self.factors = whole.factors
        if isinstance(whole, RecipeScores):  # likewise
            self.recipes, self.score_recipes = whole.recipes, whole.score_recipes
            self.supporting_recipes = whole.supporting_recipes

    @property
    def whole(self) -> Scorer:  # noqa: D102 - inherited
        return self._whole

    @property
    def folds(self) -> "CrossFitted":  # noqa: D102 - inherited
        return self

    @property
    def count(self) -> int:
        """Number of folds."""
        return len(self._makers)

    def _score(
        self, heads: torch.Tensor, relations: torch.Tensor, tails: torch.Tensor
    ) -> torch.Tensor:
        return self.whole._score(heads, relations, tails)

    def table(self, relation: int | str) -> torch.Tensor:  # noqa: D102 - inherited
        return self.whole.table(relation)

    def probability(
        self, heads: EntityIds, relations: RelationIds, tails: EntityIds
    ) -> torch.Tensor:
        """Return P(a recipe outside train gives the triple) as :meth:`score`; ConfigError without calibration."""
        if self.probabilities is None:
            raise ConfigError(f"{self.name} has no calibration. Train the model again, with folds.")
        ids = self.entity_ids(heads), self.relation_ids(relations), self.entity_ids(tails)
        return self.probabilities.predict(self._score(*ids), *ids)

    def result_probabilities(self, ingredients: EntityIds, others: EntityIds) -> torch.Tensor:
        """Return pairs' distributions over results, on a new axis E; ConfigError without recipes or calibration."""
        temperature = self.probabilities.temperature if self.probabilities else None
        if temperature is None or not isinstance(self.whole, RecipeScores):
            raise ConfigError(
                f"{self.name} cannot predict results. Use a wordcraft-kg train-recipes model with folds."
            )
        a, b = (self.entity_ids(part)[..., None] for part in (ingredients, others))
        scores = self.whole.score_recipes(
            a, b, torch.arange(len(self.entities), device=self.device)
        )
        return torch.softmax(scores / temperature, dim=-1)

    def left_out(self, fold: int) -> Scorer:
        """Return the scorer trained without the given fold, a number from 0."""
        if fold not in self._made:
            self._made[fold] = self._makers[fold]()
        return self._made[fold]

    def train_sample(self, graph: RecipeGraph) -> TrainSample:
        """Return the training recipes for :attr:`whole`, trained on all folds; GraphMismatchError for another graph."""
        if len(self.of_recipe) != graph.num_recipes:
            raise GraphMismatchError(
                f"{self.name} has folds for {len(self.of_recipe):,} recipes but '{graph.name}' has "
                f"{graph.num_recipes:,}. Train on this graph, or use the training graph."
            )
        if self.train_results is None:
            return TrainSample.of(graph, self.of_recipe != OUTSIDE)
        return TrainSample(graph, self.train_results)

    def trained_on(self, fold: int, graph: RecipeGraph) -> Ids:
        """Return the training triples for the model without a given fold, shape (T, 3).

        Raises LeakError if the fold's model was not trained on the recipes outside the fold.
        """
        recipes = self.train_sample(graph).among(seen_by_models(self.of_recipe)[1 + fold])
        triples = recipe_triples(recipes)
        left_out = self.left_out(fold)
        is_other = isinstance(left_out, RecipeScores) and not np.array_equal(
            left_out.recipes.cpu().numpy(), recipes
        )
        if is_other or triples_hash(triples) != self.record.folds[fold].trained_on:
            raise LeakError(
                f"{self.name} without fold {fold} was not trained on the recipes outside this fold, so the model may "
                "have seen recipes to be scored. Train again."
            )
        return triples

    def check_split(self, split: Split) -> None:
        """Raise GraphMismatchError unless the folds were made from the given split."""
        if len(self.of_recipe) == split.graph.num_recipes:
            folds_hash = Folds(split, self.count, self.record.seed, self.of_recipe).hash
            if (
                folds_hash == self.record.hash
                and ((self.of_recipe != OUTSIDE) == split.is_in("train")).all()
            ):
                return
        raise GraphMismatchError(
            f"the folds of {self.name} do not belong to split {split.hash[:12]} of '{split.graph.name}'. Train on "
            "this split, or use the training split."
        )


def cross_fit(split: Split, make: Callable[[Ids], Scorer], *, folds: int = 5) -> CrossFitted:
    """Train a scorer on a split's train recipes, and one scorer for each left-out fold.

    ``make`` returns a scorer for the split's graph from training recipes, ids (n, 3), without further information.
    ConfigError for fewer than two or too many folds, or a split without test part.

    Example:
        >>> from wordcraft_kg.models.scorers.kernel import KernelScorer
        >>> split = open_graph("kitchen").split
        >>> cross_fit(split, lambda recipes: KernelScorer(split.graph, recipes), folds=3).count
        3
    """
    if split.config.kind == "none":
        raise ConfigError(
            "split kind 'none' has no test recipes, so cross-fitting is not needed. Use another split, such as "
            "by-recipe."
        )
    cut = make_folds(split, folds)
    of_folds = [
        Fold(
            trained_on=triples_hash(triples),
            triples=len(triples),
            queries=0,
            mrr=None,
            in_sample_mrr=None,
        )
        for triples in (cut.triples([fold]) for fold in range(folds))
    ]
    return CrossFitted(
        make(cut.recipes()),
        [partial(make, cut.recipes([fold])) for fold in range(folds)],
        cut.of_recipe.copy(),
        FoldsRecord(seed=cut.seed, hash=cut.hash, folds=tuple(of_folds)),
    )


def whole_of(scorer: TripleScorer) -> TripleScorer:
    """Return the scorer trained on all train recipes; scorers without folds are returned unchanged."""
    folded = folds_of(scorer)
    return scorer if folded is None else folded.whole


def folds_of(scorer: TripleScorer) -> CrossFitted | None:
    """Return the scorer if cross-fitted (a model per left-out fold), otherwise None."""
    return scorer if isinstance(scorer, CrossFitted) else None


def seen_by_models(of_recipe: Ids) -> NDArray[np.bool_]:
    """Return masks of training recipes, (K + 2, num_recipes): all folds, without each fold, and none."""
    train = of_recipe != OUTSIDE
    folds = range(int(of_recipe.max(initial=OUTSIDE)) + 1)
    return np.stack([train, *(train & (of_recipe != fold) for fold in folds), np.zeros_like(train)])


def models_of_tasks(of_recipe: Ids, tasks: TaskSet) -> Ids:
    """Return, for each of N tasks, a model number: a model that has not seen all recipes of any plan; shape (N,).

    A plan lists the recipes that make the task's goal; at depth 1 it has one recipe, which the model has not seen.
    Numbers are rows of :func:`seen_by_models`: 0 if each plan has a recipe outside train, otherwise 1 + the fold from
    :func:`~wordcraft_kg.graphs.folds.fold_of_tasks`, or K + 1 (the empty model) without such a fold. ``of_recipe``
    contains each recipe's fold. LeakError if a model has seen all recipes of a plan, GraphMismatchError if the folds
    belong to another split.
    """
    seen = seen_by_models(of_recipe)
    fold = fold_of_tasks(of_recipe, tasks)
    models = np.select([fold == OUTSIDE, fold == SEVERAL], [0, len(seen) - 1], 1 + fold)
    for task, (model, plans) in enumerate(zip(models.tolist(), tasks.plans, strict=True)):
        for plan in plans:
            if seen[model, list(plan)].all():
                raise LeakError(
                    f"{tasks.part} task {task:,} would be scored by a model trained on all recipes of a plan. Nothing "
                    "was scored."
                )
    return models
