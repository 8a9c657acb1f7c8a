"""The figures of a study: every variant at every point of the grid, with intervals, and against the reference."""

import math
from collections.abc import Iterator, Sequence
from typing import Annotated, Literal

import msgspec
import numpy as np
from numpy.typing import NDArray

from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.base.records import Count, Record, Share
from wordcraft_kg.base.statistics import (
    correlation,
    crossed_bootstrap,
    holm,
    interquartile_mean,
    interval_p_value,
    performance_profile,
    performance_profile_band,
    probability_of_improvement,
    probability_of_improvement_interval,
    resampled_means,
    stratified_bootstrap,
    wilson_interval,
)
from wordcraft_kg.studies.claims import Judged, view_claims
from wordcraft_kg.studies.results import Missing, PlayedGraph, RunResult, StudyResults
from wordcraft_kg.studies.study import SCORER, Drawing, Value, Values

Interval = tuple[float, float]
TAUS = tuple(i / 50 for i in range(51))
"""Levels of success at which profiles are given."""
EVERYTHING: Values = {"share": 1, "noise": 0}
"""Settings of a scorer that learns from all recipes as they are."""


class StudyCurvePoint(Record, array_like=True):
    """Mean success on test tasks after a number of steps, and its interval over seeds."""

    step: int
    success: float
    low: float | None
    high: float | None


class Comparison(Record):
    """A variant against the reference at a point of the grid.

    Attributes:
        difference: of mean success on test tasks.
        interval: its 95 % interval over seeds and tasks, resampled as pairs: the same seed, and the same task.
        pairs: number of seeds that both have.
        p_better: probability that a run of the variant is better than one of the reference.
        p_better_interval: its 95 % interval over seeds; None for a single seed.
        p_value: of no difference, from the interval.
        p_corrected: the same by Holm, over all comparisons of the study.
    """

    difference: Annotated[float, msgspec.Meta(ge=-1, le=1)]
    interval: Interval
    pairs: Annotated[int, msgspec.Meta(ge=1)]
    p_better: Share
    p_better_interval: Interval | None
    p_value: Share
    p_corrected: Share


class VariantFigures(Record):
    """The figures of a variant at a point of the grid.

    Attributes:
        seeds: seeds of its runs.
        success: success of each run on test tasks.
        mean: their mean.
        iqm: mean of the middle half of them.
        seed_interval: 95 % interval of the mean over seeds, for the same tasks; None for a single seed.
        interval: 95 % interval of the mean over seeds and tasks; over tasks alone for a single seed.
        iqm_interval: 95 % interval of the IQM over seeds; None for a single seed.
        by_plan: share of episodes in which the last pair of a plan made the goal.
        train: mean success on train tasks; None if it was not measured.
        mrr: mean leak-free MRR of the scorers on test triples; None without a scorer that has not seen them.
        mrr_range: the least and the greatest of them.
        comparison: against the reference; None for the reference itself, and if there is nothing to pair.
        reached: steps until the mean curve reaches the final success of the reference's; None if it never does, or
            there is no reference to reach.
        reached_interval: its 95 % interval over seeds, None for never; None for a single seed.
        curve: success during training.
        runs: addresses of the run folders.
        seconds: mean duration of a training.
        steps: steps of a training.
    """

    variant: str
    seeds: tuple[int, ...]
    success: Annotated[tuple[Share, ...], msgspec.Meta(min_length=1)]
    mean: Share
    iqm: Share
    seed_interval: Interval | None
    interval: Interval
    iqm_interval: Interval | None
    by_plan: Share
    train: Share | None
    mrr: Share | None
    mrr_range: Interval | None
    comparison: Comparison | None
    reached: Count | None
    reached_interval: tuple[Count | None, Count | None] | None
    curve: tuple[StudyCurvePoint, ...]
    runs: tuple[str, ...]
    seconds: float
    steps: Count


class PointFigures(Record):
    """All variants at a point of the grid.

    Attributes:
        values: the grid's values, by setting.
        title: the same in words.
        graphs: graphs that were played on, in the order of the variants; usually one.
        tasks: number of test tasks.
        draws: draws of distractors for each.
        variants: variants that have runs, in the order of the study.
    """

    values: Values
    title: str
    graphs: tuple[PlayedGraph, ...]
    tasks: Count
    draws: Count
    variants: tuple[VariantFigures, ...]


class Profile(Record):
    """Share of a variant's runs whose success is above each of the study's taus; each run of any point counts once.

    Attributes:
        shares: by tau.
        low: lower bound of the 95 % band over seeds at each tau; empty for a single seed.
        high: upper bound.
    """

    variant: str
    shares: tuple[Share, ...]
    low: tuple[Share, ...]
    high: tuple[Share, ...]


class Correlation(Record, array_like=True):
    """A correlation over cells, and its 95 % interval, resampling cells."""

    value: float
    low: float
    high: float


class DosePoint(Record):
    """Success and MRR of a variant at a point of the grid.

    Attributes:
        label: what tells it from the other points of its line.
        mrr: mean MRR of its scorers.
        mrr_range: the least and the greatest.
        success: mean success.
        interval: its 95 % interval over seeds and tasks.
        reached: see :attr:`VariantFigures.reached`.
    """

    label: str
    variant: str
    mrr: Share
    mrr_range: Interval
    success: Share
    interval: Interval
    reached: Count | None


class Dose(Record):
    """Success against the MRR of the scorer, where all else is equal.

    Attributes:
        values: values of the grid's settings that are not the scorer's.
        in_sample: whether train tasks were scored by a model that had seen them.
        points: by ascending MRR.
        pearson: correlation of MRR and success over the points; None for fewer than three.
        spearman: rank correlation.
        steps_spearman: rank correlation of MRR and :attr:`DosePoint.reached`, where never counts as the latest.
        without: success of the reference, if it has no scorer.
    """

    values: Values
    in_sample: bool
    points: tuple[DosePoint, ...]
    pearson: Correlation | None
    spearman: Correlation | None
    steps_spearman: Correlation | None
    without: Share | None


class StudyView(Record):
    """The report of a study (``report.json``).

    Attributes:
        name: name of the study.
        reference: the variant with which the others are compared.
        points: points of the grid that have runs.
        taus: levels of the profiles.
        profiles: one for each variant.
        doses: for studies of the drawing "dose": one for each way of scoring train tasks and each point of the other
            settings; otherwise none.
        comparisons: number of comparisons that p-values are corrected for.
        claims: what the study says comes out, and whether it does.
    """

    format: Literal["wordcraft-kg study report 1"]
    name: str
    title: str
    about: str
    source: str
    command: str
    drawing: Drawing
    reference: str
    points: Annotated[tuple[PointFigures, ...], msgspec.Meta(min_length=1)]
    taus: tuple[Share, ...]
    profiles: tuple[Profile, ...]
    doses: tuple[Dose, ...]
    comparisons: Count
    claims: tuple[Judged, ...]
    missing: tuple[Missing, ...]
    versions: dict[str, str]
    hours: float


Runs = dict[str, list[RunResult]]
"""Runs of a point of the grid, by variant."""


def view_study(results: StudyResults) -> StudyView:
    """Compute all figures of a study.

    Raises:
        ConfigError: if there are no runs, or runs of one cell were played on different graphs, splits or tasks: their
            mean would be a figure of nothing.
    """
    study = results.study
    reference = study.reference or next(iter(study.variants))
    cells = _cells(results)
    points = [_point(results, values, runs, reference) for values, runs in cells]
    points = _corrected(points)
    compared = [entry.comparison for point in points for entry in point.variants if entry.comparison]
    return StudyView(
        format="wordcraft-kg study report 1",
        name=results.name,
        title=study.title,
        about=study.about,
        source=study.source,
        command=results.command,
        drawing=study.drawing,
        reference=reference,
        points=tuple(points),
        taus=TAUS,
        profiles=tuple(_profiles([runs for _, runs in cells])),
        doses=tuple(_doses(results, points, reference)) if study.drawing == "dose" else (),
        comparisons=len(compared),
        claims=view_claims(results).claims,
        missing=results.missing,
        versions=results.versions,
        hours=results.hours,
    )


def title_of(values: Values) -> str:
    """Return a point of the grid in words.

    Example:
        >>> title_of({"distractors": 8, "split": "by-goal", "scorer.share": 0.5})
        '8 distractors, split by-goal, scorer.share 0.5'
    """
    return ", ".join(_worded(name, value) for name, value in values.items())


def _worded(name: str, value: Value) -> str:
    if name == "distractors":
        return f"{value} distractor{'s' * (value != 1)}"
    if name == "book":
        return str(value)
    return f"{name} {str(value).lower() if isinstance(value, bool) else value}"


def _cells(results: StudyResults) -> list[tuple[Values, Runs]]:
    """Return the points of the grid in the order of their runs, each with its runs by variant in the study's order."""
    if not results.runs:
        why = f" The first: {results.missing[0].why.rstrip('.')}." if results.missing else ""
        raise ConfigError(
            f"study '{results.name}' has no finished run, {len(results.missing):,} missing.{why} Run it first: "
            f"{results.command}"
        )
    found: dict[bytes, tuple[Values, Runs]] = {}
    for run in results.runs:
        _, runs = found.setdefault(msgspec.json.encode(run.values, order="sorted"), (run.values, {}))
        runs.setdefault(run.variant, []).append(run)
    order = {name: number for number, name in enumerate(results.study.variants)}
    cells = [
        (values, dict(sorted(runs.items(), key=lambda item: order.get(item[0], len(order)))))
        for values, runs in found.values()
    ]
    for values, runs in cells:
        for variant, members in runs.items():
            _check_alike(results, f"'{variant}'" + (f" with {title_of(values)}" if values else ""), members)
    return cells


def _check_alike(results: StudyResults, cell: str, members: list[RunResult]) -> None:
    """Refuse to average runs that did not play the same tasks, or one run twice."""
    first = members[0]
    for run in members[1:]:
        one, other = results.graphs[first.graph], results.graphs[run.graph]
        if (one.hash, one.split) != (other.hash, other.split):
            what = "graphs" if one.hash != other.hash else "splits"
            raise ConfigError(
                f"{cell}: seeds {first.seed} and {run.seed} were played on different {what} ({_named(one)}; "
                f"{_named(other)}), so their figures cannot be averaged. Make what differs a part of the grid, such as "
                "`book`, `split` or `split_seed`, or run them again on one graph."
            )
        if (len(run.won), run.draws) != (len(first.won), first.draws):
            raise ConfigError(
                f"{cell}: seeds {first.seed} and {run.seed} were judged on {len(first.won):,} tasks of {first.draws} "
                f"draws and on {len(run.won):,} of {run.draws}, so their figures cannot be averaged. Run one again."
            )
    seeds = [run.seed for run in members]
    if len(set(seeds)) < len(seeds):
        twice = next(seed for seed in seeds if seeds.count(seed) > 1)
        raise ConfigError(
            f"{cell}: seed {twice} is there twice (runs {', '.join(run.run for run in members if run.seed == twice)}); "
            "something else than the seed differs between them. Make it a part of the variants."
        )
    for run in members:
        if "test" not in run.success or "test" not in run.by_plan or not run.won:
            raise ConfigError(f"{cell}, seed {run.seed}: no test tasks were played, so there is nothing to compare.")


def _named(graph: PlayedGraph) -> str:
    return f"{graph.name} {graph.hash[:12]}, {graph.kind} split {graph.split[:12]}"


def _point(results: StudyResults, values: Values, runs: Runs, reference: str) -> PointFigures:
    base = runs.get(reference, [])
    variants = [_figures(results, name, members, base) for name, members in runs.items()]
    graphs = {members[0].graph: results.graphs[members[0].graph] for members in runs.values()}
    first = next(iter(runs.values()))[0]
    title = title_of(values) or ", ".join(f"{graph.name}, {graph.kind}" for graph in graphs.values())
    return PointFigures(values, title, tuple(graphs.values()), len(first.won), first.draws, tuple(variants))


def _figures(results: StudyResults, variant: str, members: list[RunResult], base: list[RunResult]) -> VariantFigures:
    success = [run.success["test"] for run in members]
    table = _table(members)
    train = [run.success["train"] for run in members if "train" in run.success]
    mrr = [run.mrr for run in members if run.mrr is not None]
    is_reference = bool(base) and members is base
    comparison = None if is_reference or not _is_paired(results, members, base) else _comparison(members, base)
    reached, reached_interval = _reached(members, base)
    return VariantFigures(
        variant=variant,
        seeds=tuple(run.seed for run in members),
        success=tuple(success),
        mean=_mean(success),
        iqm=interquartile_mean(success),
        seed_interval=stratified_bootstrap(success, np.mean),
        interval=_interval(table),
        iqm_interval=stratified_bootstrap(success, interquartile_mean),
        by_plan=_mean([run.by_plan["test"] for run in members]),
        train=_mean(train) if len(train) == len(members) else None,
        mrr=_mean(mrr) if mrr else None,
        mrr_range=(min(mrr), max(mrr)) if mrr else None,
        comparison=comparison,
        reached=reached,
        reached_interval=reached_interval,
        curve=_curve(members),
        runs=tuple(run.run for run in members),
        seconds=_mean([run.seconds for run in members]),
        steps=members[0].steps,
    )


def _mean(values: Sequence[float]) -> float:
    return math.fsum(values) / len(values)


def _table(members: Sequence[RunResult]) -> NDArray[np.float64]:
    """Return the success rate of each run on each test task, shape (S, K)."""
    return np.array([run.rates for run in members])


def _interval(table: NDArray[np.float64]) -> Interval:
    """Return the interval of the mean over seeds and tasks; Wilson's for the tasks where nothing varies."""
    if np.ptp(table) == 0:
        return wilson_interval(float(table[0].sum()), table.shape[1])
    return crossed_bootstrap(table)


def _is_paired(results: StudyResults, members: list[RunResult], base: list[RunResult]) -> bool:
    """Whether two variants played the same tables, with at least one seed in common."""
    if not base or not {run.seed for run in members} & {run.seed for run in base}:
        return False
    played = [(results.graphs[run.graph], len(run.won), run.draws) for run in (members[0], base[0])]
    ours, theirs = ((graph.hash, graph.split, tasks, draws) for graph, tasks, draws in played)
    return ours == theirs


def _comparison(members: list[RunResult], base: list[RunResult]) -> Comparison:
    by_seed = {run.seed: run for run in base}
    pairs = [(run, by_seed[run.seed]) for run in members if run.seed in by_seed]
    differences = _table([run for run, _ in pairs]) - _table([run for _, run in pairs])
    ours, theirs = ([run.success["test"] for run in runs] for runs in (members, base))
    difference, interval = float(differences.mean()), crossed_bootstrap(differences)
    p_value = interval_p_value(difference, interval)
    return Comparison(
        difference=difference,
        interval=interval,
        pairs=len(pairs),
        p_better=probability_of_improvement(ours, theirs),
        p_better_interval=probability_of_improvement_interval(ours, theirs),
        p_value=p_value,
        p_corrected=p_value,
    )


def _corrected(points: Sequence[PointFigures]) -> list[PointFigures]:
    """Return the points with p-values corrected over all of them."""
    found = [entry.comparison for point in points for entry in point.variants]
    corrected = iter(holm([comparison.p_value for comparison in found if comparison is not None]))

    def with_p(entry: VariantFigures) -> VariantFigures:
        if entry.comparison is None:
            return entry
        comparison = msgspec.structs.replace(entry.comparison, p_corrected=next(corrected))
        return msgspec.structs.replace(entry, comparison=comparison)

    return [msgspec.structs.replace(point, variants=tuple(map(with_p, point.variants))) for point in points]


def _curves(members: Sequence[RunResult]) -> tuple[list[int], NDArray[np.float64]]:
    """Return the steps at which all runs have a point, and their success, shape (S, T)."""
    rows = [dict(run.curve) for run in members]
    steps = sorted(set.intersection(*map(set, rows)))
    return steps, np.array([[row[step] for step in steps] for row in rows])


def _curve(members: Sequence[RunResult]) -> tuple[StudyCurvePoint, ...]:
    steps, table = _curves(members)
    if not steps:
        return ()
    means = table.mean(axis=0).tolist()
    if len(members) == 1:
        return tuple(StudyCurvePoint(step, mean, None, None) for step, mean in zip(steps, means, strict=True))
    low, high = np.quantile(resampled_means(table), [0.025, 0.975], axis=0).tolist()
    return tuple(map(StudyCurvePoint, steps, means, low, high))


def _reached(
    members: list[RunResult], base: list[RunResult]
) -> tuple[int | None, tuple[int | None, int | None] | None]:
    """Return when the mean curve reaches the last point of the reference's mean curve, and the interval over seeds."""
    if not base:
        return None, None
    steps, table = _curves(members)
    goal_steps, goal = _curves(base)
    if not steps or not goal_steps:
        return None, None
    places = np.array([*steps, np.inf])

    def first(means: NDArray[np.float64], wanted: NDArray[np.float64]) -> NDArray[np.float64]:
        hit = means >= wanted[:, None] - 1e-12
        return np.asarray(places[np.where(hit.any(axis=1), hit.argmax(axis=1), len(steps))])

    seen = first(table.mean(axis=0)[None], goal.mean(axis=0)[-1:])[0]
    if len(members) == 1 or len(base) == 1:
        return _steps(seen), None
    # The same runs are resampled for the goal and the curve where a variant is compared with itself.
    goals = resampled_means(goal[:, -1:], seed=0)[:, 0]
    drawn = np.sort(first(resampled_means(table, seed=0 if members is base else 1), goals))
    low, high = np.quantile(drawn, [0.025, 0.975], method="nearest")
    return _steps(seen), (_steps(low), _steps(high))


def _steps(value: float) -> int | None:
    return int(value) if math.isfinite(value) else None


def _profiles(cells: Sequence[Runs]) -> Iterator[Profile]:
    """Yield the profile of each variant over all points where it has runs, with the seeds that all of these have."""
    for variant in dict.fromkeys(name for runs in cells for name in runs):
        # The same trainings may stand at several points, such as those of agents without a scorer.
        distinct = {tuple(run.run for run in runs[variant]): runs[variant] for runs in cells if variant in runs}
        of = [{run.seed: run.success["test"] for run in members} for members in distinct.values()]
        seeds = sorted(set.intersection(*map(set, of)))
        if not seeds:
            continue
        table = [[found[seed] for found in of] for seed in seeds]
        band = performance_profile_band(table, TAUS)
        low, high = ((), ()) if band is None else band.tolist()
        yield Profile(variant, tuple(performance_profile(table, TAUS).tolist()), tuple(low), tuple(high))


def _doses(results: StudyResults, points: Sequence[PointFigures], reference: str) -> Iterator[Dose]:
    """Yield the dose-response of each way of scoring train tasks, at each point of the settings that no scorer has."""
    groups: dict[bytes, tuple[Values, bool, list[DosePoint], list[float]]] = {}
    for point in points:
        others = {name: value for name, value in point.values.items() if not name.startswith(f"{SCORER}.")}
        dose = {name: value for name, value in point.values.items() if name not in others}
        without = [entry.mean for entry in point.variants if entry.variant == reference and entry.mrr is None]
        for entry in point.variants:
            if entry.mrr is None or entry.mrr_range is None:
                continue
            settings = {**results.study.settings, **point.values, **results.study.variants.get(entry.variant, {})}
            in_sample = settings.get("in_sample") is True
            key = msgspec.json.encode((others, in_sample), order="sorted")
            _, _, found, bare = groups.setdefault(key, (others, in_sample, [], []))
            named = DosePoint(
                label=_label(dose, entry.variant),
                variant=entry.variant,
                mrr=entry.mrr,
                mrr_range=entry.mrr_range,
                success=entry.mean,
                interval=entry.interval,
                reached=entry.reached,
            )
            found.append(named)
            bare += without
    for values, in_sample, found, bare in groups.values():
        mrr, success = [at.mrr for at in found], [at.success for at in found]
        latest = 1 + max((at.reached or 0 for at in found), default=0)
        reached = [latest if at.reached is None else at.reached for at in found]
        yield Dose(
            values=values,
            in_sample=in_sample,
            points=tuple(sorted(found, key=lambda at: (at.mrr, at.label))),
            pearson=_correlation(mrr, success, "pearson"),
            spearman=_correlation(mrr, success, "spearman"),
            steps_spearman=_correlation(mrr, reached, "spearman"),
            without=_mean(bare) if bare else None,
        )


def _correlation(x: Sequence[float], y: Sequence[float], kind: Literal["pearson", "spearman"]) -> Correlation | None:
    found = correlation(x, y, kind)
    return Correlation(*found) if found else None


def _label(dose: Values, variant: str) -> str:
    """Return the settings of a scorer that are not those of one that learns from everything."""
    values = {name.removeprefix(f"{SCORER}."): value for name, value in dose.items()}
    told = {name: value for name, value in values.items() if value != EVERYTHING.get(name)} or values
    shown = [f"{name} {value:g}" if isinstance(value, float) else f"{name} {value}" for name, value in told.items()]
    return ", ".join(shown if told is not values else shown[:1]) or variant
