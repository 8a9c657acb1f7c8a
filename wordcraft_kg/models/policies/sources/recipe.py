"""The source recipe (w): the score for the best recipe that makes the goal with a slot's entity.

:class:`BestRecipe` scores pairs, :class:`BestSet` recipes of any number of ingredients by a scorer
of whole sets.
"""

from collections.abc import Iterable, Mapping, Sequence
from functools import lru_cache
from typing import NamedTuple, Self, cast

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.base.tensors import with_prefix
from wordcraft_kg.graphs import MOST_INGREDIENTS, Ids, padded
from wordcraft_kg.models.policies.sources import W
from wordcraft_kg.models.policies.sources.source import (
    Evidence,
    FoldedSource,
    Rows,
    ScoreView,
    knowledge_of_models,
    models_of,
)
from wordcraft_kg.models.policies.states import States
from wordcraft_kg.models.scorers.cross_fitting import whole_of
from wordcraft_kg.models.scorers.neighbours.knowledge import RecipeKnowledge
from wordcraft_kg.models.scorers.protocol import TripleScorer
from wordcraft_kg.models.scorers.recipes import RecipeScorer
from wordcraft_kg.models.scorers.sets.scorer import SetScorer

LEAST = -30.0
"""Least score of a set, nats."""
_BEAM = 16
"""Sets of each size that are extended by every entity on the table."""
_MOST_SETS = 256
"""Most sets of a table that are kept; others count by their score alone."""
_MOST_TABLES = 8_192
_Scores = NDArray[np.float32]


class ScoredSets(NamedTuple):
    """Sets of entities on a table, best first.

    Attributes:
        sets: shape (n, 8), ids in ascending order, -1 behind the last.
        scores: shape (n,), nats.
    """

    sets: Ids
    scores: _Scores

    def best(self) -> "ScoredSets":
        """Return the best sets, best first; of equal scores, the first ones come first."""
        order = np.argsort(-self.scores, kind="stable")[:_MOST_SETS]
        return ScoredSets(self.sets[order], self.scores[order])


def rows_of(sets: Sequence[Sequence[int]]) -> Ids:
    """Return sets of ids as rows of a scorer, shape (n, 8)."""
    return padded(sets, -1, MOST_INGREDIENTS)


def likely_sets(scorer: SetScorer, goal: int, entities: Iterable[int], sizes: range) -> ScoredSets:
    """Return sets of entities with their scores for a goal: they grow one by one, in a beam.

    Args:
        scorer: scores the sets.
        goal: id.
        entities: ids, each of which may be taken several times.
        sizes: numbers of entities.
    """
    # Sorted, so that equal scores are decided alike in every process.
    beam: list[tuple[int, ...]] = [()]
    results = []
    for size in range(1, sizes.stop):
        extended = {tuple(sorted((*parts, entity))) for parts in beam for entity in entities}
        candidates = sorted(extended)
        sets = rows_of(candidates)
        scores = scorer.score_sets(sets, np.full(len(sets), goal))
        order = np.argsort(-scores, kind="stable")[:_BEAM]
        beam = [candidates[row] for row in order.tolist()]
        if size in sizes:
            results.append(ScoredSets(sets, scores))
    return ScoredSets(*map(np.concatenate, zip(*results, strict=True))).best()


class BestSet(FoldedSource):
    """The source recipe (w) of a scorer of sets: the best set that completes the selection.

    ``w_i = max_R S(R -> e_g)`` over sets R of entities on the table that contain the selection and
    slot i, S the log probability that a recipe of the goal has exactly these ingredients. The
    action to combine has the score of the selection as it is. In a book of pairs, R is a pair.

    Attributes:
        models: scorers; for cross-fitted scorers K + 1, on all folds and without each fold.
    """

    label = W
    takes_sets = True
    scores_combine = True

    def __init__(
        self,
        num_entities: int,
        models: Sequence[SetScorer],
        fold_of_recipe: Tensor | None = None,
    ):
        """Take one model or more, and each recipe's fold if there are folds."""
        super().__init__(num_entities, fold_of_recipe, len(models))
        self.models = tuple(models)
        self._sets = lru_cache(_MOST_TABLES)(self.sets_of_table)
        for number, model in enumerate(models):
            for name, tensor in model.tensors().items():
                if number == 0 or name not in SetScorer.shared:
                    self.register_buffer(_buffer_name(number, name), tensor)

    @classmethod
    def of_scorer(cls, scorer: TripleScorer, view: ScoreView) -> Self:  # noqa: D102 - inherited
        models = [cast("SetScorer", model) for model, _ in models_of(scorer, view)]
        return cls(len(scorer.entities), models, cls.fold_numbers(scorer, view))

    @classmethod
    def restored(  # noqa: D102 - inherited
        cls, num_entities: int, constants: Mapping[str, Tensor]
    ) -> Self:
        labels = [str(entity) for entity in range(num_entities)]
        models: list[SetScorer] = []
        for number in range(cls.num_stored(constants)):
            stored = with_prefix(constants, _buffer_name(number, ""))
            tensors = {name.replace("-", "."): tensor for name, tensor in stored.items()}
            if models:
                first = models[0].tensors()
                tensors |= {name: first[name] for name in SetScorer.shared}
            SetScorer.check(tensors, num_entities)
            models.append(SetScorer(tensors, labels, ""))
        return cls(num_entities, models, constants.get("fold_of_recipe"))

    @staticmethod
    def is_stored(constants: Mapping[str, Tensor]) -> bool:
        """Return whether buffers are those of this source."""
        return _buffer_name(0, "recipes") in constants

    def forward(self, states: States) -> Tensor:  # noqa: D102 - inherited
        model, counts = self.counted_models(states)
        inputs = [states.goal, states.selection.sort(-1).values, states.table, model]
        inputs += self.attempts(states)

        def compute(rows: Rows) -> Tensor:
            part = states.of(rows)
            scores = np.zeros(part.table.shape, dtype=np.float32)
            for row, number in enumerate(model[rows].tolist()):
                scores[row] = self._scores_of_state(part.of(slice(row, row + 1)), number)
            return torch.from_numpy(scores).to(states.table.device)

        scores = self.kept.scores(inputs, compute, states.table.shape[1:])
        return scores.masked_fill(~states.slot_mask(self.num_entities) | ~counts[:, None], 0)

    def attempts(self, states: States) -> list[Tensor]:
        """Return what scores depend on besides goal, selection, table and model: here nothing."""
        return []

    def sets_of_table(
        self,
        model: int,
        goal: int,
        entities: tuple[int, ...],
        sizes: range,
        attempts: tuple[int, ...],
    ) -> ScoredSets:
        """Return the best sets of a table.

        Args:
            model: number of the model.
            goal: id.
            entities: ids on the table, ascending.
            sizes: numbers of ingredients.
            attempts: the numbers in :meth:`attempts`.
        """
        return likely_sets(self.models[model], goal, entities, sizes)

    def other_scores(self, model: int, goal: int, sets: Ids) -> _Scores:
        """Return the scores of sets that are not among the best of the table.

        Args:
            model: number of the model, see :attr:`models`.
            goal: id of the goal.
            sets: ids of the sets, shape (n, 8), padded.
        """
        return self.models[model].score_sets(sets, np.full(len(sets), goal))

    def _scores_of_state(self, states: States, model: int) -> _Scores:
        """Return the scores of a single state's slots, shape (A,)."""
        nothing = self.num_entities
        goal = int(states.goal)
        table = states.table[0].cpu().numpy()
        selection = [entity for entity in states.selection.flatten().tolist() if entity != nothing]
        entities = sorted({*table.tolist(), *selection} - {nothing})
        # Without the action to combine, recipes are pairs.
        sizes = range(2, 3)
        if states.has_combine:
            sizes = range(1, states.selection.shape[1] + 1)
        attempts = [number for part in self.attempts(states) for number in part.flatten().tolist()]
        sets, set_scores = self._sets(model, goal, tuple(entities), sizes, tuple(attempts))
        # How often each entity is in a set, and has to be, (n, C) and (C,).
        columns = np.array(entities)
        counts = (sets[:, :, None] == columns).sum(1)
        required = (np.array(selection)[:, None] == columns).sum(0)
        contains = (counts >= required).all(1)
        is_with_entity = contains[:, None] & (counts > required)
        best = np.where(is_with_entity, set_scores[:, None], -np.inf).max(0, initial=-np.inf)
        # Without a set that contains an entity and the selection, the two are a set.
        missing = np.flatnonzero(best == -np.inf).tolist()
        extended = [sorted((*selection, entities[column])) for column in missing]
        best[missing] = self.other_scores(model, goal, rows_of(extended))
        scores = np.zeros(len(table), dtype=np.float32)
        is_filled = table != nothing
        scores[is_filled] = best[np.searchsorted(columns, table[is_filled])]
        if states.has_combine and selection:
            combined = set_scores[contains & (counts == required).all(1)]
            if not len(combined):
                combined = self.other_scores(model, goal, rows_of([sorted(selection)]))
            scores[-1] = combined[0]
        return np.maximum(scores, LEAST)


def _buffer_name(model: int, name: str) -> str:
    """Return the name of a model's tensor; names of buffers have no dots."""
    return f"model{model}_{name.replace('.', '-')}"


SUPPORTING = 3
"""Most recipes that support the score of a slot."""


class BestRecipe(FoldedSource):
    """The source recipe (w), the score of a slot's best recipe for the goal.

    ``w_i = S(e_i, e_s -> e_g)``; without selection, ``w_i = max_j S(e_i, e_j -> e_g)``.

    Slot i, selection s and goal g form a recipe; j runs over the table, i included. S is a recipe
    score in nats, so w needs no common scale. A triple only says that two entities combine, or that
    one is part of another; a recipe says that these two make the goal.

    Attributes:
        knowledge: arrays and networks that compute S; for cross-fitted scorers K + 1 models, on all
            folds and without each fold.
    """

    label = W

    def __init__(
        self,
        num_entities: int,
        knowledge: RecipeKnowledge,
        fold_of_recipe: Tensor | None = None,
    ):
        """Take the knowledge of one model or more, and each recipe's fold if there are folds."""
        super().__init__(num_entities, fold_of_recipe, knowledge.num_models)
        self.knowledge = knowledge

    @classmethod
    def of_scorer(  # noqa: D102 - inherited
        cls, scorer: TripleScorer, view: ScoreView
    ) -> FoldedSource:
        main_model = whole_of(scorer)
        if isinstance(main_model, SetScorer):
            return BestSet.of_scorer(scorer, view)
        if not isinstance(main_model, RecipeScorer):
            raise ConfigError(
                "`use` recipe (w) needs recipe scores, and this scorer only has link scores. Use a "
                "scorer from `wordcraft-kg train-recipes`, or leave out recipe."
            )
        size = len(scorer.entities)
        fold_numbers = cls.fold_numbers(scorer, view)
        return cls(size, knowledge_of_models(scorer, view), fold_numbers)

    @classmethod
    def restored(  # noqa: D102 - inherited
        cls, num_entities: int, constants: Mapping[str, Tensor]
    ) -> FoldedSource:
        if BestSet.is_stored(constants):
            return BestSet.restored(num_entities, constants)
        tensors = with_prefix(constants, "knowledge.")
        knowledge = RecipeKnowledge(tensors, num_entities, cls.num_stored(constants))
        return cls(num_entities, knowledge, constants.get("fold_of_recipe"))

    def scores_of_pairs(self, states: States) -> Tensor:  # noqa: D102 - inherited
        models, counts = self.counted_models(states)
        return self._kept_pair_scores(states, models).masked_fill(~counts[:, None, None], 0)

    def forward(self, states: States) -> Tensor:  # noqa: D102 - inherited
        slots = states.table.shape[1]
        nothing = self.num_entities
        # A caller may select an entity that is not on the table.
        states = states.with_selections_on_table(nothing)
        table = states.table
        models, counts = self.counted_models(states)
        scores = self._kept_pair_scores(states, models)
        # First action: the best partner on the table.
        best = scores.amax(-1)
        is_first = states.selection[:, None] == nothing
        if not is_first.all():
            # Second action: the row of the selection, wherever it lies on the table.
            is_selected = (table == states.selection[:, None]) & ~is_first
            place = is_selected.int().argmax(1)[:, None, None].expand(-1, 1, table.shape[1])
            best = best.where(is_first, scores.gather(1, place)[:, 0])
        return best.masked_fill((table == nothing) | ~counts[:, None], 0)[:, :slots]

    def evidence(self, states: States) -> tuple[Evidence | None, ...]:  # noqa: D102 - inherited
        goal, selection, table, *_ = states
        model = int(self.model_of(states))
        if model == self.num_models:  # the empty model
            return (None,) * table.shape[1]
        if int(selection) == self.num_entities:
            scores = self._kept_pair_scores(states, torch.full_like(goal, model))
            partners = table[0, scores[0].argmax(1)].tolist()
        else:
            partners = [int(selection)] * table.shape[1]
        evidence: list[Evidence | None] = []
        for entity, partner in zip(table[0].tolist(), partners, strict=True):
            if entity == self.num_entities:
                evidence.append(None)
                continue
            supporting = self.knowledge.supporting_recipes(
                entity, partner, int(goal), model=model, limit=SUPPORTING
            )
            evidence.append(Evidence(partner, tuple(supporting)))
        return tuple(evidence)

    def pair_scores(self, states: States, model: Tensor) -> Tensor:
        """Return scores for all slot pairs, shape (B, A, A), by models ``model``, shape (B,)."""
        return self.knowledge(states.goal, states.table, model)

    def _kept_pair_scores(self, states: States, model: Tensor) -> Tensor:
        """Return :meth:`pair_scores`; trailing slots that are empty in all tables are skipped."""
        table = states.table
        slots = table.shape[1]
        num_filled = states.num_used_slots(self.num_entities)
        narrow = states._replace(table=table[:, :num_filled])
        # Everything that scores depend on. The selection is not among it.
        inputs = [states.goal, narrow.table, model]
        inputs += [part for part in states.attempts or () if part is not None]

        def compute(rows: Rows) -> Tensor:
            return self.pair_scores(narrow.of(rows), model[rows])

        scores = self.kept.scores(inputs, compute, (num_filled, num_filled))
        num_empty = slots - num_filled
        # -inf, so that an empty slot is never the best partner.
        return nn.functional.pad(scores, (0, num_empty, 0, num_empty), value=-torch.inf)
