"""Termination reasons and success rates; without torch, shared with text agents."""

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
    """Success of a player on a split.

    Attributes:
        mean: success rate.
        ci_low, ci_high: 95 % interval over tasks.
        tasks, distractor_seeds: sample size: tasks, and tables per task.
        by_plan: success rate with the last pair from a plan.
        actions: mean episode length.
    """

    mean: Share
    ci_low: Share
    ci_high: Share
    tasks: Count
    distractor_seeds: Count
    by_plan: Share
    actions: float
