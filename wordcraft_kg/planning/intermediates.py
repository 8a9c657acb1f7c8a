"""Candidates of the search: entities that a plan may make before the goal.

They are entities that known recipes make from the table, then entities that similar recipes make
from the table and that the goal needs.
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
_NOT_KNOWN = -50.0
"""Score of an entity that no known recipe makes from the table: below every learned link."""
_STEP = HOP / 4
"""Score lost by an entity that needs another intermediate from the table: less than a hop to the
goal, because the intermediate is one of a few that the table makes most likely."""
_KNOWN_FIRST = 1000.0
"""Added to entities that known recipes make: they come before all others, whatever the links."""


class Candidates(Protocol):
    """Chooses the intermediates of a search."""

    def __call__(
        self,
        goal: Tensor,
        table: Tensor,
        model: Tensor,
        number: int,
        width: int,
    ) -> Tensor:
        """Return entities that a plan may make before the goal.

        Args:
            goal: shape (B,), int64.
            table: shape (B, A), int64; E for empty slots.
            model: shape (B,), int64: number of the model.
            number: attempts left, 2 or more.
            width: W, the number of candidates.

        Returns:
            shape (B, W), int64, best first; E where there are fewer candidates.
        """
        ...


def candidates_of(knowledge: PairKnowledge) -> Candidates:
    """Return the candidates that a kind of knowledge offers."""
    if isinstance(knowledge, NeighbourKnowledge):
        return NeighbourCandidates(knowledge)
    assert isinstance(knowledge, RecipeKnowledge)
    return TableCandidates(knowledge)


class NeighbourCandidates:
    """Results of pairs similar to those on the table.

    They are weighted by the needs of recipes similar to the goal's.
    """

    def __init__(self, knowledge: NeighbourKnowledge):
        self.knowledge = knowledge

    def __call__(  # noqa: D102 - inherited
        self,
        goal: Tensor,
        table: Tensor,
        model: Tensor,
        number: int,
        width: int,
    ) -> Tensor:
        return self.knowledge.intermediates(
            goal,
            table,
            model,
            attempts=number,
            width=width,
            near=NEAR,
        )


class TableCandidates:
    """Entities with the highest componentOf scores from the table and to the goal.

    The scores come from tables of all pairs of entities.
    """

    def __init__(self, knowledge: RecipeKnowledge):
        self.knowledge = knowledge
        size = knowledge.num_entities
        # The last row and column belong to empty slots.
        kernel, learned = knowledge.parts[:, :size, :size].float().unbind(-1)
        # The learned link score is low for known links if no train recipe of a left-out fold makes
        # the result: the kernel's score lifts them, up to `KNOWN_LINK`.
        by_kernel = (10 * kernel).clamp(max=KNOWN_LINK)
        self._links = torch.maximum(learned, by_kernel)

    def __call__(  # noqa: D102 - inherited
        self,
        goal: Tensor,
        table: Tensor,
        model: Tensor,
        number: int,
        width: int,
    ) -> Tensor:
        size = self.knowledge.num_entities
        near = min(NEAR, size)
        # A column beside the states' rows, so that it goes with several entities of each state.
        models = model[:, None]
        known = self._made(table, models)

        # Scores of each entity x, shape (B, E): x as a part of the goal, and x made from the table.
        to_goal = self._links[model, :, goal]
        of_table = self._links[models, table.clamp(max=size - 1)]
        of_table = of_table.masked_fill((table == size)[:, :, None], -torch.inf)
        from_table = _best_two(of_table).maximum(KNOWN_LINK * known + _NOT_KNOWN * ~known)

        # Each further attempt allows one more intermediate on either side.
        to_entity = self._links.transpose(1, 2)
        for _ in range(number - 2):
            best, goal_parts = to_goal.topk(near, dim=1)
            over = to_entity[models, goal_parts] + best[:, :, None] - HOP
            likely = from_table.topk(near, dim=1).indices
            made = self._links[models, likely]
            to_goal = to_goal.maximum(over.amax(1))
            with_made = _best_two(torch.cat([of_table, made], dim=1))
            from_table = from_table.maximum(with_made - _STEP)

        scores = to_goal + from_table + _KNOWN_FIRST * known
        # Entities on the table and the goal are no intermediates; empty slots, E, fall on a column
        # that is cut off again.
        at_hand = torch.cat([table, goal[:, None]], dim=1)
        padded = nn.functional.pad(scores, (0, 1))
        scores = padded.scatter_(1, at_hand, -torch.inf)[:, :size]
        best, chosen = scores.topk(width, dim=1)
        return chosen.masked_fill(best == -torch.inf, size)

    def _made(self, table: Tensor, models: Tensor) -> Tensor:
        """Return whether known recipes make each entity from the table, (B, E); models (B, 1)."""
        knowledge = self.knowledge
        size = knowledge.num_entities
        slots = table.shape[1]
        one, other = torch.triu_indices(slots, slots, device=table.device)
        pair = knowledge.numbers[models, table[:, one], table[:, other]].long()
        # Pairs have up to K results, padded with E: that column is cut off.
        results = knowledge.results[models, pair].long().flatten(1)
        known = torch.zeros(len(table), size + 1, dtype=torch.bool, device=table.device)
        known.scatter_(1, results, True)
        return known[:, :size]


def _best_two(scores: Tensor) -> Tensor:
    """Return the mean of the two largest scores along axis 1; the largest if others are -inf."""
    best = scores.topk(min(2, scores.shape[1]), dim=1).values
    # A table with one entity combines it with itself: its score counts twice.
    filled = best.where(best > -torch.inf, best[:, :1])
    return filled.mean(1)
