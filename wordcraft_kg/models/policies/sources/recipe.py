"""The source recipe (w): the score for the best recipe that makes the goal with a slot's entity."""

from collections.abc import Mapping

import torch
from torch import Tensor, nn

from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.base.tensors import with_prefix
from wordcraft_kg.models.policies.sources import W
from wordcraft_kg.models.policies.sources.sets import BestSet
from wordcraft_kg.models.policies.sources.source import (
    Evidence,
    FoldedSource,
    KeptScores,
    Rows,
    ScoreView,
    knowledge_of_models,
)
from wordcraft_kg.models.policies.states import States
from wordcraft_kg.models.scorers.cross_fitting import whole_of
from wordcraft_kg.models.scorers.neighbours.knowledge import RecipeKnowledge
from wordcraft_kg.models.scorers.protocol import TripleScorer
from wordcraft_kg.models.scorers.recipes import RecipeScorer
from wordcraft_kg.models.scorers.sets.scorer import SetScorer

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
        super().__init__(num_entities, fold_of_recipe)
        self.knowledge = knowledge
        self.kept = KeptScores()
        # Other weights give other scores.
        self.register_load_state_dict_post_hook(self.kept.forget)

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
        return cls(size, knowledge_of_models(scorer, view), fold_numbers).bound(view)

    @staticmethod
    def serves(scorer: TripleScorer) -> bool:
        """Return whether a scorer has recipe scores, which this source needs."""
        return isinstance(whole_of(scorer), RecipeScorer | SetScorer)

    @classmethod
    def restored(  # noqa: D102 - inherited
        cls, num_entities: int, constants: Mapping[str, Tensor]
    ) -> FoldedSource:
        if BestSet.is_stored(constants):
            return BestSet.restored(num_entities, constants)
        models = (cls.num_folds(constants) or 0) + 1
        knowledge = RecipeKnowledge(with_prefix(constants, "knowledge."), num_entities, models)
        return cls(num_entities, knowledge, constants.get("fold_of_recipe"))

    @classmethod
    def num_bytes(cls, scorer: TripleScorer) -> int:  # noqa: D102 - inherited
        return 0  # no table of pairs

    def _models(self, states: States) -> tuple[Tensor, Tensor]:
        """Return the model that scores each state, and whether its scores count, (B,) each."""
        model = self.model_of(states.task)
        if model is None:
            model = torch.zeros_like(states.goal)
        # The empty model of tasks without an out-of-sample model has the last number, and no
        # arrays: another model computes its scores, which do not count.
        num_models = self.knowledge.num_models
        return model.clamp(max=num_models - 1), model < num_models

    def scores_of_pairs(self, states: States) -> Tensor:  # noqa: D102 - inherited
        models, counts = self._models(states)
        return self._kept_pair_scores(states, models).masked_fill(~counts[:, None, None], 0)

    def forward(self, states: States) -> Tensor:  # noqa: D102 - inherited
        selection, table = states.selection, states.table
        nothing = self.num_entities
        models, counts = self._models(states)
        scores = self._kept_pair_scores(states, models)
        is_first = selection == nothing
        # First action: the best partner on the table.
        best = scores.amax(-1)
        if not is_first.all():
            # Second action: the row of the selection, wherever it lies on the table.
            is_selected = (table == selection[:, None]) & ~is_first[:, None]
            place = is_selected.int().argmax(1)[:, None, None].expand(-1, 1, table.shape[1])
            best = best.where(is_first[:, None], scores.gather(1, place)[:, 0])
            is_absent = ~is_first & ~is_selected.any(1)
            if is_absent.any():
                # A caller may select an entity that is not on the table: it gets a slot at the end.
                wider = states._replace(table=torch.cat([table, selection[:, None]], dim=1))
                with_absent = self.pair_scores(wider, models)[:, -1, :-1]
                best = best.where(~is_absent[:, None], with_absent)
        return best.masked_fill((table == nothing) | ~counts[:, None], 0)

    def evidence(self, states: States) -> tuple[Evidence | None, ...]:  # noqa: D102 - inherited
        goal, selection, table, task, _ = states
        models = self.model_of(task)
        model = 0 if models is None else int(models)
        if model == self.knowledge.num_models:  # the empty model
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

    def knows(self, recipes: Tensor, model: int) -> Tensor:
        """Return a mask of the recipes (n, 3) in a model's training data, shape (n,).

        A model may know fewer recipes than its folds say, if it was trained on a sample of them.
        """
        return self.knowledge.knows(recipes, model)

    def pair_scores(self, states: States, model: Tensor) -> Tensor:
        """Return scores for all slot pairs, shape (B, A, A), by models ``model``, shape (B,)."""
        return self.knowledge(states.goal, states.table, model)

    def _kept_pair_scores(self, states: States, model: Tensor) -> Tensor:
        """Return :meth:`pair_scores`; trailing slots that are empty in all tables are skipped."""
        table = states.table
        slots = table.shape[1]
        # Free slots for results are a large share of a table, and the cost of pairs is quadratic.
        filled = (table != self.num_entities).any(0).nonzero()
        num_filled = int(filled[-1]) + 1 if len(filled) else 0
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
