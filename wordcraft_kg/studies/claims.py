"""Claims about a study's results: each gets a verdict by a fixed rule, with the measured values.

A claim compares two sides: two variants, or a variant and a value. With [l, h] the 95 % interval
for the difference between the sides, a claim of *more, by at least b* (default 0) is

| verdict | if |
|---|---|
| reproduced | l ≥ b, and l > 0 |
| differs | 0 < l < b: right direction, wrong or uncertain amount |
| not reproduced | h < 0, h < b, or (without an amount) h < .02 |
| undecided | otherwise |

For *less* all signs are reversed. *Comparable, closer than b* is reproduced if [l, h] lies within
±b, not reproduced if it lies beyond ±b, differs if it otherwise excludes 0, and else undecided.
*Varies* is reproduced if one grid interval is above 0 and another below; with one sign everywhere,
it differs if the change of the difference between two points is significant at 5 % (in pairs; for
other tasks: disjoint intervals) and else is not reproduced; it is not reproduced either if all
intervals lie within ±.02, and else undecided. A claim without runs is *not run*.

Intervals for success are over seeds and over groups of tasks that the split holds out together,
such as the tasks of a goal, or over splits if each training has its own. Intervals for metrics per
run, such as steps, are over seeds: mean ± t · s / √S, with Student's t. Both are those of
:func:`~wordcraft_kg.base.statistics.crossed_difference`. Differences are paired by seed, task and
table. Verdicts are not corrected for multiple claims. With fewer than
three seeds, a verdict other than *undecided* is marked as provisional.
"""

import math
from collections.abc import Iterable, Sequence
from itertools import chain, combinations, pairwise
from typing import Literal, NamedTuple

import msgspec
import numpy as np

from wordcraft_kg.base import ConfigError, Count, Record, Share, counted
from wordcraft_kg.base.statistics import FEWEST_PAIRS, crossed_difference, rate_interval
from wordcraft_kg.studies.results import (
    PlayedRates,
    RunResult,
    StudyResults,
    TaskIdentity,
)
from wordcraft_kg.studies.study import Claim, Measure, Values, points_at, title_of

Verdict = Literal["reproduced", "differs", "not reproduced", "undecided", "not run"]
_SAME = 0.02
"""Smallest relevant success difference: half the width of a usual interval over tasks."""
_EARLY = 0.1
"""Share of the steps after which early success is measured."""
REACHED = 0.95
"""Share of a curve's last point that counts as reached; the last percents are noise."""


class Measured(Record, frozen=True):
    """The measured values for a claim at a grid point.

    Attributes:
        values: the grid settings of the point.
        left: mean of the left side over the seeds that both sides have, in the measure's unit.
        right: mean of the right side, or the value that the left side is compared with.
        difference: ``left - right``.
        low: lower end of the 95 % interval of the difference; None for a single seed, which does
            not show how trainings vary.
        high: upper end of the interval, or None.
        seeds: number of seeds that both sides have.
        tasks: number of test tasks; 0 for measures with one value per training, whose intervals are
            over seeds alone.
        groups: number of task groups that the interval resamples; equal to ``tasks`` if each task
            is a group.
        splits: number of splits, one for each training; 1 if all trainings have the same.
        p_value: of no difference; None below three seeds, as for comparisons.
    """

    values: Values
    left: float
    right: float
    difference: float
    low: float | None
    high: float | None
    seeds: Count
    tasks: Count
    groups: Count
    splits: Count = 1
    p_value: Share | None = None


class ClaimVerdict(Record, frozen=True):
    """A claim with its verdict.

    The verdict follows from the measured intervals by the table of this module.

    Attributes:
        claim: the claim.
        verdict: result of the rule.
        why: the reason for the verdict, in words.
        measured: values of the grid point that the verdict is about; of all points for a claim that
            the sign of the difference varies; empty if nothing was run.
    """

    claim: Claim
    verdict: Verdict
    why: str
    measured: tuple[Measured, ...]


def view_claims(results: StudyResults, claims: Iterable[Claim]) -> tuple[ClaimVerdict, ...]:
    """Return verdicts on claims about a study, one for each grid point of each claim."""
    return tuple(chain.from_iterable(check_claim(results, claim) for claim in claims))


def check_claim(results: StudyResults, claim: Claim) -> list[ClaimVerdict]:
    """Return verdicts on a claim, one for each grid point.

    Then follows one for each reason of a missing point: a point without results is the verdict "not
    run", no error. A claim that the sign varies has one verdict over all its points, and needs two
    of them.
    """
    figures: list[Measured] = []
    reasons: list[str] = []
    for point in points_at(results.study, claim.at):
        try:
            figures.append(_measure(results, claim, point))
        except ConfigError as error:
            reasons.append(str(error))
    # One verdict for each point, except for claims about how points differ.
    groups: list[tuple[Measured, ...]] = [(measured,) for measured in figures]
    if claim.expected == "varies":
        groups = [tuple(figures)] if len(figures) > 1 else []
    if not groups and not reasons:
        reasons = ["the study has no results at such points"]
    verdicts = []
    for group in groups:
        verdict, why = _rule(results, claim, group)
        # With two seeds, Student's t has one degree of freedom: such a verdict may turn with the
        # third seed.
        seeds = min(at.seeds for at in group)
        if verdict != "undecided" and seeds < FEWEST_PAIRS:
            why += f" (provisional: {counted(seeds, 'seed')})"
        verdicts.append(ClaimVerdict(claim, verdict, why, group))
    # Many points usually lack results for the same reason, which is said once.
    verdicts += [ClaimVerdict(claim, "not run", reason, ()) for reason in dict.fromkeys(reasons)]
    return verdicts


class _Sides(NamedTuple):
    """Both sides of a claim at a grid point, in pairs of trainings with the same seed.

    Attributes:
        seeds: common seeds, ascending.
        tasks: identity of the test tasks of each training of the left side.
        left: rates by task for success, else a table of shape (seeds, 1).
        right: the same, in the same shape.
    """

    seeds: list[int]
    tasks: list[TaskIdentity]
    left: PlayedRates
    right: PlayedRates

    @property
    def differences(self) -> PlayedRates:
        """Left minus right."""
        return self.left._replace(scores=self.left.scores - self.right.scores)


def _sides(results: StudyResults, claim: Claim, point: Values) -> _Sides:
    left = _runs(results, claim.left, point)
    right = left
    if claim.right:
        right = _runs(results, claim.right, {**point, **claim.right_at})
    seeds = sorted(left.keys() & right.keys())
    names = f"'{claim.left}' and '{claim.right}'"
    if not seeds:
        raise ConfigError(f"no common seed for {names}, {title_of(point)}")
    runs = [left[seed] for seed in seeds]
    partners = [right[seed] for seed in seeds]
    tasks = [results.tasks_of(run) for run in runs]
    if claim.measure == "success":
        are_pairs = tasks == [results.tasks_of(partner) for partner in partners]
        is_one_set = results.study.vary_split or len(set(tasks)) == 1
        if not (are_pairs and is_one_set):
            raise ConfigError(f"{names} were tested on different tasks, {title_of(point)}")
        left_rates = results.rates_of(runs)
        right_rates = results.rates_of(partners)
    else:
        if claim.measure != "same_twice" and not all(run.curve for run in [*runs, *partners]):
            raise ConfigError(f"no learning curves for {names}")
        left_rates = _metrics(claim.measure, runs, partners)
        right_rates = _metrics(claim.measure, partners, partners)
    if not claim.right:
        level = np.full_like(left_rates.scores, claim.than)
        right_rates = left_rates._replace(scores=level)
    return _Sides(seeds, tasks, left_rates, right_rates)


def _measure(results: StudyResults, claim: Claim, point: Values) -> Measured:
    sides = _sides(results, claim, point)
    left = sides.left.mean
    right = sides.right.mean
    low = high = p_value = None
    # An interval over tasks alone would be about two trainings, but the claim is about agents.
    if len(sides.seeds) > 1:
        low, high, p_value = _interval(claim, sides.left, sides.differences)
    return Measured(
        values=point,
        left=left,
        right=right,
        difference=left - right,
        low=low,
        high=high,
        seeds=len(sides.seeds),
        tasks=sides.left.scores.shape[1] if claim.measure == "success" else 0,
        groups=0 if sides.left.groups is None else len(np.unique(sides.left.groups)),
        splits=1 if sides.left.splits is None else len(set(sides.left.splits)),
        # Two seeds give an interval, and too few degrees of freedom for a test.
        p_value=p_value if len(sides.seeds) >= FEWEST_PAIRS else None,
    )


def _runs(results: StudyResults, variant: str, point: Values) -> dict[int, RunResult]:
    """Return a variant's runs by seed; ConfigError without runs, with the first known reason."""
    runs = {run.seed: run for run in results.runs if run.variant == variant and run.values == point}
    if not runs:
        gaps = [gap for gap in results.missing if gap.variant == variant and gap.values == point]
        reason = gaps[0].why if gaps else "not in the study"
        raise ConfigError(f"no runs for '{variant}', {title_of(point)}: {reason}")
    return runs


def _metrics(
    measure: Measure, runs: Sequence[RunResult], partners: Sequence[RunResult]
) -> PlayedRates:
    """Return a value of each run in place of success rates, shape (runs, 1)."""
    values = [_metric(measure, run, partner) for run, partner in zip(runs, partners, strict=True)]
    return PlayedRates(np.array(values)[:, None], None, None)


def _metric(measure: Measure, run: RunResult, partner: RunResult) -> float:
    """Return a run's value of a measure other than success; ``partner`` is the right side's run."""
    if measure == "same_twice":
        return run.terminations["same_twice"]
    if measure == "early":
        early = _EARLY * run.steps
        # The nearest point of the curve; of two equally near ones, the earlier.
        _, success = min(run.curve, key=lambda point: abs(point[0] - early))
        return success
    _, end = partner.curve[-1]
    level = REACHED * end
    # A curve that never gets there counts as all steps: leaving it out would favour the slower
    # side.
    steps = min(steps_to(run.curve, level), run.steps)
    return steps / run.steps


def steps_to(curve: Sequence[tuple[int, float]], level: float) -> float:
    """Return the steps until a curve first reaches a level; infinity if it never does.

    Between two points, the curve is a line.

    Args:
        curve: points (environment steps, success) in ascending order of steps, at least one.
        level: the success to reach.
    """
    first_step, first_value = curve[0]
    if first_value >= level:
        return first_step
    for (before, lower), (step, value) in pairwise(curve):
        if value >= level:
            # Back from the point, by the share of its line that lies above the level.
            return step - (step - before) * (value - level) / (value - lower)
    return math.inf


def _interval(
    claim: Claim, left: PlayedRates, differences: PlayedRates
) -> tuple[float, float, float]:
    """Return the interval of the difference of several seeds, and the p-value of "no difference".

    Args:
        claim: the claim.
        left: the left side.
        differences: left minus right.
    """
    (_, low, high), p_value = crossed_difference(*differences)
    if claim.than is None:
        return low, high, p_value
    if claim.measure == "success":
        # One side is exact, so the interval of the other is that of the difference, moved.
        low, high = (end - claim.than for end in rate_interval(*left))
    # Shares lie in [0, 1]: no interval reaches beyond.
    return max(low, -claim.than), min(high, 1 - claim.than), p_value


def _rule(results: StudyResults, claim: Claim, measured: Sequence[Measured]) -> tuple[Verdict, str]:
    intervals = [(at.low, at.high) for at in measured if at.low is not None and at.high is not None]
    # A claim about several points needs an interval at each of them.
    if len(intervals) < len(measured):
        return "undecided", "one seed shows no variation between seeds"
    if claim.expected == "varies":
        return _varies(results, claim, measured, intervals)
    low, high = intervals[0]
    if claim.expected == "comparable":
        return _comparable(low, high, claim.by)
    if claim.expected == "more":
        return _more(low, high, claim.by, "more", "less")
    # Less is more with the sides exchanged: the interval is mirrored.
    return _more(-high, -low, claim.by, "less", "more")


def _more(low: float, high: float, by: float, word: str, opposite: str) -> tuple[Verdict, str]:
    """Return the verdict on "the left side is more", by the interval of the difference.

    Args:
        low: lower end of the interval.
        high: upper end of the interval.
        by: claimed amount; 0 if the claim names none.
        word: "more", or "less" for a claim whose sides are exchanged.
        opposite: the other of the two words.
    """
    if low > 0:
        if low < by:
            return "differs", f"{word}, but at least {by:g} is not significant at 5 %"
        return "reproduced", f"{word}, by more than {by:g}" if by else word
    if high < 0:
        return "not reproduced", f"it is {opposite}"
    threshold = by or _SAME
    if high < threshold:
        return "not reproduced", f"not {word} by {threshold:g}"
    return "undecided", "the interval is too wide"


def _comparable(low: float, high: float, by: float) -> tuple[Verdict, str]:
    """Return the verdict on "no difference above ``by``", by the interval of the difference."""
    # Comparable is a claim of its own: an interval around 0 that is too wide does not prove it.
    if -by <= low and high <= by:
        return "reproduced", f"closer than {by:g}"
    if low <= 0 <= high:
        return "undecided", "the interval is too wide"
    word = "more" if low > 0 else "less"
    if low > by or high < -by:
        return "not reproduced", f"{word}, by more than {by:g}"
    return "differs", f"{word}, though perhaps by less than {by:g}"


def _varies(
    results: StudyResults,
    claim: Claim,
    measured: Sequence[Measured],
    intervals: Sequence[tuple[float, float]],
) -> tuple[Verdict, str]:
    points = [title_of(at.values) for at in measured]
    above = [point for point, (low, _) in zip(points, intervals, strict=True) if low > 0]
    below = [point for point, (_, high) in zip(points, intervals, strict=True) if high < 0]
    if above and below:
        right = claim.right or f"{claim.than:g}"
        ahead = f"{claim.left} is ahead with {'; '.join(above)}"
        return "reproduced", f"{ahead}, {right} with {'; '.join(below)}"
    if len(measured) in (len(above), len(below)):
        word = "more" if above else "less"
        everywhere = f"{word} at all {counted(len(measured), 'point')}"
        # The same sign everywhere contradicts the claim, unless at least the amount varies.
        pairs = combinations(measured, 2)
        if any(_changes(results, claim, first, second) for first, second in pairs):
            return "differs", f"{everywhere}, but by different amounts"
        return "not reproduced", f"{everywhere}, by amounts without a significant difference at 5 %"
    if all(low >= -_SAME and high <= _SAME for low, high in intervals):
        return "not reproduced", f"no difference of {_SAME:g} anywhere"
    return "undecided", "the intervals are too wide"


def _changes(results: StudyResults, claim: Claim, first: Measured, second: Measured) -> bool:
    """Return whether the difference of the sides changes significantly between two points.

    At points with the same tasks and seeds, trainings of the same seed are compared task by task.
    This removes the variation that both points share, so that smaller changes are found. Other
    tasks have no counterparts, and too few seeds no interval: then the points' own intervals must
    be disjoint.
    """
    first_sides = _sides(results, claim, first.values)
    second_sides = _sides(results, claim, second.values)
    has_same_seeds = first_sides.seeds == second_sides.seeds
    is_paired = has_same_seeds and set(first_sides.tasks) == set(second_sides.tasks)
    if not is_paired or len(first_sides.seeds) < FEWEST_PAIRS:
        greatest_low = max(first.low or 0, second.low or 0)
        least_high = min(first.high or 0, second.high or 0)
        return greatest_low > least_high
    # A value that the claim names is the same at both points, and so cancels in the change.
    difference_claim = msgspec.structs.replace(claim, than=None)
    first_differences = first_sides.differences
    gain = first_differences.scores - second_sides.differences.scores
    change = first_differences._replace(scores=gain)
    low, high, _ = _interval(difference_claim, first_differences, change)
    return low > 0 or high < 0
