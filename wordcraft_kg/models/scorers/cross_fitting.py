"""Cross-fitting: scores for train recipes by models trained without these recipes.

A scorer answers queries about its training recipes from memory, so agents that learn from these
scores trust the scorer more than it deserves on test recipes. The train recipes are cut into folds
(:mod:`wordcraft_kg.graphs.train_samples`); for each fold there is a model trained on the remaining
folds. A fold's model is to the fold's recipes what the main model is to the test recipes.

:func:`models_of_tasks` is the only place that assigns models to tasks, and refuses leaks.

The page docs/explanation/cross-fitting.md explains why, and shows what it costs to leave it out.

Source: Wolpert 1992 (stacking); Breiman 1996; van der Laan, Polley and Hubbard 2007; Chernozhukov
et al. 2018.
"""

from collections.abc import Callable, Sequence
from functools import cache, partial
from typing import Literal

import msgspec
import numpy as np
import torch
from numpy.typing import NDArray

from wordcraft_kg.base import ConfigError, Count, GraphMismatchError, Hash, LeakError, Record, Share
from wordcraft_kg.graphs import (
    OUTSIDE,
    Folds,
    Ids,
    RecipeGraph,
    Split,
    TaskSet,
    TrainSample,
    fold_of_tasks,
    frozen,
    make_folds,
    recipe_triples,
    triples_hash,
)
from wordcraft_kg.graphs.train_samples import SEVERAL
from wordcraft_kg.models.scorers.probabilities import Probabilities
from wordcraft_kg.models.scorers.protocol import FactoredScorer, TripleScorer
from wordcraft_kg.models.scorers.recipes import RecipeScorer
from wordcraft_kg.models.scorers.scorer import EntityIds, RelationIds, Scorer


class Fold(Record, frozen=True, kw_only=True):
    """A model trained without one fold, and its metrics on that fold.

    Attributes:
        trained_on: hash of the model's training triples, see
            :func:`~wordcraft_kg.graphs.triples.triples_hash`.
        triples: number of the model's training triples.
        queries: number of ranking queries (two for each triple) for the fold's triples that the
            model has not seen; all of them, or a sample on large graphs.
        mrr: the model's filtered MRR on these queries, out of sample; None without queries.
        in_sample_mrr: filtered MRR on the same queries by the model trained on all folds, which has
            seen the triples; None without queries.
    """

    trained_on: Hash
    triples: Count
    queries: Count
    mrr: Share | None
    in_sample_mrr: Share | None


class FoldsRecord(Record, frozen=True, kw_only=True):
    """The file ``folds.json``: how the folds were drawn, and the model trained without each fold.

    Attributes:
        format: name and version of the file format.
        seed: seed of the draw.
        hash: hash of split and folds, see :attr:`wordcraft_kg.graphs.train_samples.Folds.hash`.
        folds: a record for each fold, in the folds' order.
    """

    format: Literal["wordcraft-kg folds 1"] = "wordcraft-kg folds 1"
    seed: Count
    hash: Hash
    folds: tuple[Fold, ...]

    @classmethod
    def unranked(cls, folds: Folds) -> "FoldsRecord":
        """Return the record of models without each fold whose links nobody has ranked."""
        triples_of_models = [folds.triples([fold]) for fold in range(folds.count)]
        records = [
            Fold(
                trained_on=triples_hash(triples),
                triples=len(triples),
                queries=0,
                mrr=None,
                in_sample_mrr=None,
            )
            for triples in triples_of_models
        ]
        return cls(seed=folds.seed, hash=folds.hash, folds=tuple(records))

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
        """Mean reciprocal rank on train triples by models trained without the triple's fold.

        None without queries. The value is no forecast of the test MRR.
        """
        return self._mean([fold.mrr for fold in self.folds])

    @property
    def in_sample_mrr(self) -> float | None:
        """Mean reciprocal rank on the triples of :attr:`mrr` by the model trained on all folds.

        None without queries.
        """
        return self._mean([fold.in_sample_mrr for fold in self.folds])

    def _mean(self, values: Sequence[float | None]) -> float | None:
        # Folds count by their queries, so the mean is over queries, not over folds.
        sums = [
            value * fold.queries
            for value, fold in zip(values, self.folds, strict=True)
            if value is not None
        ]
        return sum(sums) / self.queries if sums else None


class CrossFitted(Scorer):
    """A scorer trained on all train recipes, with K fold scorers, each trained without one fold.

    Scores and tables come from :attr:`whole`; if it is a recipe scorer, so do ``score_recipes``,
    ``supporting_recipes`` and ``recipes``. Agents that learn on train tasks need :meth:`left_out`;
    :func:`~wordcraft_kg.models.policies.sources.registry.make_sources` chooses the fold to leave
    out.

    Attributes:
        whole: the scorer trained on all folds.
        record: fold seed, hash and metrics.
        of_recipe: each recipe's fold, shape (num_recipes,), int64, read-only;
            :data:`~wordcraft_kg.graphs.train_samples.OUTSIDE` for recipes outside train.
        probabilities: maps scores to probabilities; None before a model folder is written, or if
            the folder has none.
        train_results: training results if some recipes were left out or made wrong, see
            :class:`~wordcraft_kg.graphs.train_samples.TrainSample`; None for unchanged train
            recipes.
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
        """Join the main scorer and its fold scorers, which are made when they are first needed.

        Args:
            whole: the scorer trained on all folds.
            folds: a function for each fold that returns the scorer trained without this fold.
            of_recipe: each recipe's fold, shape (num_recipes,).
            record: fold seed, hash and metrics.
            probabilities: calibration of the scores; None without.
            train_results: results used in training, shape (num_recipes,); None for unchanged train
                recipes.
        """
        super().__init__(whole.entities, whole.graph_hash, whole.device, whole.name)
        self.whole = whole
        self.record = record
        self.probabilities = probabilities
        self.of_recipe = frozen(np.asarray(of_recipe, dtype=np.int64))
        self.train_results = (
            None if train_results is None else frozen(np.asarray(train_results, dtype=np.int64))
        )
        self._makers = [cache(make) for make in folds]
        # Runtime protocols look for attributes, so this scorer has the main scorer's further
        # methods as its own exactly if the main scorer has them.
        if isinstance(whole, FactoredScorer):
            self.factors = whole.factors
        if isinstance(whole, RecipeScorer):
            self.recipes = whole.recipes
            self.score_recipes = whole.score_recipes
            self.supporting_recipes = whole.supporting_recipes

    @property
    def count(self) -> int:
        """Number of folds."""
        return len(self._makers)

    def _score(
        self,
        heads: torch.Tensor,
        relations: torch.Tensor,
        tails: torch.Tensor,
    ) -> torch.Tensor:
        return self.whole._score(heads, relations, tails)

    def table(self, relation: int | str) -> torch.Tensor:  # noqa: D102 - inherited
        return self.whole.table(relation)

    def probability(
        self,
        heads: EntityIds,
        relations: RelationIds,
        tails: EntityIds,
    ) -> torch.Tensor:
        """Return calibrated probabilities for triples outside the training data.

        The model has memorised its training triples, so their probabilities mean nothing.

        Args:
            heads: one entity, a sequence, or an array or tensor of ids of any shape.
            relations: one relation, or a tensor of ids.
            tails: as ``heads``; the three arguments broadcast against each other.

        Returns:
            float32, with the broadcast shape: the probability that a recipe outside train gives the
            triple, see :mod:`~wordcraft_kg.models.scorers.probabilities`.

        Raises:
            ConfigError: if the model has no calibration.
            UnknownEntityError: for a label or id that the scorer does not know.
        """
        if self.probabilities is None:
            raise ConfigError(f"{self.name} has no calibration. Train the model again, with folds.")
        ids = self.entity_ids(heads), self.relation_ids(relations), self.entity_ids(tails)
        return self.probabilities.predict(self._score(*ids), *ids)

    def result_probabilities(self, ingredients: EntityIds, others: EntityIds) -> torch.Tensor:
        """Return distributions over results for ingredient pairs, given that they make something.

        Args:
            ingredients: one entity, a sequence, or an array or tensor of ids of any shape.
            others: the second ingredients; both arguments broadcast against each other.

        Returns:
            float32, shape (..., E): the broadcast shape and an axis for the E results, which sums
            to 1; where results are proposed, to the share of pairs whose result is among them.

        Raises:
            ConfigError: if the model scores no recipes or has no calibration.
            UnknownEntityError: for a label or id that the scorer does not know.
        """
        probabilities = self.probabilities
        if (
            probabilities is None
            or probabilities.temperature is None
            or not isinstance(self.whole, RecipeScorer)
        ):
            raise ConfigError(
                f"{self.name} cannot predict results. Use a wordcraft-kg train-recipes model with "
                "folds."
            )
        pairs = self.entity_ids(ingredients), self.entity_ids(others)
        a, b = torch.broadcast_tensors(*pairs)
        ids, scores = self.whole.candidate_results(a.reshape(-1), b.reshape(-1))
        candidate_probabilities = torch.softmax(scores / probabilities.temperature, dim=-1)
        size = len(self.entities)
        # The id E, of missing candidates, has a column of its own, which is dropped.
        every = torch.zeros(len(ids), size + 1, device=ids.device)
        every.scatter_(1, ids, candidate_probabilities)
        # Of held-out pairs, this share has its result among the candidates.
        covered = probabilities.covered
        share = 1.0 if covered is msgspec.UNSET else covered
        return (share * every[:, :size]).view(*a.shape, size)

    def left_out(self, fold: int) -> Scorer:
        """Return the scorer trained without a fold, a number from 0; made at the first call.

        Raises:
            IndexError: for a number above those of the folds.
        """
        return self._makers[fold]()

    def train_sample(self, graph: RecipeGraph) -> TrainSample:
        """Return the training recipes of :attr:`whole`.

        Raises:
            GraphMismatchError: if ``graph`` has another number of recipes than the training graph.
        """
        if len(self.of_recipe) != graph.num_recipes:
            raise GraphMismatchError(
                f"{self.name} has folds for {len(self.of_recipe):,} recipes but '{graph.name}' has "
                f"{graph.num_recipes:,}. Train on this graph, or use the training graph."
            )
        # Recipes with wrong results have other triples than the graph's recipes.
        if self.train_results is None:
            return TrainSample.of(graph, self.of_recipe != OUTSIDE)
        return TrainSample(graph, self.train_results)

    def trained_on(self, fold: int, graph: RecipeGraph) -> Ids:
        """Return the training triples of the model without a fold, ids of shape (T, 3).

        Raises:
            LeakError: if the fold's model was trained on other triples than those of the recipes
                outside the fold; its scores for the fold may then come from memory.
            GraphMismatchError: if ``graph`` has another number of recipes than the training graph.
        """
        # Row 0 of the masks belongs to the main model.
        recipes = self.train_sample(graph).among(seen_by_models(self.of_recipe)[1 + fold])
        triples = recipe_triples(recipes, graph.num_entities)
        left_out = self.left_out(fold)
        # A recipe scorer also stores its training recipes; different recipes can give equal
        # triples.
        has_other_recipes = isinstance(left_out, RecipeScorer) and not np.array_equal(
            left_out.recipes.cpu().numpy(), recipes
        )
        if has_other_recipes or triples_hash(triples) != self.record.folds[fold].trained_on:
            raise LeakError(
                f"{self.name} without fold {fold} was not trained on the recipes outside this "
                "fold, so the model may have seen recipes to be scored. Train again."
            )
        return triples

    def check_split(self, split: Split) -> None:
        """Check that the folds were made from the given split.

        Raises:
            GraphMismatchError: if they were not.
        """
        if len(self.of_recipe) == split.graph.num_recipes:
            folds_hash = Folds(split, self.count, self.record.seed, self.of_recipe).hash
            # The hash proves that the folds are those of the record; they must also cover the train
            # recipes exactly.
            has_same_train = np.array_equal(self.of_recipe != OUTSIDE, split.is_in("train"))
            if folds_hash == self.record.hash and has_same_train:
                return
        raise GraphMismatchError(
            f"the folds of {self.name} do not belong to split {split.hash[:12]} of "
            f"'{split.graph.name}'. Train on this split, or use the training split."
        )


def cross_fit(split: Split, make: Callable[[Ids], Scorer], *, folds: int = 5) -> CrossFitted:
    """Train a scorer on a split's train recipes, and one scorer for each left-out fold.

    Args:
        split: split whose train recipes are used.
        make: returns a scorer for the split's graph from training recipes, ids of shape (n, 3),
            without further information about the recipes.
        folds: number of folds.

    Returns:
        a scorer without calibration and without metrics of the folds, which
        :func:`~wordcraft_kg.models.model_folder.save_scorer` computes. The fold scorers are made on
        demand.

    Raises:
        ConfigError: for fewer than two folds, more folds than groups of recipes, or a split without
            test part.

    Example:
        >>> from wordcraft_kg.models.scorers.baselines import KernelScorer
        >>> split = open_graph("kitchen").split
        >>> cross_fit(split, lambda recipes: KernelScorer(split.graph, recipes), folds=3).count
        3
    """
    if split.config.kind == "none":
        raise ConfigError(
            "split kind 'none' has no test recipes, so cross-fitting is not needed. Use another "
            "split, such as by-recipe."
        )
    # The same folds as in trainings of link predictors, whose models can then be compared.
    cut = make_folds(split, folds)
    return CrossFitted(
        make(cut.recipes()),
        [partial(make, cut.recipes([fold])) for fold in range(folds)],
        cut.of_recipe.copy(),
        FoldsRecord.unranked(cut),
    )


def whole_of(scorer: TripleScorer) -> TripleScorer:
    """Return the scorer trained on all train recipes: ``scorer`` itself if it has no folds."""
    folded = folds_of(scorer)
    return scorer if folded is None else folded.whole


def folds_of(scorer: TripleScorer) -> CrossFitted | None:
    """Return the scorer with a model for each left-out fold; None if there are none."""
    return scorer if isinstance(scorer, CrossFitted) else getattr(scorer, "cross_fitted", None)


def seen_by_models(of_recipe: Ids) -> NDArray[np.bool_]:
    """Return which model was trained on which recipe, from each recipe's fold (num_recipes,).

    Returns:
        shape (K + 2, num_recipes): the main model (all folds), the model without each of the K
        folds, and an empty model that has seen no recipe.
    """
    train = of_recipe != OUTSIDE
    count = int(of_recipe.max(initial=OUTSIDE)) + 1
    without_each = [train & (of_recipe != fold) for fold in range(count)]
    return np.stack([train, *without_each, np.zeros_like(train)])


def models_of_tasks(of_recipe: Ids, tasks: TaskSet) -> Ids:
    """Return, for each of N tasks, a model that has not seen all recipes of any plan.

    A plan lists the recipes that make the task's goal; at depth 1 it is one recipe, which the model
    has not seen.

    Args:
        of_recipe: each recipe's fold, shape (num_recipes,).
        tasks: N tasks with their plans.

    Returns:
        shape (N,), int64: rows of :func:`seen_by_models`. 0, the main model, if each plan has a
        recipe outside train; otherwise 1 + the fold from
        :func:`~wordcraft_kg.graphs.train_samples.fold_of_tasks`; or K + 1, the empty model, if no
        single fold has a recipe of each plan.

    Raises:
        LeakError: if a model has seen all recipes of a plan.
        GraphMismatchError: if the folds belong to another split.
    """
    is_trained_on = seen_by_models(of_recipe)
    empty = len(is_trained_on) - 1
    fold = fold_of_tasks(of_recipe, tasks)
    models = np.select([fold == OUTSIDE, fold == SEVERAL], [0, empty], 1 + fold)
    # Checked again for each plan, independently of the rule above: a leak would be invisible later.
    for task, plans in enumerate(tasks.plans):
        seen_by_model = is_trained_on[models[task]]
        for plan in plans:
            if seen_by_model[list(plan)].all():
                raise LeakError(
                    f"{tasks.part} task {task:,} would be scored by a model trained on all "
                    "recipes of a plan. Nothing was scored."
                )
    return models
