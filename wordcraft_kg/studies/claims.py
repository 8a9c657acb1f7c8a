"""Claims about a study's results: each gets a verdict by a fixed rule, with the measured values.

A claim compares two sides: two variants, or a variant and a value. With [l, h] the 95 % interval for the difference
between the sides, a claim of *more, by at least b* (default 0) is

| verdict | if |
|---|---|
| reproduced | l ≥ b, and l > 0 |
| differs | 0 < l < b: right direction, wrong or uncertain amount |
| not reproduced | h < 0, h < b, or (without an amount) h < .02 |
| undecided | otherwise |

For *less* all signs are reversed. *Comparable, closer than b* is reproduced if [l, h] lies within ±b, not reproduced if
it lies beyond ±b, differs if it otherwise excludes 0, and else undecided. *Varies* is reproduced if one grid interval
is above 0 and another below; with one sign everywhere, it differs if the difference surely changes between two points
(in pairs; for other tasks: disjoint intervals) and else is not reproduced; it is not reproduced either if all intervals
lie within ±.02, and else undecided. A claim without runs is *not run*.

Intervals for success are over seeds and over groups of tasks that the split holds out together, such as the tasks of a
goal (:func:`~wordcraft_kg.base.statistics.crossed_difference`). Intervals for figures per run, such as steps, are over
seeds: mean ± t · s / √S, with Student's t. Differences are paired by seed, task and table. Verdicts are not corrected
for multiple claims. With fewer than three seeds, a verdict other than *undecided* is marked as provisional.
"""

from collections.abc import Iterable, Sequence
from itertools import combinations
from typing import Literal

import msgspec
import numpy as np

from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.base.records import Count, Record
from wordcraft_kg.base.statistics import (
    FEWEST_PAIRS,
    Groups,
    Scores,
    crossed_difference,
    rate_interval,
    student_interval,
)
from wordcraft_kg.base.wording import counted
from wordcraft_kg.studies.results import RunResult, StudyResults, steps_to
from wordcraft_kg.studies.study import Claim, Expected, Measure, Values, points_at

Verdict = Literal["reproduced", "differs", "not reproduced", "undecided", "not run"]
_SAME = 0.02
"""Smallest relevant success difference: half the width of a usual interval over tasks."""
_EARLY = 0.1
"""Share of the steps after which early success is measured."""
_REACHED = 0.95
"""Share of a curve's last point that counts as reached; the last percents are noise."""

_MEASURES = {
    "success": "",
    "early": "after a tenth of the steps: ",
    "steps": f"steps to {_REACHED:.0%} of the other's end, as a share of all: ",
    "same_twice": "ends with one entity twice: ",
}


class Measured(Record, frozen=True):
    """The measured values for a claim under fixed grid settings: means over common seeds for both sides.

    The 95 % interval needs two seeds, else None; ``tasks`` is 0 for one value per run. ``groups`` counts the groups of
    tasks that the interval resamples, and is equal to ``tasks`` if each task is a group.
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


class ClaimVerdict(Record, frozen=True):
    """A claim with its verdict, which follows from the measured intervals by the table of this module.

    ``why`` has the reason, ``note`` the known reason for a deviation. The second side may be a value. Several measured
    values belong to a claim that the sign of the difference varies.
    """

    text: str
    source: str
    sides: tuple[str, str]
    is_value: bool
    expected: Expected
    by: float
    measure: Measure
    verdict: Verdict
    why: str
    note: str
    measured: tuple[Measured, ...]


def view_claims(
    results: StudyResults, claims: Iterable[Claim] | None = None
) -> tuple[ClaimVerdict, ...]:
    """Compare claims (default: the study's claims) with results; a claim has a verdict for each grid point."""
    given = results.study.claims if claims is None else claims
    return tuple(entry for claim in given for entry in check_claim(results, claim))


def check_claim(results: StudyResults, claim: Claim) -> list[ClaimVerdict]:
    """Compare a claim with results, and return a verdict for each grid point that the claim is about."""
    figures: list[Measured] = []
    lacking: list[str] = []
    for point in points_at(results.study, claim.at):
        try:
            figures.append(_measure(results, claim, point))
        except ConfigError as error:
            lacking.append(str(error))
    groups: list[tuple[Measured, ...]] = [(measured,) for measured in figures]
    if claim.expected == "varies":
        groups = [tuple(figures)] if len(figures) > 1 else []
    entries = [_verdict(claim, *_rule(results, claim, group), group) for group in groups]
    if not groups and not lacking:
        lacking = ["the study has no results at such points"]
    return entries + [_verdict(claim, "not run", reason, ()) for reason in dict.fromkeys(lacking)]


def _verdict(
    claim: Claim, verdict: Verdict, why: str, measured: tuple[Measured, ...]
) -> ClaimVerdict:
    seeds = min((of.seeds for of in measured), default=FEWEST_PAIRS)
    if verdict != "undecided" and seeds < FEWEST_PAIRS:
        why += f" (provisional: {counted(seeds, 'seed')})"
    note = claim.note if verdict in ("differs", "not reproduced") else ""
    right = claim.right if claim.than is None else f"{claim.than:g}"
    if claim.right_at:
        right += f" with {_point(claim.right_at)}"
    return ClaimVerdict(
        text=claim.text,
        source=claim.source,
        sides=(claim.left, right),
        is_value=claim.than is not None,
        expected=claim.expected,
        by=claim.by,
        measure=claim.measure,
        verdict=verdict,
        why=why,
        note=note,
        measured=measured,
    )


def _point(values: Values) -> str:
    return ", ".join(f"{name} {value}" for name, value in values.items())


def _sides(
    results: StudyResults, claim: Claim, point: Values
) -> tuple[list[int], Scores, Scores, Groups]:
    """Return the common seeds, both sides' figures, and the groups of tasks.

    Figures have the shape (seeds, tasks) for success and else (seeds, 1).
    """
    left = _runs(results, claim.left, point)
    right = _runs(results, claim.right, {**point, **claim.right_at}) if claim.right else left
    pairs = [(left[seed], right[seed]) for seed in sorted(left.keys() & right.keys())]
    _check_runs(results, claim, point, [run for pair in pairs for run in pair])
    a = np.array([_figures(claim.measure, run, other) for run, other in pairs])
    b = np.array([_figures(claim.measure, other, other) for _, other in pairs])
    if not claim.right:
        b = np.full_like(a, claim.than)
    groups = results.groups_of(pairs[0][0]) if claim.measure == "success" else None
    return [left.seed for left, _ in pairs], a, b, groups


def _measure(results: StudyResults, claim: Claim, point: Values) -> Measured:
    seeds, a, b, groups = _sides(results, claim, point)
    low, high = _interval(claim, a, b, groups)
    left, right = float(a.mean()), float(b.mean())
    tasks = a.shape[1] if claim.measure == "success" else 0
    number = tasks if groups is None else len(set(groups))
    return Measured(point, left, right, left - right, low, high, len(seeds), tasks, number)


def _check_runs(
    results: StudyResults, claim: Claim, point: Values, runs: Sequence[RunResult]
) -> None:
    names = f"'{claim.left}' and '{claim.right}'"
    if not runs:
        raise ConfigError(f"no common seed for {names}, {_point(point)}")
    if claim.measure in ("early", "steps") and not all(run.curve for run in runs):
        raise ConfigError(f"no learning curves for {names}")
    if claim.measure == "success" and len({results.tasks_of(run) for run in runs}) > 1:
        raise ConfigError(f"{names} were tested on different tasks, {_point(point)}")


def _runs(results: StudyResults, variant: str, point: Values) -> dict[int, RunResult]:
    runs = {run.seed: run for run in results.runs if run.variant == variant and run.values == point}
    if not runs:
        reasons = [
            lost.why for lost in results.missing if lost.variant == variant and lost.values == point
        ]
        raise ConfigError(
            f"no runs for '{variant}', {_point(point)}: {reasons[0] if reasons else 'not in the study'}"
        )
    return runs


def _figures(measure: Measure, run: RunResult, other: RunResult) -> Sequence[float] | Scores:
    if measure == "success":
        return run.rates
    if measure == "same_twice":
        return [run.terminations["same_twice"]]
    if measure == "early":
        return [min(run.curve, key=lambda point: abs(point[0] - _EARLY * run.steps))[1]]
    level = _REACHED * other.curve[-1][1]
    return [min(steps_to(run.curve, level), run.steps) / run.steps]


def _interval(
    claim: Claim, left: Scores, right: Scores, groups: Groups
) -> tuple[float, float] | tuple[None, None]:
    # An interval over tasks alone would be about two trainings, but the claim is about agents.
    if len(left) == 1:
        return None, None
    if claim.measure == "success" and claim.than is not None:
        low, high = rate_interval(left, groups)
        return low - claim.than, high - claim.than
    if claim.measure == "success":
        return crossed_difference(left - right, groups)[0][1:]
    within = (-1.0, 1.0) if claim.than is None else (-claim.than, 1 - claim.than)
    return student_interval((left - right)[:, 0], within=within) or (None, None)


def _rule(results: StudyResults, claim: Claim, measured: Sequence[Measured]) -> tuple[Verdict, str]:
    intervals = [(of.low, of.high) for of in measured if of.low is not None and of.high is not None]
    if len(intervals) < len(measured):
        return "undecided", "one seed shows no variation between seeds"
    if claim.expected == "varies":
        return _varies(results, claim, measured, intervals)
    low, high = intervals[0]
    if claim.expected == "comparable":
        return _comparable(low, high, claim.by)
    if claim.expected == "more":
        return _more(low, high, claim.by, "more", "less")
    return _more(-high, -low, claim.by, "less", "more")


def _more(low: float, high: float, by: float, word: str, opposite: str) -> tuple[Verdict, str]:
    if low > 0:
        if low >= by:
            small = f", by less than {_SAME:g}" if high < _SAME else ""
            return "reproduced", f"{word}, by more than {by:g}" if by else word + small
        return "differs", f"{word}, but {'not' if high < by else 'not surely'} by {by:g}"
    if high < 0:
        return "not reproduced", f"it is {opposite}"
    if high < (by or _SAME):
        return "not reproduced", f"not {word} by {by or _SAME:g}"
    return "undecided", "the interval is too wide"


def _comparable(low: float, high: float, by: float) -> tuple[Verdict, str]:
    if -by <= low and high <= by:
        return "reproduced", f"closer than {by:g}"
    if low > by or high < -by:
        return "not reproduced", f"{'more' if low > by else 'less'}, by more than {by:g}"
    if low > 0 or high < 0:
        return "differs", f"{'more' if low > 0 else 'less'}, though perhaps by less than {by:g}"
    return "undecided", "the interval is too wide"


def _varies(
    results: StudyResults,
    claim: Claim,
    measured: Sequence[Measured],
    intervals: Sequence[tuple[float, float]],
) -> tuple[Verdict, str]:
    lows, highs = zip(*intervals, strict=True)
    more = [_point(of.values) for of, low in zip(measured, lows, strict=True) if low > 0]
    less = [_point(of.values) for of, high in zip(measured, highs, strict=True) if high < 0]
    if more and less:
        right = claim.right or f"{claim.than:g}"
        return (
            "reproduced",
            f"{claim.left} is ahead with {'; '.join(more)}, {right} with {'; '.join(less)}",
        )
    if len(measured) in (len(more), len(less)):
        everywhere = f"{'more' if more else 'less'} at all {counted(len(measured), 'point')}"
        if any(_changes(results, claim, *pair) for pair in combinations(measured, 2)):
            return "differs", f"{everywhere}, but by different amounts"
        return "not reproduced", f"{everywhere}, by amounts that do not surely differ"
    if min(lows) >= -_SAME and max(highs) <= _SAME:
        return "not reproduced", f"no difference of {_SAME:g} anywhere"
    return "undecided", "the intervals are too wide"


def _changes(results: StudyResults, claim: Claim, one: Measured, other: Measured) -> bool:
    """Return whether the difference of the sides surely changes between two points, paired by seed and task."""
    seeds, *left, groups = _sides(results, claim, one.values)
    others, *right, _ = _sides(results, claim, other.values)
    tasks = [
        {results.tasks_of(run) for run in _runs(results, claim.left, of.values).values()}
        for of in (one, other)
    ]
    common = sorted({*seeds} & {*others})
    if tasks[0] != tasks[1] or len(common) < FEWEST_PAIRS:
        return max(one.low or 0, other.low or 0) > min(one.high or 0, other.high or 0)
    changes = [
        (a - b)[[of.index(seed) for seed in common]]
        for of, (a, b) in ((seeds, left), (others, right))
    ]
    of_differences = msgspec.structs.replace(claim, than=None)
    low, high = _interval(of_differences, changes[0], changes[1], groups)
    return (low or 0) > 0 or (high or 0) < 0


def in_words(claim: ClaimVerdict, measured: Measured, mark: str = "") -> str:
    """Format a claim's measured values as a sentence; ``mark`` surrounds the names of the variants."""
    left, right = (f"{mark}{side}{mark}" for side in claim.sides)
    interval = "" if measured.low is None else f" [{signed(measured.low)}, {signed(measured.high)}]"
    other = claim.sides[1] if claim.is_value else f"{right} {share(measured.right)}"
    size = counted(measured.seeds, "seed")
    if measured.tasks:
        size += f", {counted(measured.tasks, 'task')}"
    if measured.groups < measured.tasks:
        size += f" in {counted(measured.groups, 'group')}"
    sides = f"{left} {share(measured.left)} against {other}"
    return f"{_MEASURES[claim.measure]}{sides}: {signed(measured.difference)}{interval} ({size})"


def share(value: float) -> str:
    """Format a share with three digits and without the leading zero."""
    return f"{value:.3f}".removeprefix("0")


def signed(value: float | None) -> str:
    """Format a difference between shares."""
    return f"{value or 0:+.3f}".replace("0.", ".", 1)
