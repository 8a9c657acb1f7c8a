"""Summary of a study's results: each variant at each grid point.

It has means, intervals, differences to the reference, and success by scorer MRR.
"""

from collections.abc import Sequence
from itertools import chain
from statistics import fmean
from typing import Annotated, Literal

import msgspec
from msgspec.structs import replace

from wordcraft_kg.base import ConfigError, Count, Record, Share
from wordcraft_kg.base.statistics import (
    FEWEST_PAIRS,
    crossed_difference,
    holm,
    rate_interval,
)
from wordcraft_kg.evaluation.agent_metrics import CurvePoint, Interval, mean_curve
from wordcraft_kg.graphs.graph_folder import PlayedGraph
from wordcraft_kg.studies.claims import ClaimVerdict, view_claims
from wordcraft_kg.studies.results import Missing, Origin, RunResult, StudyResults
from wordcraft_kg.studies.study import Study, Value, Values, title_of


class VariantComparison(Record):
    """A variant compared with the study's reference variant under the same grid settings.

    Attributes:
        difference: mean success on test tasks, variant minus reference.
        interval: 95 % interval of the difference over seeds and groups of tasks; the same seed and
            the same task are pairs.
        p_value: of no difference, the level at which the interval reaches 0; None below three
            pairs, where a p-value would rest on one degree of freedom.
        p_corrected: the p-value with Holm's correction over all comparisons in the study, or None.
    """

    difference: Annotated[float, msgspec.Meta(ge=-1, le=1)]
    interval: Interval
    p_value: Share | None
    p_corrected: Share | None


class VariantMetrics(Record):
    """Results of a variant under fixed grid settings; all intervals are 95 % intervals.

    Attributes:
        variant: name of the variant.
        seeds: seeds of its runs.
        success: success rate of each run on test tasks.
        mean: mean of ``success``.
        interval: interval for ``mean`` over seeds and groups of tasks, such as goals; over tasks
            for a single seed; over splits if each run has its own.
        train: mean success on train tasks; None if not measured for every run.
        mrr: MRR of each run's scorer on test triples outside training; empty without a scorer, or
            if the scorers have seen these triples.
        comparison: difference to the reference; None for the reference, and without common seeds or
            tasks.
        curve: mean success at the steps that the curves of all runs have, with intervals over
            seeds.
        steps: environment steps of a run.
    """

    variant: str
    seeds: tuple[int, ...]
    success: Annotated[tuple[Share, ...], msgspec.Meta(min_length=1)]
    mean: Share
    interval: Interval
    train: Share | None
    mrr: tuple[Share, ...]
    comparison: VariantComparison | None
    curve: tuple[CurvePoint, ...]
    steps: Count


class PointMetrics(Record):
    """Results for all variants at a grid point.

    Attributes:
        values: grid settings of the point.
        title: the settings in words; graph and split without a grid.
        graphs: graphs with which the variants were evaluated, in the order of the variants; usually
            one.
        tasks: number of test tasks, of all splits together.
        distractor_seeds: episodes of each task, with other distractors each.
        variants: results of the variants that have runs, in the order of the study.
    """

    values: Values
    title: str
    graphs: tuple[PlayedGraph, ...]
    tasks: Count
    distractor_seeds: Count
    variants: tuple[VariantMetrics, ...]


def metrics_of(
    results: StudyResults,
    variant: str,
    members: list[RunResult],
    base: list[RunResult],
) -> VariantMetrics:
    """Summarise the runs of a variant at a grid point, and compare them with the reference.

    Args:
        results: the study, which knows the groups of test tasks.
        variant: name of the variant.
        members: the variant's runs, at least one, all on the same test tasks or on a split each.
        base: runs of the reference at the same point; empty if there are none. The reference itself
            is recognised by being the same list.
    """
    success = [run.success["test"] for run in members]
    rates = results.rates_of(members)
    # Players without training play no train tasks.
    train = [run.success["train"] for run in members if "train" in run.success]
    # Means that do not depend on the order of the values.
    return VariantMetrics(
        variant=variant,
        seeds=tuple(run.seed for run in members),
        success=tuple(success),
        mean=fmean(success),
        interval=rate_interval(*rates),
        # A mean of some runs would stand beside the success of all.
        train=fmean(train) if len(train) == len(members) else None,
        mrr=tuple(run.mrr for run in members if run.mrr is not None),
        comparison=_comparison(results, members, base),
        curve=tuple(mean_curve(dict(run.curve) for run in members)),
        steps=members[0].steps,
    )


def _comparison(
    results: StudyResults,
    members: list[RunResult],
    base: list[RunResult],
) -> VariantComparison | None:
    # Only the same task, with the same distractors, makes a pair.
    partners = {(run.seed, results.tasks_of(run)): run for run in base}
    keys = [(run.seed, results.tasks_of(run)) for run in members]
    pairs = [
        (run, partners[key]) for run, key in zip(members, keys, strict=True) if key in partners
    ]
    if members is base or not pairs:
        return None
    rates = results.rates_of([partner for _, partner in pairs])
    differences = results.rates_of([run for run, _ in pairs]).scores - rates.scores
    (difference, low, high), exact = crossed_difference(differences, rates.groups, rates.splits)
    p_value = exact if len(pairs) >= FEWEST_PAIRS else None
    # Holm's correction needs all comparisons of the study; the summary of the study fills it in.
    return VariantComparison(difference, (low, high), p_value, p_corrected=p_value)


class StudyView(Record):
    """All numbers in a study report (``report.json``).

    Attributes:
        format: name and version of the file format.
        name: name of the study in its results folder.
        study: the study's file, with the changes of the command line.
        command: the command that ran the study.
        reference: the variant that all others are compared with.
        points: results at each grid point that has runs, in the order of the runs.
        comparisons: number of comparisons with a p-value; Holm's correction is over these.
        claims: the study's claims with their verdicts.
        missing: trainings without results, with reasons.
        hours: training time in the results folder.
        origins: platforms and package versions of the trainings.
    """

    format: Literal["wordcraft-kg study report 2"]
    name: str
    study: Study
    command: str
    reference: str
    points: Annotated[tuple[PointMetrics, ...], msgspec.Meta(min_length=1)]
    comparisons: Count
    claims: tuple[ClaimVerdict, ...]
    missing: tuple[Missing, ...]
    hours: float
    origins: tuple[Origin, ...]

    @property
    def resampled(self) -> str:
        """What the intervals of success are about, in words."""
        return "splits" if self.study.vary_split else "seeds and tasks"


Runs = dict[str, list[RunResult]]
"""Agent runs with the same grid settings, by variant."""


def view_study(results: StudyResults) -> StudyView:
    """Summarise a study's results.

    Raises:
        ConfigError: if no run has finished.
    """
    study = results.study
    reference = study.reference or next(iter(study.variants))
    points = [_point(results, values, runs, reference) for values, runs in _cells(results)]
    comparisons, corrected = _corrected(points)
    return StudyView(
        format="wordcraft-kg study report 2",
        name=results.name,
        study=study,
        command=results.command,
        reference=reference,
        points=corrected,
        comparisons=comparisons,
        claims=view_claims(results, study.claims),
        missing=results.missing,
        hours=results.hours,
        origins=results.origins,
    )


def _cells(results: StudyResults) -> list[tuple[Values, Runs]]:
    """Return the grid points with their runs by variant, in the order of the study.

    Raises:
        ConfigError: if no run is finished.
    """
    if not results.runs:
        reason = ""
        if results.missing:
            reason = f" The first: {results.missing[0].why.rstrip('.')}."
        raise ConfigError(
            f"study '{results.name}' has no finished run, {len(results.missing):,} missing.{reason}"
            f" Run the study first: {results.command}"
        )
    points: dict[tuple[tuple[str, Value], ...], tuple[Values, Runs]] = {}
    # Results are listed by grid point and variant, in the order of the study.
    for run in results.runs:
        _, runs = points.setdefault(tuple(run.values.items()), (run.values, {}))
        runs.setdefault(run.variant, []).append(run)
    return list(points.values())


def _point(results: StudyResults, values: Values, runs: Runs, reference: str) -> PointMetrics:
    base = runs.get(reference, [])
    every_run = list(chain.from_iterable(runs.values()))
    numbers = dict.fromkeys(run.graph for run in every_run)
    graphs = [results.graphs[number] for number in numbers]
    names = dict.fromkeys(f"{graph.name}, {graph.kind}" for graph in graphs)
    return PointMetrics(
        values=values,
        title=title_of(values) or ", ".join(names),
        graphs=tuple(graphs),
        # A variant that lacks a training lacks the tasks of its split.
        tasks=max(results.rates_of(members).scores.shape[1] for members in runs.values()),
        distractor_seeds=every_run[0].distractor_seeds,
        variants=tuple(metrics_of(results, name, members, base) for name, members in runs.items()),
    )


def _corrected(points: Sequence[PointMetrics]) -> tuple[int, tuple[PointMetrics, ...]]:
    """Apply Holm's correction over all comparisons of the study, which a reader sees together.

    Returns:
        The number of comparisons with a p-value, and the points with corrected p-values.
    """
    entries = chain.from_iterable(point.variants for point in points)
    comparisons = [entry.comparison for entry in entries if entry.comparison is not None]
    p_values = [each.p_value for each in comparisons if each.p_value is not None]
    # In the same order as the values.
    corrected = iter(holm(p_values))

    def with_p(entry: VariantMetrics) -> VariantMetrics:
        if entry.comparison is None or entry.comparison.p_value is None:
            return entry
        return replace(entry, comparison=replace(entry.comparison, p_corrected=next(corrected)))

    return len(p_values), tuple(
        replace(point, variants=tuple(map(with_p, point.variants))) for point in points
    )
