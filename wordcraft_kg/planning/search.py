"""Search for the most probable plan: which pair should be combined first?

With T the entities on the table, n attempts left, and P(c | a, b) the probability that a pair makes
c, from :class:`~wordcraft_kg.models.scorers.probabilities.RecipeCurve`, the value of a pair is the
probability of the most probable plan that begins with it::

    Q_n(T, a, b) = max(P(goal | a, b), max_x P(x | a, b) V_{n-1}(T + x))
    V_n(T) = max_{a, b in T} Q_n(T, a, b)

A plan is a sequence of attempts with an expected result each; its probability is the product. This
is the best case: all results of a pair land on the table, but the plan relies on one, and an
attempt without result ends the plan. Of equally probable plans the shortest is best: each attempt
after the first costs :data:`FURTHER` nats. After each attempt the search begins again from the new
table, with one attempt less, and without the tried pairs. So intermediates may be used several
times, and the number of attempts left is exact.

The search is exhaustive over a limited number of intermediates x: entities that known recipes make
from the table, then entities that similar recipes make from the table and that the goal needs, see
:mod:`~wordcraft_kg.models.scorers.neighbours.candidate_loops`.

Shapes: B states, A slots, E entities, W candidates, and S = A + W slots of the table that all
candidates would be on.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from wordcraft_kg.base.settings import check_memory
from wordcraft_kg.models.scorers.neighbours.knowledge import RecipeKnowledge
from wordcraft_kg.models.scorers.probabilities import RecipeCurve

MAX_ATTEMPTS = 4
"""Largest number of attempts that the search looks ahead."""
WIDTHS = (0, 0, 32, 64, 64)
"""Default number of candidates by attempts left: more change no success rate by more than .01."""
INTERMEDIATE = 2.0
"""Log-odds added to P(x | a, b) for an intermediate x: given that the goal can be made, a result
that leads on is more likely than any result. 2 and 2.5 gave about the same success on split 10; to
measure it again: ``benchmarks/planning.py --odds``."""
FURTHER = 1e-4
"""Nats that each attempt of a plan after the first costs: just above rounding errors."""
NEAR = 16
"""Entities that stand for all others where a plan needs two intermediates or more."""
SCORES = 2**20
"""Recipes scored at once."""
REUSED = -1.5
"""Log-odds of a plan of two attempts whose second attempt uses an ingredient of the first again.

A quarter of the tasks use an entity twice, and more than half of the plans that a table allows.
Chosen on split 10; log-odds of a pair of an entity with itself, in either attempt, changed nothing
there.
"""
AT_ONCE = -3.0
"""Log-odds of a plan of one attempt, where two are left.

A task has as many attempts as it needs, so that only a distractor can open so short a plan.
"""
NO_PLAN = -30.0
"""Log-probability of pairs without a plan: the least, so that products are finite."""
FEATURES = (
    "value",
    "goal",
    "plan",
    "first",
    "rest",
    "plans",
    "second_plan",
    "results",
    "first_known",
    "rest_known",
    "known_results",
    "itself",
    "reused",
    "twice",
)
"""Features of a pair: the best plan that begins with it, and its other plans.

| feature | meaning |
|---|---|
| value | log Q, the planner's value |
| goal | log P(goal given the pair) |
| plan | log-probability of the best plan by an intermediate x: first + rest |
| first, rest | of that plan: log P(x given the pair), and the log-probability after x; 0 if known |
| plans, second_plan | log-sum over all x of their plans; the second best plan |
| results | log-sum over x of P(x given the pair), without :data:`INTERMEDIATE` |
| first_known, rest_known | whether known recipes make x, and with one attempt after x the goal |
| known_results | number of candidates that known recipes make of the pair, at most 3 |
| itself | the pair is an entity twice |
| reused, twice | two attempts: the plan uses an ingredient again; x with itself |

With one attempt left, only value, first_known, itself and reused differ from 0; an entity of a pair
before is used again then.
"""
_MOST_KNOWN = 3
_CERTAIN = -1e-6
"""Log-probabilities above this one are those of known recipes."""
_BYTES = 200
"""Bytes for each recipe of a state, about, while it is scored."""


@dataclass(frozen=True, eq=False)
class PlanSearch:
    """Values of pairs by the most probable plan.

    Attributes:
        knowledge: scores recipes, with E entities and one or more models.
        curve: turns the scores into probabilities.
        width: number of candidates, W; 0 for :data:`WIDTHS`.
        reused: see :data:`REUSED`; 0 for a planner that knows no form of tasks.
        at_once: see :data:`AT_ONCE`, likewise.
    """

    knowledge: RecipeKnowledge
    curve: RecipeCurve
    width: int = 0
    reused: float = REUSED
    at_once: float = AT_ONCE

    @torch.no_grad()
    def values(
        self,
        goal: Tensor,
        table: Tensor,
        model: Tensor,
        attempts_left: Tensor,
        tried: Tensor,
    ) -> Tensor:
        """Return log Q for all pairs of slots.

        Args:
            goal: shape (B,), int64.
            table: shape (B, A), int64; E for empty slots.
            model: shape (B,), int64: number of the model, 0 for all folds, k + 1 without fold k.
            attempts_left: shape (B,), int64; more than :data:`MAX_ATTEMPTS` count as that many.
            tried: shape (B, A, A), bool: pairs that were tried, which make nothing new.

        Returns:
            shape (B, A, A), nats, from :data:`NO_PLAN` to 0; -inf for empty slots.

        Raises:
            ConfigError: if the search would not fit into memory.
        """
        slots = table.shape[1]
        values = torch.full((*table.shape, slots), -torch.inf, device=table.device)
        for number, rows in self._searches(attempts_left, slots):
            result_values, _ = self._values(
                goal[rows], table[rows], model[rows], number, tried[rows]
            )
            values[rows] = result_values.amax(1)
        is_empty = table == self.knowledge.num_entities
        has_empty = is_empty[:, :, None] | is_empty[:, None]
        # The lower bound first: it would lift the -inf of empty slots.
        return values.clamp(min=NO_PLAN).masked_fill(has_empty, -torch.inf)

    @torch.no_grad()
    def features(
        self,
        goal: Tensor,
        table: Tensor,
        model: Tensor,
        attempts_left: Tensor,
        tried: Tensor,
    ) -> Tensor:
        """Return the features of all pairs of slots, for weights learned from play.

        Args:
            goal: shape (B,), int64.
            table: shape (B, A), int64; E for empty slots.
            model: shape (B,), int64: number of the model, 0 for all folds, k + 1 without fold k.
            attempts_left: shape (B,), int64; more than :data:`MAX_ATTEMPTS` count as that many.
            tried: shape (B, A, A), bool: pairs that were tried.

        Returns:
            shape (B, A, A, F), in the order of :data:`FEATURES`; those of empty slots mean nothing.

        Raises:
            ConfigError: if the search would not fit into memory.
        """
        slots = table.shape[1]
        features = torch.zeros(*table.shape, slots, len(FEATURES), device=table.device)
        for number, rows in self._searches(attempts_left, slots):
            features[rows] = self._features(
                goal[rows], table[rows], model[rows], number, tried[rows]
            )
        return features

    def _features(
        self,
        goal: Tensor,
        table: Tensor,
        model: Tensor,
        number: int,
        tried: Tensor,
    ) -> Tensor:
        """Return :meth:`features` of states with equally many attempts left, ``number``."""
        slots = table.shape[1]
        itself = torch.eye(slots, device=table.device).expand(len(table), -1, -1)
        features = {"itself": itself}
        if number == 1:
            to_goal = self._log_probabilities(goal, table, model, tried)
            is_reused = _uses_again(tried, to_goal)
            features |= {
                "value": (to_goal + is_reused * self.reused).clamp(min=NO_PLAN),
                "first_known": (to_goal > _CERTAIN).float(),
                "reused": is_reused,
            }
        else:
            _, to_goal, to_candidates = self._plans(goal, table, model, number, tried)
            value = self._values_of(to_goal, to_candidates, slots, number, tried).amax(1)
            features |= {
                "value": value.clamp(min=NO_PLAN),
                **_features_of_plans(to_goal, to_candidates, slots, number),
            }
        zeros = torch.zeros_like(itself)
        return torch.stack([features.get(name, zeros) for name in FEATURES], dim=-1)

    @torch.no_grad()
    def plan(
        self,
        goal: int,
        table: list[int],
        pair: tuple[int, int],
        *,
        model: int,
        attempts_left: int,
        tried: Tensor,
    ) -> list[tuple[int, int, int, float]]:
        """Return the most probable plan from a pair of slots.

        Args:
            goal: id of the goal.
            table: ids of the A entities on the table.
            pair: slots of the first pair.
            model: number of the model: 0 for all folds, k + 1 without fold k.
            attempts_left: number of attempts left; at most :data:`MAX_ATTEMPTS` are planned.
            tried: shape (1, A, A), bool: pairs that were tried. Results that the plan puts on the
                table come after these A slots, and their pairs are untried.

        Returns:
            the attempts: two ingredients, the expected result, and its probability. Empty for a
            pair that was tried before.
        """
        steps: list[tuple[int, int, int, float]] = []
        slots = len(table)
        device = self.knowledge.bias.device
        has_form = attempts_left == 2 and not tried.any()
        tried = tried.clone()
        table = list(table)
        first, second = pair
        goals = torch.tensor([goal], device=device)
        models = torch.tensor([model], device=device)
        for remaining in range(min(attempts_left, MAX_ATTEMPTS), 0, -1):
            tables = torch.tensor([table], device=device)
            values, results = self._values(goals, tables, models, remaining, tried)
            if steps:
                if has_form:
                    # As in the look-ahead: the second attempt uses what the first one makes.
                    values[:, :, :-1, :-1] += self.at_once
                # Only the first pair is given; the plan goes on with the best pair of all.
                first, second = divmod(int(values[0].amax(0).argmax()), len(table))
            value, best = values[0, :, first, second].max(0)
            if value == -torch.inf:
                break
            result = results[:, best]
            is_goal = int(result) == goal
            # With the prior that the search gave this step, so that the steps' probabilities
            # multiply to that of the plan.
            chance = self.curve.log_probabilities(
                self.knowledge,
                result,
                tables,
                models,
                (torch.tensor([first], device=device), torch.tensor([second], device=device)),
                prior=0.0 if is_goal else INTERMEDIATE,
            )
            probability = float(chance.exp())
            steps.append((table[first], table[second], int(result), probability))
            if is_goal:
                break
            table.append(int(result))
            if max(first, second) < slots:
                tried[0, first, second] = tried[0, second, first] = True
        return steps

    def _searches(self, attempts_left: Tensor, slots: int) -> Iterator[tuple[int, Tensor]]:
        """Group states with equally many attempts left, which are searched together.

        At most :data:`SCORES` recipes are scored at once.

        Args:
            attempts_left: shape (B,), int64.
            slots: A.

        Yields:
            attempts left, at most :data:`MAX_ATTEMPTS`, and numbers of states, one or more.

        Raises:
            ConfigError: if a single state would not fit into memory.
        """
        depths = attempts_left.clamp(1, MAX_ATTEMPTS)
        for number in depths.unique().tolist():
            width = self._width(number)
            wide = slots + width
            sources = wide if number > 2 else slots
            # Recipes of a state: the goal and each candidate as results of pairs, as in `_values`.
            for_goal = _num_pairs(wide, slots if number == 2 else wide)
            for_candidate = _num_pairs(sources, slots if number == 3 else sources)
            num_recipes = for_goal + width * for_candidate
            # Four bytes for each sequence of candidates, see `_after`.
            num_bytes = _BYTES * num_recipes + 4 * width ** (number - 1)
            check_memory("plan_width", width, "candidate plans", num_bytes)
            same_depth = (depths == number).nonzero()[:, 0]
            for rows in same_depth.split(max(1, SCORES // num_recipes)):
                yield number, rows

    def _width(self, number: int) -> int:
        """Return the number of candidates with ``number`` attempts left; none for the last."""
        if number <= 1:
            return 0
        return min(self.width or WIDTHS[number], self.knowledge.num_entities)

    def _values(
        self,
        goal: Tensor,
        table: Tensor,
        model: Tensor,
        number: int,
        tried: Tensor,
    ) -> tuple[Tensor, Tensor]:
        """Return values of pairs by the result that the plan expects of the pair.

        Args:
            goal: shape (B,), int64.
            table: shape (B, A), int64; E for empty slots.
            model: shape (B,), int64.
            number: attempts left, equal for all states.
            tried: shape (B, A, A), bool.

        Returns:
            log-probabilities of the best plans, shape (B, 1 + W, A, A), and the expected results,
            shape (B, 1 + W), the goal first.
        """
        slots = table.shape[1]
        if number == 1:
            to_goal = self._log_probabilities(goal, table, model, tried)
            reuse_bonus = _uses_again(tried, to_goal) * self.reused
            return (to_goal + reuse_bonus)[:, None], goal[:, None]
        candidates, to_goal, to_candidates = self._plans(goal, table, model, number, tried)
        results = torch.cat([goal[:, None], candidates], dim=1)
        return self._values_of(to_goal, to_candidates, slots, number, tried), results

    def _values_of(
        self,
        to_goal: Tensor,
        to_candidates: Tensor,
        slots: int,
        number: int,
        tried: Tensor,
    ) -> Tensor:
        """Return :meth:`_values` of two attempts or more, shape (B, 1 + W, A, A)."""
        at_once = to_goal[:, None, :slots, :slots]
        first = to_candidates[:, :, :slots, :slots]
        if number == 2:
            # After failures, plans for the rest of the attempts may have any form.
            is_first = (~tried.flatten(1).any(1)).float()
            at_once = at_once + self.at_once * is_first[:, None, None, None]
            after = self._second_attempt(to_goal, slots, is_first[:, None])
        else:
            candidate_values = _after_candidates(to_goal, to_candidates, slots, number)
            after = candidate_values[:, :, None, None]
        return torch.cat([at_once, first + after - FURTHER], dim=1)

    def _second_attempt(self, to_goal: Tensor, slots: int, is_first: Tensor) -> Tensor:
        """Return the log-probability of the best second attempt, by what the first one made.

        Args:
            to_goal: shape (B, S, S): a pair makes the goal.
            slots: A.
            is_first: shape (B, 1): 1 where no pair was tried before, and forms count, else 0.

        Returns:
            shape (B, W, A, A): after a pair of slots made the candidate.
        """
        # Without what the first attempt made, it would be wasted.
        on_table = to_goal[:, :slots, :slots].flatten(1).amax(1)[:, None]
        on_table = on_table + self.at_once * is_first
        last = to_goal[:, slots:]
        with_itself = last[:, :, slots:].diagonal(dim1=1, dim2=2)
        with_table = last[:, :, :slots]
        reuse_values = with_table.amax(2) + self.reused * is_first
        candidate_values = torch.maximum(torch.maximum(with_itself, reuse_values), on_table)
        # The best partner that is not of the pair is one of the three best.
        values, places = with_table.topk(min(3, slots), dim=2)
        slot = torch.arange(slots, device=to_goal.device)
        best = torch.full_like(with_table[..., None] + slot, -torch.inf)
        for rank in reversed(range(values.shape[2])):
            is_partner = places[:, :, rank, None] == slot
            is_of_pair = is_partner[..., :, None] | is_partner[..., None, :]
            best = torch.where(is_of_pair, best, values[:, :, rank, None, None])
        return torch.maximum(best, candidate_values[:, :, None, None])

    def _plans(
        self,
        goal: Tensor,
        table: Tensor,
        model: Tensor,
        number: int,
        tried: Tensor,
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Score the steps of all plans of two attempts or more; arguments of :meth:`_values`.

        Returns:
            The candidates x, shape (B, W), int64, E where there are fewer; and log-probabilities:
            a pair makes the goal, shape (B, S, S), and a pair makes x, shape (B, W, S, S), or
            (B, W, A, A) for two attempts; -inf where a candidate is missing, and for pairs without
            a score.
        """
        slots = table.shape[1]
        candidates = self.knowledge.intermediates(
            goal,
            table,
            model,
            attempts=number,
            width=self._width(number),
            near=NEAR,
        )
        wide = torch.cat([table, candidates], dim=1)
        # Two candidates take two attempts. So with two attempts left, they can never be combined,
        # and with three, only to make the goal: most pairs need no score.
        num_partners = slots if number == 2 else None
        to_goal = self._log_probabilities(goal, wide, model, tried, num_partners=num_partners)
        sources = wide if number > 2 else table
        num_partners = slots if number == 3 else None
        # Each state W times, with one candidate as the goal each.
        num_states, width = candidates.shape
        rows = torch.arange(num_states, device=candidates.device).repeat_interleave(width)
        to_candidates = self._log_probabilities(
            candidates.flatten(),
            sources[rows],
            model[rows],
            tried[rows],
            num_partners=num_partners,
            prior=INTERMEDIATE,
        )
        to_candidates = to_candidates.view(num_states, width, *to_candidates.shape[1:])
        is_missing = candidates == self.knowledge.num_entities
        to_candidates = to_candidates.masked_fill(is_missing[:, :, None, None], -torch.inf)
        return candidates, to_goal, to_candidates

    def _log_probabilities(
        self,
        goal: Tensor,
        table: Tensor,
        model: Tensor,
        tried: Tensor,
        *,
        num_partners: int | None = None,
        prior: float = 0.0,
    ) -> Tensor:
        """Return log P(goal | a, b) for all pairs of slots.

        Args:
            goal: shape (B,), int64.
            table: shape (B, S), int64; E for empty slots.
            model: shape (B,), int64.
            tried: shape (B, A, A), bool, for the first A slots.
            num_partners: slots from this one on are not combined with each other. None for all
                pairs.
            prior: log-odds added to each pair.

        Returns:
            shape (B, S, S), symmetric; -inf for empty slots, and for tried and left-out pairs.
        """
        slots = table.shape[1]
        # P is symmetric: each pair is scored once, and written twice.
        first, second = _pairs(slots, slots if num_partners is None else num_partners, table.device)
        log_probs = self.curve.log_probabilities(
            self.knowledge,
            goal,
            table,
            model,
            (first, second),
            prior=prior,
        )
        values = torch.full((*table.shape, slots), -torch.inf, device=table.device)
        values[:, first, second] = log_probs
        values[:, second, first] = log_probs
        is_empty = table == self.knowledge.num_entities
        values.masked_fill_(is_empty[:, :, None] | is_empty[:, None], -torch.inf)
        known_slots = tried.shape[1]
        values[:, :known_slots, :known_slots].masked_fill_(tried, -torch.inf)
        return values


def _uses_again(tried: Tensor, to_goal: Tensor) -> Tensor:
    """Return whether a second pair has an ingredient of the first, shape (B, S, S), 0 or 1.

    So a plan is carried on: after an attempt with the result that the plan expects, its second
    attempt is still the best one. After several attempts nobody knows which of them was the plan's.

    Args:
        tried: shape (B, A, A), bool: pairs that were tried, for the first A slots.
        to_goal: shape (B, S, S).
    """
    is_second = tried.triu().sum((1, 2)) == 1
    is_reused = tried.any(2) & is_second[:, None]
    was_used = nn.functional.pad(is_reused, (0, to_goal.shape[1] - tried.shape[1]))
    return (was_used[:, :, None] | was_used[:, None]).float()


def _features_of_plans(
    to_goal: Tensor, to_candidates: Tensor, slots: int, number: int
) -> dict[str, Tensor]:
    """Return the features of pairs that depend on their plans, shape (B, A, A) each.

    Args:
        to_goal: as :meth:`PlanSearch._plans` returns it.
        to_candidates: likewise.
        slots: A.
        number: attempts left, 2 or more.
    """
    first = to_candidates[:, :, :slots, :slots]
    last_step = _after_candidates(to_goal, to_candidates, slots, number)
    if number == 2:
        # Only plans that use x: without it, the first attempt would be wasted.
        last = to_goal[:, slots:]
        table_values, partner = last[:, :, :slots].max(2)
        with_itself = last[:, :, slots:].diagonal(dim1=1, dim2=2)
        last_step = torch.maximum(table_values, with_itself)
    first = first.clamp(min=NO_PLAN)
    last_step = last_step.clamp(min=NO_PLAN)
    by_candidate = (first + last_step[:, :, None, None]).clamp(min=NO_PLAN)
    best, place = by_candidate.max(1)

    def of_best(values: Tensor) -> Tensor:
        """Return a value of each candidate, shape (B, W), at the best one of each pair."""
        return values.gather(1, place.flatten(1)).view_as(best)

    best_first = first.gather(1, place[:, None])[:, 0]
    best_rest = of_best(last_step)
    second = best
    if by_candidate.shape[1] > 1:
        second = by_candidate.topk(2, dim=1).values[:, 1]
    features = {
        "goal": to_goal[:, :slots, :slots].clamp(min=NO_PLAN),
        "plan": best,
        "first": best_first.masked_fill(best_first > _CERTAIN, 0),
        "rest": best_rest.masked_fill(best_rest > _CERTAIN, 0),
        "plans": torch.logsumexp(by_candidate, dim=1),
        "second_plan": second,
        "results": torch.logsumexp((first - INTERMEDIATE).clamp(min=NO_PLAN), dim=1),
        "first_known": (best_first > _CERTAIN).float(),
        "rest_known": (best_rest > _CERTAIN).float(),
        "known_results": (first > _CERTAIN).sum(1).clamp(max=_MOST_KNOWN).float(),
    }
    if number == 2:
        is_twice = of_best((with_itself > table_values).float())
        partner_values = of_best(partner)
        slot = torch.arange(slots, device=partner_values.device)
        is_reused = (partner_values == slot[:, None]) | (partner_values == slot)
        features |= {"twice": is_twice, "reused": is_reused.float() * (1 - is_twice)}
    return features


def _pairs(slots: int, num_partners: int, device: torch.device) -> tuple[Tensor, Tensor]:
    """Return the pairs of slots that are scored: first and second slots, the smaller one first.

    Args:
        slots: S.
        num_partners: slots from this one on are combined with those before and with themselves
            alone.
        device: device of the result.
    """
    first, second = torch.triu_indices(slots, slots, device=device)
    is_scored = (first < num_partners) | (first == second)
    return first[is_scored], second[is_scored]


def _num_pairs(slots: int, num_partners: int) -> int:
    """Return the number of :func:`_pairs`."""
    return num_partners * (num_partners + 1) // 2 + (slots - num_partners) * (num_partners + 1)


def _after_candidates(to_goal: Tensor, to_candidates: Tensor, slots: int, number: int) -> Tensor:
    """Return the log-probability of the best plan after making each candidate.

    Args:
        to_goal: shape (B, S, S): a pair makes the goal.
        to_candidates: shape (B, W, S, S), or (B, W, A, A) for two attempts: a pair makes x.
        slots: A.
        number: attempts left before the candidate is made, 2 or more.

    Returns:
        shape (B, W).
    """
    # Slots of the table come first, then the candidates.
    old = slice(None, slots)
    new = slice(slots, None)
    direct = to_goal[:, old, old].flatten(1).amax(1)
    # A candidate makes the goal with an entity on the table, or twice.
    last = to_goal[:, new]
    with_table = last[:, :, old].amax(2)
    with_candidates = last[:, :, new]
    with_itself = with_candidates.diagonal(dim1=1, dim2=2)
    finish = torch.maximum(with_table, with_itself)
    if number == 2:
        return torch.maximum(finish, direct[:, None])

    # (B, x, y, S): x with an entity makes y.
    candidate_values = to_candidates[:, :, new].transpose(1, 2)
    by_table = candidate_values[..., old].amax(3)
    by_candidates = candidate_values[..., new]
    # The diagonal puts its own axis last, (B, y, x): x twice makes y.
    twice = by_candidates.diagonal(dim1=1, dim2=3).transpose(1, 2)
    steps = torch.maximum(by_table, twice)
    begin = to_candidates[:, :, old, old].flatten(2).amax(2)
    # (B, a, x, y): candidates a and x make y.
    pairs = by_candidates.permute(0, 3, 1, 2)
    return _after(begin, finish, direct, steps, with_candidates, pairs, number - 1)


def _after(
    begin: Tensor,
    finish: Tensor,
    direct: Tensor,
    steps: Tensor,
    last: Tensor,
    pairs: Tensor,
    number: int,
) -> Tensor:
    """Return the log-probability of the best plan after making each candidate.

    All arguments are log-probabilities, with W candidates in the last axes, and axes for candidates
    made before:

    Args:
        begin: a pair at hand makes y, shape (..., W).
        finish: x with an entity at hand makes the goal, shape (..., W).
        direct: a pair at hand makes the goal, shape (...).
        steps: x with an entity at hand makes y, shape (..., W, W).
        last: x and y make the goal, shape (..., W, W).
        pairs: a and x make y, shape (..., W, W, W).
        number: attempts left.

    Returns:
        same shape as ``finish``.
    """
    # Once x is made, it is at hand: each probability "at hand" becomes one for each x.
    direct = torch.maximum(finish, direct[..., None])
    if number == 1:
        return direct
    begin = torch.maximum(begin[..., None, :], steps)
    finish_values = torch.maximum(finish[..., None, :], last)
    if number > 2:
        # With a at hand too, x makes y with an earlier entity or with a.
        steps = torch.maximum(steps.unsqueeze(-3), pairs)
    # Pairs of candidates stay the same, whatever was made before: an axis for the broadcast.
    after = _after(
        begin,
        finish_values,
        direct,
        steps,
        last.unsqueeze(1),
        pairs.unsqueeze(1),
        number - 1,
    )
    return torch.maximum(direct, (begin + after).amax(-1) - FURTHER)
