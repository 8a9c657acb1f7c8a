"""Endings of episodes and success rates; without torch, shared with text agents."""

from typing import Literal, get_args

from wordcraft_kg.base.records import Count, Record, Share

TerminationReason = Literal["goal", "same_twice", "one_right_part", "no_right_part", "no_recipe"]
TERMINATION_REASONS: tuple[TerminationReason, ...] = get_args(TerminationReason)
"""How an episode ended; the first that holds.

| ending | the last pair |
|---|---|
| goal | made the goal |
| same_twice | was one entity twice |
| one_right_part | has an ingredient of the goal's recipe in a plan |
| no_right_part | made something else |
| no_recipe | made nothing |
"""


class Success(Record):
    """Success of a player on the tasks of a split.

    Attributes:
        mean: success rate.
        ci_low, ci_high: 95 % interval over tasks.
        tasks, draws: sample size, as tasks and draws of distractors for each task.
        by_plan: success rate by the last pair of a plan.
        actions: mean episode length.
    """

    mean: Share
    ci_low: Share
    ci_high: Share
    tasks: Count
    distractor_seeds: Count
    by_plan: Share
    actions: float
