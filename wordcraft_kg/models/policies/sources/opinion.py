"""w of opinions: whether a slot is part of a pair that is thought to make the goal."""

from collections.abc import Mapping
from typing import Self

import torch
from torch import Tensor

from wordcraft_kg.base.tensors import lazily_zero
from wordcraft_kg.models.policies.sources import Label
from wordcraft_kg.models.policies.sources.source import ScoreView, Source
from wordcraft_kg.models.scorers.opinions import OpinionScorer, opinion_keys, weights_of, with_end
from wordcraft_kg.models.scorers.protocol import TripleScorer


class BestOpinion(Source):
    """``w_i = S(e_i, e_s -> e_g)``; while nothing is held, ``w_i = max_j S(e_i, e_j -> e_g)`` over the table.

    S is the weight of the opinion that the pair makes the goal, 0 without one. Opinions rest on no recipe of the graph,
    so there is nothing to keep from a task.

    Attributes:
        keys: buffer, shape (n + 1,), see :func:`~wordcraft_kg.models.scorers.opinions.opinion_keys`.
        weights: buffer, shape (n + 1,).
    """

    label = Label("w", "w", "makes the goal with its best partner")

    keys: Tensor
    weights: Tensor

    def __init__(self, num_entities: int, keys: Tensor, weights: Tensor):
        """Take keys and weights of opinions; the last ones are those of none."""
        super().__init__(num_entities)
        self.register_buffer("keys", keys)
        self.register_buffer("weights", weights)

    @classmethod
    def of_scorer(cls, scorer: TripleScorer, view: ScoreView) -> "BestOpinion":  # noqa: D102 - inherited
        assert isinstance(scorer, OpinionScorer)
        size = len(scorer.entities)
        keys = with_end(opinion_keys(scorer.opinions.cpu().long(), size))
        return cls(size, keys, torch.cat([scorer.weights.cpu(), torch.zeros(1)]))

    @classmethod
    def restored(cls, num_entities: int, constants: Mapping[str, Tensor]) -> Self:  # noqa: D102 - inherited
        return cls(num_entities, lazily_zero(constants["keys"]), lazily_zero(constants["weights"]))

    def forward(self, goal: Tensor, selection: Tensor, table: Tensor, task: Tensor | None = None) -> Tensor:  # noqa: D102 - inherited
        with_held = self._scores(table, selection[:, None], goal[:, None])
        of_pairs = self._scores(table[:, :, None], table[:, None, :], goal[:, None, None]).amax(-1)
        return torch.where((selection == self.num_entities)[:, None], of_pairs, with_held)

    def _scores(self, one: Tensor, other: Tensor, result: Tensor) -> Tensor:
        recipes = torch.stack(torch.broadcast_tensors(one, other, result), dim=-1)
        return weights_of(recipes, self.keys, self.weights, self.num_entities)
