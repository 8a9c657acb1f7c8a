"""Collecting the results from a study, or from all agent runs in a results folder."""

from collections.abc import Collection, Mapping, Sequence
from pathlib import Path

from wordcraft_kg.agents.config import KNOWLEDGE_SETTINGS
from wordcraft_kg.base.errors import ArtefactError, ConfigError
from wordcraft_kg.base.settings import nearest
from wordcraft_kg.evaluation.reference import PlayedGraph
from wordcraft_kg.studies.plan import CONFIG_OF, DEFAULTS_OF_AGENT, DEFAULTS_OF_GRAPH, defaults_of
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
from wordcraft_kg.studies.store import PlannedStudy, failure_of, read_plan, studies_of
from wordcraft_kg.studies.study import NO_SETTINGS, SCORER, Cell, Study, Value, Values

_KEPT = ("won", "distractor_seeds", "curve", "steps", "seconds", "steps_per_second")
"""Figures that a run and its result share."""
_NONE = "none"
"""Value for an absent setting, such as the scorer if an agent has none."""


def collect_study(root: Path, name: str) -> StudyResults:
    """Return the results that a study in a results folder has so far; ArtefactError for an unknown study."""
    plan = read_plan(root, name)
    rows = list(zip(plan.cells, plan.runs, plan.scorers, strict=True))
    return _results(root, name, plan.command, plan.study, rows)


def collect_runs(root: Path, by: Sequence[str]) -> StudyResults:
    """Return the results for all agent runs in a results folder as a single study.

    Args:
        root: results folder.
        by: settings that define the variants; all further settings with several values define the grid.

    Raises:
        ArtefactError: if ``root`` is not a results folder.
        ConfigError: for a setting that no run has.
    """
    described: dict[str, tuple[Values, Cell, str | None]] = {}
    given: dict[str, None] = {}
    plans = [read_plan(root, name) for name in studies_of(root)]
    for plan in plans:
        for cell, run, scorer in zip(plan.cells, plan.runs, plan.scorers, strict=True):
            explicit = _explicit(plan, cell, scorer)
            given |= dict.fromkeys(explicit)
            described.setdefault(run, (_with_defaults(explicit, by), cell, scorer))
    every = [values for values, *_ in described.values()]
    _check_known(by, list(given), set().union(*every), root)
    # Only explicit study settings can vary; further settings have their default.
    varied = [name for name in given if name not in by and _varies(name, by, every)]
    rows, variants = [], {}
    for run, (values, cell, scorer) in described.items():
        own = _of(values, by)
        variant = ", ".join(map(str, own.values())) or "all"
        variants[variant] = own
        rows.append((Cell(variant, _of(values, varied), cell.seed, {}), run, scorer))
    study = Study(
        title=f"Runs by {', '.join(by)}" if by else "All runs",
        variants=variants,
        grid={name: list(dict.fromkeys(values.get(name, _NONE) for values in every)) for name in varied},
        seeds=max((cell.seed + 1 for cell, *_ in rows), default=1),
        drawing="bars",
    )
    return _results(root, "runs", " && ".join(dict.fromkeys(plan.command for plan in plans)), study, rows)


def _check_known(by: Sequence[str], names: Sequence[str], known: Collection[str], root: Path) -> None:
    for name in by:
        if name not in known:
            expected = f"there are {', '.join(names)}.{nearest(name, known)}"
            raise ConfigError(f"`by` '{name}': no run of '{root}' has this setting; {expected}")


def _of(values: Values, names: Sequence[str]) -> Values:
    return {name: values.get(name, _NONE) for name in names}


def _varies(name: str, by: Sequence[str], runs: Sequence[Values]) -> bool:
    first: dict[tuple[Value, ...], Value] = {}
    pairs = [(tuple(_of(values, by).values()), values.get(name, _NONE)) for values in runs]
    return any(first.setdefault(agreed, value) != value for agreed, value in pairs)


def _explicit(plan: PlannedStudy, cell: Cell, scorer: str | None) -> Values:
    values = dict(cell.settings)
    name = values.get(SCORER)
    if scorer is None or name is None:
        left_out = {key for key in values if key in KNOWLEDGE_SETTINGS or key.startswith(f"{SCORER}.")}
        return {key: value for key, value in values.items() if key not in left_out} | {SCORER: _NONE}
    own = {f"{SCORER}.{key}": value for key, value in plan.study.scorers[str(name)].items()}
    return {**own, **values}


def _with_defaults(explicit: Values, by: Sequence[str]) -> Values:
    """Add default settings, but no derived settings such as seeds.

    An agent without a scorer has the value "none" for scorer settings in ``by``, and else their defaults.
    """
    values = {**DEFAULTS_OF_GRAPH, **DEFAULTS_OF_AGENT}
    if explicit[SCORER] == _NONE:
        values |= {name: _NONE for name in KNOWLEDGE_SETTINGS if name in by}
    elif (kind := CONFIG_OF.get(str(explicit[f"{SCORER}.command"]))) is not None:
        values |= {f"{SCORER}.{name}": value for name, value in defaults_of(kind).items()}
    derived = {*NO_SETTINGS, "eval_every", *(f"{SCORER}.{name}" for name in NO_SETTINGS)}
    return {name: value for name, value in values.items() if value is not None and name not in derived} | explicit


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
