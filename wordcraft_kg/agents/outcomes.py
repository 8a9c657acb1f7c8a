"""Termination reasons and success rates; imports no torch, since text agents share this module."""

from typing import Literal, get_args

from wordcraft_kg.base.records import Count, Record, Share

TerminationReason = Literal["goal", "same_twice", "one_right_part", "no_right_part", "no_recipe"]
TERMINATION_REASONS: tuple[TerminationReason, ...] = get_args(TerminationReason)
"""Termination reasons of an episode; the first match counts.

| reason | the last pair |
|---|---|
| goal | made the goal |
| same_twice | was an entity with itself |
| one_right_part | has an ingredient for the goal in a plan |
| no_right_part | made something else |
| no_recipe | made nothing |
"""


class Success(Record):
    """A player's success on the tasks in a part of the split.

    Attributes:
        mean: share of episodes that made the goal.
        ci_low, ci_high: 95 % interval over tasks, resampling groups that the split holds out together.
        tasks, distractor_seeds: sample size: tasks, and tables per task.
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
