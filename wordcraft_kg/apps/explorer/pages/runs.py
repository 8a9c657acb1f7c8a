"""Run pages: all runs side by side, and one run with its curves, as far as it has come."""

from operator import attrgetter
from pathlib import Path

import msgspec

from wordcraft_kg.agents.agent_folder import AgentRun
from wordcraft_kg.agents.agent_records import TerminationReason
from wordcraft_kg.agents.agent_training import EVALUATED
from wordcraft_kg.agents.following import FollowedRun
from wordcraft_kg.apps.explorer.explored import Explored
from wordcraft_kg.apps.explorer.page import Page, PageState
from wordcraft_kg.base import ArtefactError, Count, Record, Share
from wordcraft_kg.evaluation import agent_metrics
from wordcraft_kg.graphs import TaskPart, TrainedOn
from wordcraft_kg.models.policies.sources import ALPHA, shown_setting, source_names
from wordcraft_kg.reports.agent_report import (
    picture_of_lambdas,
    picture_of_success,
    pictures_of_metrics,
)
from wordcraft_kg.runs.record import RUN_FILE, Status


class RunsState(PageState):
    """Page settings: none."""


class RunState(PageState):
    """Page settings: a run.

    Attributes:
        run: name of the run; empty for the first.
    """

    run: str = ""


class PartSuccess(Record):
    """Success rate on a task part: from the evaluation, or the last one during training.

    Attributes:
        mean: share of episodes that made the goal.
        ci: 95 % interval over tasks; None during training, when only a few tasks are played.
    """

    mean: Share
    ci: tuple[float, float] | None


class RunRow(Record):
    """An agent's run.

    Attributes:
        name: name of the run.
        status: status in the run's record; None before the start, and for an unreadable run.
        problem: reason why the run cannot be read; empty for other runs.
        policy: kind of the policy.
        scorer: name of the scorer's folder; empty without a scorer.
        kg: recipes that the scorer was trained on; None without a scorer.
        use: sources of scores that the agent mixes.
        steps: environment steps so far.
        planned: environment steps of the whole training.
        success: success rate by task part; parts that were not evaluated are left out.
        lambdas: last mixing weights by source, for the first and the second entity of an attempt;
            None for a weight that the policy does not have.
    """

    name: str
    status: Status | None
    problem: str = ""
    policy: str = ""
    scorer: str = ""
    kg: TrainedOn | None = None
    use: tuple[str, ...] = ()
    steps: Count = 0
    planned: Count = 0
    success: dict[TaskPart, PartSuccess] = msgspec.field(default_factory=dict)
    lambdas: dict[str, tuple[float | None, float | None]] = msgspec.field(default_factory=dict)

    @property
    def is_live(self) -> bool:
        """Whether the run trains according to the record, or is starting."""
        return self.status == "running" or (self.status is None and not self.problem)


class RunList(Record):
    """The table of runs.

    Attributes:
        runs: a row for each run.
        parts: task parts for which any run has results.
        sources: sources for which any run has mixing weights.
    """

    runs: tuple[RunRow, ...]
    parts: tuple[TaskPart, ...]
    sources: tuple[str, ...]

    @property
    def is_live(self) -> bool:
        """Whether any run trains."""
        return any(run.is_live for run in self.runs)


class RunView(Record):
    """An agent's run with metrics, curves, and settings other than the defaults.

    Attributes:
        row: the run in the table of runs.
        checkpoint: the last weights; empty if there are none yet.
        waits_for: sentence about files that training has yet to write; empty for complete runs.
        depth: depth of the training tasks, in crafts.
        distractors: number of distractors in the training tasks.
        seconds: duration so far; None before the first line of metrics.
        steps_per_second: last speed, or the mean over the whole training once it is evaluated; None
            if unknown.
        outcomes: shares of termination reasons, by part; empty before the evaluation.
        settings: settings other than the defaults, as text.
        curves: success rates during training, by part.
        lambdas: mixing weights during training.
        training: further metrics during training.
        provenance: versions and hashes of the run's inputs.
    """

    row: RunRow
    checkpoint: str = ""
    waits_for: str = ""
    depth: Count = 0
    distractors: Count = 0
    seconds: float | None = None
    steps_per_second: float | None = None
    outcomes: dict[TaskPart, dict[TerminationReason, Share]] = msgspec.field(default_factory=dict)
    settings: dict[str, str] = msgspec.field(default_factory=dict)
    curves: dict[str, tuple[agent_metrics.CurvePoint, ...]] = msgspec.field(default_factory=dict)
    lambdas: tuple[agent_metrics.LambdaCurve, ...] = ()
    training: dict[agent_metrics.TrainingMetric, tuple[agent_metrics.SeedCurve, ...]] = (
        msgspec.field(default_factory=dict)
    )
    provenance: dict[str, str] = msgspec.field(default_factory=dict)


def _view_runs(explored: Explored, _: RunsState) -> RunList:
    rows = [_row(*explored.followed(name)) for name in explored.runs]
    parts = set[TaskPart]().union(*(row.success for row in rows))
    sources = set[str]().union(*(row.lambdas for row in rows))
    # Columns in a fixed order, whatever the order of the runs.
    return RunList(
        runs=tuple(rows),
        parts=tuple(part for part in EVALUATED if part in parts),
        sources=tuple(name for name in (ALPHA.name, *source_names()) if name in sources),
    )


def _view_run(explored: Explored, state: RunState) -> RunView:
    name, run = explored.followed(state.run)
    row = _row(name, run)
    if row.status is None:
        waits = "The run has not started: the folder has no record." if row.is_live else ""
        return RunView(row, waits_for=waits)
    records = run.records()
    tasks = records.config.tasks
    summary = records.evaluation
    seconds: float | None = None
    speed: float | None = None
    if summary:
        # The mean over the whole training.
        seconds = summary.seconds
        speed = summary.steps_per_second
    elif records.metrics:
        last = records.metrics[-1]
        seconds = last.seconds
        speed = last.figures.get("steps_per_second")
    return RunView(
        row=row,
        checkpoint=records.checkpoint,
        waits_for=_waits_for(records),
        depth=tasks.depth,
        distractors=tasks.distractors,
        seconds=seconds,
        steps_per_second=speed,
        outcomes=summary.outcomes if summary else {},
        settings={name: _shown(name, value) for name, value in records.config.differing().items()},
        curves=agent_metrics.success_curves([records]),
        lambdas=tuple(agent_metrics.lambda_curves([records])),
        training=agent_metrics.training_metrics([records]),
        provenance=records.provenance,
    )


def _shown(name: str, value: object) -> str:
    # Of a folder only its name: paths on this machine are private.
    return Path(str(value)).name if name in ("graph", "scorer") else shown_setting(name, value)


def _row(name: str, run: FollowedRun) -> RunRow:
    try:
        records = run.records()
    except ArtefactError as error:
        # A starting run has a folder without a record: this is no problem, and the page waits for
        # it.
        has_begun = (run.folder / RUN_FILE).exists() or not run.folder.is_dir()
        return RunRow(name, None, str(error) if has_begun else "")
    config = records.config
    return RunRow(
        name=name,
        status=records.run.status,
        policy=config.policy.policy or "",
        scorer=Path(config.scorer).name if config.scorer else "",
        kg=records.run.kg,
        use=config.policy.sources if config.scorer else (),
        steps=records.metrics[-1].step if records.metrics else 0,
        planned=config.trainer.updates * config.trainer.steps_per_update,
        success=_success(records),
        lambdas=_lambdas(records),
    )


def _success(records: AgentRun) -> dict[TaskPart, PartSuccess]:
    # The evaluation plays all tasks; the metrics during training are of a sample.
    if records.evaluation is not None:
        rates = records.evaluation.success
        return {
            part: PartSuccess(rate.mean, (rate.ci_low, rate.ci_high))
            for part, rate in rates.items()
        }
    figures = _last_metrics(records)
    last = {part: figures.get(f"{part}_success") for part in EVALUATED}
    return {part: PartSuccess(mean, None) for part, mean in last.items() if mean is not None}


def _last_metrics(records: AgentRun) -> dict[str, float]:
    """Return the last value of each figure: not every line of metrics has all figures."""
    last: dict[str, float] = {}
    for row in records.metrics:
        last |= row.figures
    return last


def _lambdas(records: AgentRun) -> dict[str, tuple[float | None, float | None]]:
    figures = _last_metrics(records)
    weights = {
        name: (
            figures.get(f"lambda_{name}_first"),
            figures.get(f"lambda_{name}_second"),
        )
        for name in (ALPHA.name, *source_names())
    }
    return {name: pair for name, pair in weights.items() if pair != (None, None)}


def _waits_for(records: AgentRun) -> str:
    """Return a sentence about weights to come, and the remedy; empty for a finished run."""
    if records.run.status == "done":
        return ""
    uses = f"Episodes use the last checkpoint ({records.checkpoint or 'none yet'})"
    if records.run.status == "running":
        every = f"{records.config.trainer.checkpoint_every:,}"
        return f"{uses}, which the run writes at the start and every {every} steps."
    return f"{uses}. Repeat the training command to resume and evaluate."


def _draw(view: RunView, *_: object) -> dict[str, object]:
    name = view.row.name
    figures = dict(view.training)
    figures.pop("test_success", None)  # has a separate picture
    return {
        "success": picture_of_success({name: view.curves}) if view.curves else "",
        "lambdas": picture_of_lambdas(name, view.lambdas) if view.lambdas else "",
        "training": pictures_of_metrics({name: figures}),
    }


PAGE = Page(
    "runs",
    RunsState,
    _view_runs,
    title="Runs",
    is_there=attrgetter("runs"),
    is_live=lambda explored, _: explored.is_any_live(*explored.runs),
)
RUN = Page(
    "run",
    RunState,
    _view_run,
    subject="run",
    draw=_draw,
    exported=lambda explored: map(RunState, explored.runs),
    is_there=attrgetter("runs"),
    is_live=lambda explored, state: explored.is_any_live(state.run),
)
