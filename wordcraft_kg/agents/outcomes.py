"""Termination reasons and success rates; imports no torch, since text agents share this module."""

from typing import Literal, get_args

from wordcraft_kg.base.records import Count, Record, Share

TerminationReason = Literal["goal", "same_twice", "one_right_part", "no_right_part", "no_recipe"]
TERMINATION_REASONS: tuple[TerminationReason, ...] = get_args(TerminationReason)
"""Termination reasons of an episode, by its last attempt; the first match in this order counts.

| reason | the last pair |
|---|---|
| goal | made the goal |
| same_twice | was an entity with itself |
| one_right_part | has an ingredient for the goal in a plan |
| no_right_part | made something else |
| no_recipe | made nothing |
"""


class Success(Record):
    """A player's success on the tasks in a part of the split, all or a sample of them.

    Attributes:
        mean: share of episodes that made the goal.
        ci_low: lower end of the 95 % interval of ``mean``, over tasks: the interval resamples the
            groups of tasks that the split holds out together.
        ci_high: upper end.
        tasks: number of tasks.
        distractor_seeds: tables per task.
        by_plan: share of episodes in which a plan's last pair made the goal.
        actions: mean episode length in actions.
    """

    mean: Share
    ci_low: Share
    ci_high: Share
    tasks: Count
    distractor_seeds: Count
    by_plan: Share
    actions: float
