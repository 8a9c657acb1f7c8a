"""Candidates of the search: entities that a plan may make before the goal.

They are entities that known recipes make from the table, then entities that similar recipes make from the table and
that the goal needs.
"""

from typing import Protocol

import torch
from torch import Tensor, nn

from wordcraft_kg.models.scorers.neighbours.knowledge import NeighbourKnowledge
from wordcraft_kg.models.scorers.pair_features import RecipeKnowledge
from wordcraft_kg.models.scorers.pair_knowledge import PairKnowledge

KNOWN_LINK = 8.0
"""Score of a known link: above nearly all unknown links."""
HOP = 12.0
"""Score lost by a link over an unknown intermediate."""
NEAR = 16
"""Intermediates for links of two hops."""


class Candidates(Protocol):
    """Chooses the intermediates of a search."""

    def __call__(
        self, goal: Tensor, table: Tensor, model: Tensor, number: int, width: int
    ) -> Tensor:
        """Return entities that a plan may make before the goal, shape (B, W), with E where there are fewer.

        Args:
            goal: shape (B,).
            table: shape (B, A), E for empty slots.
            model: number of the model, shape (B,).
            number: attempts left, 2 or more.
            width: W.
        """
        ...


def candidates_of(knowledge: PairKnowledge) -> Candidates:
    """Return the candidates that a kind of knowledge offers."""
    if isinstance(knowledge, NeighbourKnowledge):
        return NeighbourCandidates(knowledge)
    assert isinstance(knowledge, RecipeKnowledge)
    return TableCandidates(knowledge)


class NeighbourCandidates:
    """Results of pairs similar to those on the table, weighted by the needs of recipes similar to the goal's."""

    def __init__(self, knowledge: NeighbourKnowledge):
        self.knowledge = knowledge

    def __call__(  # noqa: D102 - inherited
        self, goal: Tensor, table: Tensor, model: Tensor, number: int, width: int
    ) -> Tensor:
        return self.knowledge.intermediates(
            goal, table, model, attempts=number, width=width, near=NEAR
        )


class TableCandidates:
    """Entities with the highest componentOf scores from the table and to the goal, in tables of all pairs."""

    def __init__(self, knowledge: RecipeKnowledge):
        self.knowledge = knowledge
        size = knowledge.num_entities
        kernel, learned = knowledge.parts[:, :size, :size].float().unbind(-1)
        # The learned link score is low for known links if no train recipe of a left-out fold makes the result.
        self._links = torch.maximum(learned, (10 * kernel).clamp(max=KNOWN_LINK))

    def __call__(  # noqa: D102 - inherited
        self, goal: Tensor, table: Tensor, model: Tensor, number: int, width: int
    ) -> Tensor:
        knowledge = self.knowledge
        size = knowledge.num_entities
        slots = table.shape[1]
        one, other = torch.triu_indices(slots, slots, device=table.device)
        pair = knowledge.numbers[model[:, None], table[:, one], table[:, other]].long()
        known = torch.zeros(len(goal), size + 1, dtype=torch.bool, device=table.device)
        known.scatter_(1, knowledge.results[model[:, None], pair].long().flatten(1), True)
        known = known[:, :size]
        to_goal = self._links[model, :, goal]
        of_table = self._links[model[:, None], table.clamp(max=size - 1)]
        of_table = of_table.masked_fill((table == size)[:, :, None], -torch.inf)
        from_table = _best_two(of_table).maximum(KNOWN_LINK * known - 50.0 * ~known)
        for _ in range(number - 2):
            best, near = to_goal.topk(min(NEAR, size), dim=1)
            over = self._links.transpose(1, 2)[model[:, None], near] + best[:, :, None] - HOP
            made = self._links[model[:, None], from_table.topk(min(NEAR, size), dim=1).indices]
            to_goal = to_goal.maximum(over.amax(1))
            from_table = from_table.maximum(_best_two(torch.cat([of_table, made], dim=1)) - HOP / 4)
        scores = to_goal + from_table + 1000.0 * known
        at_hand = torch.cat([table, goal[:, None]], dim=1)
        scores = nn.functional.pad(scores, (0, 1)).scatter_(1, at_hand, -torch.inf)[:, :size]
        best, chosen = scores.topk(width, dim=1)
        return chosen.masked_fill(best == -torch.inf, size)


def _best_two(scores: Tensor) -> Tensor:
    """Return the mean of the two largest scores along axis 1; the largest if all others are -inf."""
    best = scores.topk(min(2, scores.shape[1]), dim=1).values
    return best.where(best > -torch.inf, best[:, :1]).mean(1)
