"""Summary of a study's results.

It has all variants for all grid settings, with intervals and differences to the reference.
"""

from collections.abc import Sequence
from typing import Annotated, Literal

import msgspec

from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.base.records import Count, Record
from wordcraft_kg.base.statistics import holm
from wordcraft_kg.studies.claims import ClaimVerdict, view_claims
from wordcraft_kg.studies.results import Missing, Origin, RunResult, StudyResults
from wordcraft_kg.studies.study import Drawing, Value, Values
from wordcraft_kg.studies.variants import (
    PointMetrics,
    ScorerScatter,
    VariantMetrics,
    metrics_of,
    scatters_of,
)


class StudyView(Record):
    """All numbers in a study report (``report.json``).

    Attributes:
        format: name and version of the file format.
        name: name of the study in its results folder.
        title: what is compared, in a line.
        about: question of the study, and how to read its results.
        source: publication and place of the comparison, such as a figure of the paper.
        command: the command that ran the study.
        drawing: kind of picture.
        reference: the variant that all others are compared with.
        points: results at each grid point that has runs, in the order of the runs.
        scatters: success by the scorers' MRR; empty unless ``drawing`` is "scatter".
        comparisons: number of comparisons with a p-value; Holm's correction is over these.
        claims: the study's claims with their verdicts.
        missing: trainings without results, with reasons.
        versions: package versions of the trainings; the last one's, if several were used.
        hours: training time in the results folder.
        origins: platforms and package versions of the trainings.
    """

    format: Literal["wordcraft-kg study report 1"]
    name: str
    title: str
    about: str
    source: str
    command: str
    drawing: Drawing
    reference: str
    points: Annotated[tuple[PointMetrics, ...], msgspec.Meta(min_length=1)]
    scatters: tuple[ScorerScatter, ...]
    comparisons: Count
    claims: tuple[ClaimVerdict, ...]
    missing: tuple[Missing, ...]
    versions: dict[str, str]
    hours: float
    origins: tuple[Origin, ...] = ()


Runs = dict[str, list[RunResult]]
"""Agent runs with the same grid settings, by variant."""


def view_study(results: StudyResults) -> StudyView:
    """Summarise a study's results.

    Raises:
        ConfigError: if no run has finished, or runs of a variant at a grid point were evaluated
            with other graphs or tasks, or share a seed: a mean over them would describe nothing.
    """
    study = results.study
    reference = study.reference or next(iter(study.variants))
    points = [_point(results, values, runs, reference) for values, runs in _cells(results)]
    points = _corrected(points)
    is_scatter = study.drawing == "scatter"
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
        scatters=tuple(scatters_of(results, points, reference)) if is_scatter else (),
        comparisons=len(_p_values(points)),
        claims=view_claims(results),
        missing=results.missing,
        versions=results.versions,
        hours=results.hours,
        origins=results.origins,
    )


def title_of(values: Values) -> str:
    """Describe grid settings in words, such as ``8 distractors, split by-goal``."""
    return ", ".join(_worded(name, value) for name, value in values.items())


def _worded(name: str, value: Value) -> str:
    if name == "distractors":
        return f"{value} distractor" if value == 1 else f"{value} distractors"
    if name == "book":
        return str(value)
    # As in the study's file, where truth values are written in small letters.
    shown = str(value).lower() if isinstance(value, bool) else value
    return f"{name} {shown}"


def _cells(results: StudyResults) -> list[tuple[Values, Runs]]:
    """Return the grid points with their runs by variant, in the order of the study.

    Raises:
        ConfigError: if no run is finished, or runs of a variant at a point differ in their graphs
            or tasks.
    """
    missing = results.missing
    if not results.runs:
        why = ""
        if missing:
            first = missing[0].why.rstrip(".")
            why = f" The first: {first}."
        raise ConfigError(
            f"study '{results.name}' has no finished run, {len(missing):,} missing.{why} "
            f"Run the study first: {results.command}"
        )
    points: dict[bytes, tuple[Values, Runs]] = {}
    for run in results.runs:
        # Sorted: the order of settings in a file does not make another point.
        key = msgspec.json.encode(run.values, order="sorted")
        _, runs = points.setdefault(key, (run.values, {}))
        runs.setdefault(run.variant, []).append(run)
    # An interrupted study may have runs in another order than its file.
    order = {name: number for number, name in enumerate(results.study.variants)}
    cells: list[tuple[Values, Runs]] = []
    for values, runs in points.values():
        # Variants that the study does not name any more come last.
        names = sorted(runs, key=lambda name: order.get(name, len(order)))
        in_order = {name: runs[name] for name in names}
        cells.append((values, in_order))
    for values, runs in cells:
        where = f" with {title_of(values)}" if values else ""
        for variant, members in runs.items():
            cell = f"'{variant}'{where}"
            _check_alike(results, cell, members)
    return cells


def _check_alike(results: StudyResults, cell: str, members: list[RunResult]) -> None:
    """Check that runs of a variant at a grid point can be averaged.

    Args:
        results: the study, which knows the graphs.
        cell: name of variant and point, for the error.
        members: the runs.

    Raises:
        ConfigError: if graphs, splits or tasks differ, or a seed occurs twice.
    """
    first = members[0]
    seeds: set[int] = set()
    for run in members:
        # A mean over seeds is about one set of tasks.
        if results.tasks_of(run) != results.tasks_of(first):
            raise ConfigError(
                f"{cell}: seeds {first.seed} and {run.seed} were played on different graphs, "
                f"splits or tasks ({_played(results, first)}; {_played(results, run)}), so their "
                "results cannot be averaged. Add the differing setting to the grid, such as "
                "`book`, `split` or `split_seed`, or repeat the older run."
            )
        # Two runs of one seed are paired with one run of the reference, and would count twice.
        if run.seed in seeds:
            raise ConfigError(
                f"{cell}: seed {run.seed} occurs twice; another setting than the seed differs. Add "
                "that setting to the variants."
            )
        seeds.add(run.seed)


def _played(results: StudyResults, run: RunResult) -> str:
    graph = results.graphs[run.graph].in_words
    return f"{graph}, {len(run.won):,} tasks, {run.distractor_seeds} distractor seeds"


def _point(results: StudyResults, values: Values, runs: Runs, reference: str) -> PointMetrics:
    base = runs.get(reference, [])
    variants = []
    graphs = {}
    for name, members in runs.items():
        variants.append(metrics_of(results, name, members, base))
        # All runs of a variant at a point have one graph, see `_check_alike`.
        number = members[0].graph
        graphs[number] = results.graphs[number]
    first = next(iter(runs.values()))[0]
    title = title_of(values)
    if not values:
        title = ", ".join(f"{graph.name}, {graph.kind}" for graph in graphs.values())
    return PointMetrics(
        values=values,
        title=title,
        graphs=tuple(graphs.values()),
        tasks=len(first.won),
        distractor_seeds=first.distractor_seeds,
        variants=tuple(variants),
    )


def _p_values(points: Sequence[PointMetrics]) -> list[float]:
    """Return all p-values of a study, in the order of points and variants."""
    found: list[float] = []
    for point in points:
        for entry in point.variants:
            if entry.comparison is not None and entry.comparison.p_value is not None:
                found.append(entry.comparison.p_value)
    return found


def _corrected(points: Sequence[PointMetrics]) -> list[PointMetrics]:
    """Return points with Holm's correction over all comparisons of the study.

    A reader sees them together.
    """
    # In the order of ``_p_values``, which is that of the loop below.
    corrected = iter(holm(_p_values(points)))

    def with_p(entry: VariantMetrics) -> VariantMetrics:
        if entry.comparison is None or entry.comparison.p_value is None:
            return entry
        comparison = msgspec.structs.replace(entry.comparison, p_corrected=next(corrected))
        return msgspec.structs.replace(entry, comparison=comparison)

    changed: list[PointMetrics] = []
    for point in points:
        variants = tuple(with_p(entry) for entry in point.variants)
        changed.append(msgspec.structs.replace(point, variants=variants))
    return changed
