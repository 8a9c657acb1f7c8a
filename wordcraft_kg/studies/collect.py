"""Collecting the results of a study in a results folder."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from wordcraft_kg.base.errors import ArtefactError
from wordcraft_kg.evaluation.reference import PlayedGraph
from wordcraft_kg.studies.results import (
    FIGURES_FILE,
    Missing,
    Origin,
    RunFigures,
    RunResult,
    ScorerFigures,
    StudyResults,
    read_figures,
)
from wordcraft_kg.studies.store import failure_of, read_plan
from wordcraft_kg.studies.study import Cell, Study

_KEPT = ("won", "distractor_seeds", "curve", "steps", "seconds", "steps_per_second")
"""Figures that a run and its result share."""


def collect_study(root: Path, name: str) -> StudyResults:
    """Return the results that a study in a results folder has so far; ArtefactError for an unknown study."""
    plan = read_plan(root, name)
    rows = list(zip(plan.cells, plan.runs, plan.scorers, strict=True))
    return _results(root, name, plan.command, plan.study, rows)


def _results(
    root: Path, name: str, command: str, study: Study, rows: Sequence[tuple[Cell, str, str | None]]
) -> StudyResults:
    graphs: dict[PlayedGraph, int] = {}
    versions: dict[str, str] = {}
    scorers: dict[str, ScorerFigures] = {}
    origins: dict[str, tuple[int, Origin]] = {}
    runs, missing, seconds = [], [], {}
    for cell, address, scorer in rows:
        try:
            figures = _run_figures(root, address)
            if scorer is not None and scorer not in scorers:
                scorers[scorer] = read_figures(root / scorer, ScorerFigures)
        except ArtefactError as error:
            missing.append(Missing(cell.variant, cell.values, cell.seed, str(error)))
            continue
        versions |= figures.versions
        seconds[address] = figures.seconds
        origin = _origin(origins, figures)
        runs.append(
            RunResult(
                variant=cell.variant,
                values=cell.values,
                seed=cell.seed,
                run=address,
                graph=graphs.setdefault(figures.graph, len(graphs)),
                origin=origin,
                mrr=scorers[scorer].mrr if scorer is not None else None,
                success=_rounded(figures.success),
                by_plan=_rounded(figures.by_plan),
                terminations=_rounded(figures.terminations),
                **{name: getattr(figures, name) for name in _KEPT},
            )
        )
        if scorer is not None:
            seconds[scorer] = scorers[scorer].seconds
    return StudyResults(
        format="wordcraft-kg results 1",
        name=name,
        command=command,
        study=study,
        graphs=tuple(graphs),
        versions=versions,
        runs=tuple(runs),
        missing=tuple(missing),
        hours=round(sum(seconds.values()) / 3600, 4),
        origins=tuple(origin for _, origin in origins.values()),
    )


def _origin(origins: dict[str, tuple[int, Origin]], figures: RunFigures) -> int:
    key = repr((figures.stored, figures.platform, figures.versions))
    number, before = origins.get(key, (len(origins), None))
    runs = before.runs + 1 if before else 1
    origins[key] = number, Origin(figures.stored, figures.platform, figures.versions, runs)
    return number


def _run_figures(root: Path, address: str) -> RunFigures:
    if not (root / address / FIGURES_FILE).exists():
        raise ArtefactError(failure_of(root, address) or "not trained yet")
    figures = read_figures(root / address, RunFigures)
    if "test" not in figures.success:
        raise ArtefactError("the split has no test tasks of this kind")
    return figures


def _rounded(shares: Mapping[str, float]) -> dict[str, float]:
    return {name: round(share, 6) for name, share in shares.items()}
