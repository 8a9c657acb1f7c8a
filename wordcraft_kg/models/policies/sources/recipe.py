"""The source w: the score for the best recipe that makes the goal with a slot's entity."""

from collections.abc import Mapping
from itertools import islice

import torch
from torch import Tensor, nn

from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.base.tensors import lazily_zero, with_prefix
from wordcraft_kg.models.policies.sources import W
from wordcraft_kg.models.policies.sources.source import (
    Attempts,
    Evidence,
    FoldedSource,
    ScoreView,
    Source,
    check_constants,
)
from wordcraft_kg.models.scorers.cross_fitting import folds_of, whole_of
from wordcraft_kg.models.scorers.pair_features import BUFFERS, FEATURES, RecipeKnowledge
from wordcraft_kg.models.scorers.protocol import TripleScorer
from wordcraft_kg.models.scorers.recipes import RecipeScorer

_LAYOUTS = {
    "parts": "models N N two float16",
    "pairs": "models N N two float16",
    "numbers": "models N N int32",
    "results": "models known most int32",
    "alike": "models N W float16",
    "words": "N W float16",
    "counts": "models N two float32",
    "supporting": "models N evidence three int16",
    "first": "models F hidden float32",
    "first_bias": "models hidden float32",
    "second": "models hidden float32",
    "bias": "models float32",
}

KEPT, MOST_KEPT = 2**24, 64
"""Largest amounts of scores, and of batches with scores, that a source keeps."""


class BestRecipe(FoldedSource):
    """The source w, ``w_i = S(e_i, e_s -> e_g)``; without selection, ``w_i = max_j S(e_i, e_j -> e_g)``.

    Slot i, selection s and goal g form a recipe; j runs over the table. S is a recipe score in nats, so w needs no
    common scale.

    Attributes:
        knowledge: arrays and networks that compute S; for cross-fitted scorers K + 1 models, on all folds and without
            each fold.
    """

    label = W

    def __init__(
        self, num_entities: int, knowledge: RecipeKnowledge, fold_of_recipe: Tensor | None = None
    ):
        super().__init__(num_entities, fold_of_recipe)
        self.knowledge = knowledge
        self._kept: dict[tuple[object, ...], Tensor] = {}
        self.register_load_state_dict_post_hook(_forget)

    @classmethod
    def of_scorer(cls, scorer: TripleScorer, view: ScoreView) -> "BestRecipe":  # noqa: D102 - inherited
        whole = whole_of(scorer)
        if not isinstance(whole, RecipeScorer):
            raise ConfigError(
                "`use` w needs recipe scores, and this scorer only has link scores. Use a scorer from "
                "`wordcraft-kg train-recipes`, or leave out w."
            )
        size, folded = len(scorer.entities), folds_of(scorer)
        if folded is None:
            return cls(size, RecipeKnowledge(whole.knowledge.constants()).cpu())
        models = [whole]
        of_recipe = cls.fold_numbers(folded, view)
        if view.tasks is not None:
            for fold in range(folded.count):
                folded.trained_on(fold, view.tasks.graph)  # raises LeakError
                left_out = folded.left_out(fold)
                assert isinstance(left_out, RecipeScorer)
                models.append(left_out)
        return cls(
            size, RecipeKnowledge.stacked([model.knowledge for model in models]).cpu(), of_recipe
        ).bound(view)

    @staticmethod
    def serves(scorer: TripleScorer) -> bool:
        """Return whether a scorer has recipe scores, which this source needs."""
        return isinstance(whole_of(scorer), RecipeScorer)

    @classmethod
    def restored(cls, num_entities: int, constants: Mapping[str, Tensor]) -> Source:  # noqa: D102 - inherited
        knowledge = with_prefix(constants, "knowledge.")
        models = (cls.num_folds(constants) or 0) + 1
        check_constants(
            knowledge, _LAYOUTS, N=num_entities + 1, models=models, F=len(FEATURES), two=2, three=3
        )
        empty = {name: lazily_zero(knowledge[name]) for name in BUFFERS}
        of_recipe = constants.get("fold_of_recipe")
        return cls(
            num_entities,
            RecipeKnowledge(empty),
            None if of_recipe is None else lazily_zero(of_recipe),
        )

    @classmethod
    def num_bytes(cls, scorer: TripleScorer) -> int:  # noqa: D102 - inherited
        return 16 * (len(scorer.entities) + 1) ** 2

    def forward(  # noqa: D102 - inherited
        self,
        goal: Tensor,
        selection: Tensor,
        table: Tensor,
        task: Tensor | None = None,
        attempts: Attempts | None = None,
    ) -> Tensor:
        model = self.model_of(task)
        models = len(self.knowledge.bias)
        used = (
            torch.zeros_like(goal) if model is None else model.clamp(max=models - 1)
        )  # the empty model is last
        scores = self._scores(goal, table, used, attempts)
        is_first = selection == self.num_entities
        best = scores.amax(-1)
        if not is_first.all():
            is_selected = (table == selection[:, None]) & ~is_first[:, None]
            place = is_selected.int().argmax(1)[:, None, None].expand(-1, 1, table.shape[1])
            best = best.where(is_first[:, None], scores.gather(1, place)[:, 0])
            is_absent = ~is_first & ~is_selected.any(1)
            if is_absent.any():
                wider = torch.cat([table, selection[:, None]], dim=1)
                best = best.where(
                    ~is_absent[:, None], self.pair_scores(goal, wider, used, attempts)[:, -1, :-1]
                )
        best = best.masked_fill(table == self.num_entities, 0)
        return best if model is None else best.masked_fill((model == models)[:, None], 0)

    def evidence(  # noqa: D102 - inherited
        self,
        goal: Tensor,
        selection: Tensor,
        table: Tensor,
        task: Tensor | None = None,
        attempts: Attempts | None = None,
    ) -> tuple[Evidence | None, ...]:
        models = self.model_of(task)
        model = 0 if models is None else int(models)
        if model == len(self.knowledge.bias):  # the empty model
            return (None,) * table.shape[1]
        if int(selection) == self.num_entities:
            best = self._scores(goal, table, torch.full_like(goal, model), attempts)[0].argmax(1)
            partners = table[0, best].tolist()
        else:
            partners = [int(selection)] * table.shape[1]
        return tuple(
            None
            if entity == self.num_entities
            else Evidence(
                partner,
                tuple(
                    self.knowledge.supporting_recipes(
                        entity, partner, int(goal), model=model, limit=3
                    )
                ),
            )
            for entity, partner in zip(table[0].tolist(), partners, strict=True)
        )

    def knows(self, recipes: Tensor, model: int) -> Tensor:
        """Return a mask of the recipes (n, 3) in a model's training data, shape (n,)."""
        one, other, result = recipes.T
        number = self.knowledge.numbers[model, one, other].long()
        return (number > 0) & (self.knowledge.results[model, number] == result[:, None]).any(1)

    def pair_scores(
        self, goal: Tensor, table: Tensor, model: Tensor, attempts: Attempts | None
    ) -> Tensor:
        """Return scores for all slot pairs, shape (B, A, A), by the models with the numbers ``model``, shape (B,)."""
        return self.knowledge(goal, table, model)

    def _scores(
        self, goal: Tensor, table: Tensor, model: Tensor, attempts: Attempts | None
    ) -> Tensor:
        """Return :meth:`pair_scores`; trailing slots that are empty in all tables are skipped.

        The last scores are kept, because tables recur: before and after the first action, and for another player on
        the same tables. Threads may call concurrently: the dictionary is replaced, never changed.
        """
        slots, is_used = table.shape[1], (table != self.num_entities).any(0).tolist()
        used = max((slot for slot, filled in enumerate(is_used, 1) if filled), default=0)
        inputs = (
            goal,
            table[:, :used],
            model,
            *(part for part in attempts or () if part is not None),
        )
        key = (table.device, slots, used, *(part.cpu().numpy().tobytes() for part in inputs))
        kept = self._kept
        if key in kept:
            return kept[key]
        rest = slots - used
        scores = self.pair_scores(goal, table[:, :used], model, attempts)
        scores = nn.functional.pad(scores, (0, rest, 0, rest), value=-torch.inf)
        most = max(1, KEPT // max(1, scores.numel()))
        self._kept = {key: scores, **dict(islice(kept.items(), min(most, MOST_KEPT) - 1))}
        return scores


def _forget(source: nn.Module, _: object) -> None:
    assert isinstance(source, BestRecipe)
    source._kept = {}
