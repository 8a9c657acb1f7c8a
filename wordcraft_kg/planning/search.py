"""Search for the most probable plan: which pair should be combined first?

With T the entities on the table, n attempts left, and P(c | a, b) the probability that a pair makes c, from
:class:`~wordcraft_kg.models.scorers.recipe_curve.RecipeCurve`, the value of a pair is the probability of the most
probable plan that begins with it::

    Q_n(T, a, b) = max(P(goal | a, b), max_x P(x | a, b) V_{n-1}(T + x))
    V_n(T) = max_{a, b in T} Q_n(T, a, b)

A plan is a sequence of attempts with an expected result each; its probability is the product. This is the best case:
all results of a pair land on the table, but the plan relies on one, and an attempt without result ends the plan. Of
equally probable plans the shortest is best: each attempt after the first costs :data:`FURTHER` nats. After each
attempt the search begins again from the new table, with one attempt less, and without the tried pairs. So intermediates
may be used several times, and the number of attempts left is exact.

The search is exhaustive over a limited number of intermediates x, see :mod:`~wordcraft_kg.planning.intermediates`.
"""

from collections.abc import Iterator

import torch
from torch import Tensor

from wordcraft_kg.base.settings import check_memory
from wordcraft_kg.models.scorers.pair_knowledge import PairKnowledge
from wordcraft_kg.models.scorers.recipe_curve import RecipeCurve
from wordcraft_kg.planning.intermediates import candidates_of

MAX_ATTEMPTS = 4
"""Largest number of attempts that the search looks ahead."""
WIDTHS = (0, 0, 32, 64, 64)
"""Default number of candidates by attempts left: more change no success rate by more than .01."""
INTERMEDIATE = 3.0
"""Log-odds added to P(x | a, b) for an intermediate x: given that the goal can be made, a result that leads on is more
likely than any result. 2 to 4 give about the same success, see docs/planning.md."""
FURTHER = 1e-4
"""Nats that each attempt of a plan after the first costs: just above rounding errors."""
SCORES = 2**20
"""Recipes scored at once."""
NO_PLAN = -30.0
"""Log-probability of pairs without a plan."""


class PlanSearch:
    """Values of pairs by the most probable plan, with ``width`` candidates; 0 for :data:`WIDTHS`."""

    def __init__(self, knowledge: PairKnowledge, curve: RecipeCurve, *, width: int = 0):
        self.knowledge, self.curve, self.width = knowledge, curve, width
        self._candidates = candidates_of(knowledge)

    @property
    def device(self) -> torch.device:
        """The device of the arrays."""
        return self.knowledge.bias.device

    @torch.no_grad()
    def values(
        self,
        goal: Tensor,
        table: Tensor,
        model: Tensor,
        attempts_left: Tensor,
        tried: Tensor | None = None,
    ) -> Tensor:
        """Return log Q for all pairs of slots, shape (B, A, A), from :data:`NO_PLAN` to 0; -inf for empty slots.

        ``goal``, ``model`` (number of the model) and ``attempts_left`` have shape (B,); more than :data:`MAX_ATTEMPTS`
        count as that many. ``table``, shape (B, A), has E for empty slots; ``tried``, shape (B, A, A), bool, marks
        pairs that were tried, which make nothing new. ConfigError if the search would not fit into memory.
        """
        slots = table.shape[1]
        values = torch.full((*table.shape, slots), -torch.inf, device=table.device)
        for number in attempts_left.clamp(1, MAX_ATTEMPTS).unique().tolist():
            for rows in self._chunks(
                (attempts_left.clamp(1, MAX_ATTEMPTS) == number).nonzero()[:, 0], number, slots
            ):
                past = None if tried is None else tried[rows]
                values[rows] = self._values(goal[rows], table[rows], model[rows], number, past)[
                    0
                ].amax(1)
        is_empty = table == self.knowledge.num_entities
        return values.clamp(min=NO_PLAN).masked_fill(
            is_empty[:, :, None] | is_empty[:, None], -torch.inf
        )

    @torch.no_grad()
    def plan(
        self,
        goal: int,
        table: list[int],
        pair: tuple[int, int],
        *,
        model: int,
        attempts_left: int,
        tried: Tensor | None = None,
    ) -> list[tuple[int, int, int, float]]:
        """Return the most probable plan from a pair of slots; empty for a pair ``tried``, (1, A, A), before."""
        steps: list[tuple[int, int, int, float]] = []
        table, (one, other), device = list(table), pair, self.device
        for left in range(min(attempts_left, MAX_ATTEMPTS), 0, -1):
            goals, tables, models = (
                torch.tensor(part, device=device) for part in ([goal], [table], [model])
            )
            values, results = self._values(goals, tables, models, left, tried)
            if steps:
                one, other = divmod(int(values[0].amax(0).argmax()), len(table))
            value, best = values[0, :, one, other].max(0)
            if value == -torch.inf:
                break
            result = results[:, best]
            is_goal = int(result) == goal
            pairs = torch.tensor([one], device=device), torch.tensor([other], device=device)
            prior = 0.0 if is_goal else INTERMEDIATE
            chance = self.curve.log_probabilities(
                self.knowledge, result, tables, models, pairs, prior=prior
            )
            steps.append((table[one], table[other], int(result), float(chance.exp())))
            if is_goal:
                break
            table.append(int(result))
        return steps

    def _chunks(self, rows: Tensor, number: int, slots: int) -> Iterator[Tensor]:
        width = self._width(number)
        wide = slots + width * (number > 2)
        one = (width + 1) * wide * (wide + 1) // 2
        check_memory(
            "plan_width", width, "candidate plans", 200 * one + 4 * width ** max(number - 1, 0)
        )
        yield from rows.split(max(1, SCORES // one))

    def _width(self, number: int) -> int:
        return min(self.width or WIDTHS[number], self.knowledge.num_entities) if number > 1 else 0

    def _values(
        self, goal: Tensor, table: Tensor, model: Tensor, number: int, tried: Tensor | None
    ) -> tuple[Tensor, Tensor]:
        """Return values by pair, (B, 1 + W, A, A), of the expected results, (B, 1 + W), the goal first."""
        slots = table.shape[1]
        if number == 1:
            return self._log_probabilities(goal, table, model, tried)[:, None], goal[:, None]
        candidates = self._candidates(goal, table, model, number, self._width(number))
        width = candidates.shape[1]
        wide = torch.cat([table, candidates], dim=1)
        # With two attempts left, two candidates can never be combined.
        to_goal = self._log_probabilities(
            goal, wide, model, tried, most=slots if number == 2 else None
        )
        sources = wide if number > 2 else table
        rows = torch.arange(len(goal), device=goal.device).repeat_interleave(width)
        past = None if tried is None else tried[rows]
        repeated = candidates.flatten(), sources[rows], model[rows]
        to_candidates = self._log_probabilities(*repeated, past, prior=INTERMEDIATE)
        to_candidates = to_candidates.view(len(goal), width, *sources.shape[1:], sources.shape[1])
        missing = (candidates == self.knowledge.num_entities)[:, :, None, None]
        to_candidates = to_candidates.masked_fill(missing, -torch.inf)
        of_table = to_candidates[:, :, :slots, :slots]
        new, last = slice(slots, None), to_goal[:, slots:]
        # A candidate with an entity on the table, or twice
        with_itself = last[:, :, new].diagonal(dim1=1, dim2=2)
        finish = torch.maximum(last[:, :, :slots].amax(2), with_itself)
        direct = to_goal[:, :slots, :slots].flatten(1).amax(1)
        if number == 2:
            after = torch.maximum(finish, direct[:, None])
        else:
            of_new = to_candidates[:, :, new].transpose(
                1, 2
            )  # (B, x, y, S): x with an entity makes y
            itself = of_new[..., new].diagonal(dim1=1, dim2=3).transpose(1, 2)
            begin = torch.maximum(of_new[..., :slots].amax(3), itself)
            pairs = of_new[..., new].permute(0, 3, 1, 2)  # (B, a, x, y): a and x make y
            of_pairs = of_table.flatten(2).amax(2)
            after = _after(of_pairs, finish, direct, begin, last[:, :, new], pairs, number - 1)
        values = torch.cat(
            [to_goal[:, None, :slots, :slots], of_table + after[:, :, None, None] - FURTHER], dim=1
        )
        return values, torch.cat([goal[:, None], candidates], dim=1)

    def _log_probabilities(
        self,
        goal: Tensor,
        table: Tensor,
        model: Tensor,
        tried: Tensor | None,
        *,
        most: int | None = None,
        prior: float = 0.0,
    ) -> Tensor:
        """Return log P(goal | a, b) for slots, (B, A, A); -inf if empty, tried, or two slots from ``most`` on."""
        slots, empty = table.shape[1], table == self.knowledge.num_entities
        one, other = torch.triu_indices(slots, slots, device=table.device)
        if most is not None:
            one, other = torch.stack([one, other])[:, (one < most) | (one == other)]
        of_pairs = self.curve.log_probabilities(
            self.knowledge, goal, table, model, (one, other), prior=prior
        )
        values = torch.full((*table.shape, slots), -torch.inf, device=table.device)
        values[:, one, other] = values[:, other, one] = of_pairs
        values.masked_fill_(empty[:, :, None] | empty[:, None], -torch.inf)
        if tried is not None:
            values[:, : tried.shape[1], : tried.shape[2]].masked_fill_(tried, -torch.inf)
        return values


def _after(
    begin: Tensor,
    finish: Tensor,
    direct: Tensor,
    steps: Tensor,
    last: Tensor,
    pairs: Tensor,
    number: int,
) -> Tensor:
    """Return the log-probability of the best plan after making each candidate, same shape as ``finish``.

    All arguments are log-probabilities, with W candidates in the last axes, and axes for candidates made before:

    Args:
        begin: a pair at hand makes y, shape (..., W).
        finish: x with an entity at hand makes the goal, shape (..., W).
        direct: a pair at hand makes the goal, shape (...).
        steps: x with an entity at hand makes y, shape (..., W, W).
        last: x and y make the goal, shape (..., W, W).
        pairs: a and x make y, shape (..., W, W, W).
        number: attempts left.
    """
    direct = torch.maximum(finish, direct[..., None])
    if number == 1:
        return direct
    begin = torch.maximum(begin[..., None, :], steps)
    further = torch.maximum(finish[..., None, :], last)
    if number > 2:
        steps = torch.maximum(steps.unsqueeze(-3), pairs)
    after = _after(begin, further, direct, steps, last.unsqueeze(1), pairs.unsqueeze(1), number - 1)
    return torch.maximum(direct, (begin + after).amax(-1) - FURTHER)
