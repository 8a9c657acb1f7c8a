"""Run pages: all runs side by side, and one run with its curves, as far as it has come."""

from operator import attrgetter
from pathlib import Path

import msgspec

from wordcraft_kg.agents.agent_folder import AgentRun
from wordcraft_kg.agents.agent_training import EVALUATED
from wordcraft_kg.agents.following import FollowedRun
from wordcraft_kg.apps.explorer.explored import Explored
from wordcraft_kg.apps.explorer.page import Page, PageState
from wordcraft_kg.base import ArtefactError, Count, Record, Share
from wordcraft_kg.evaluation import agent_metrics
from wordcraft_kg.graphs import TaskPart, TrainedOn
from wordcraft_kg.models.policies.sources import shown_setting
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

    @property
    def is_live(self) -> bool:
        """Whether the run trains according to the record, or is starting."""
        return self.status == "running" or (self.status is None and not self.problem)


class RunList(Record):
    """The table of runs.

    Attributes:
        runs: a row for each run.
        parts: task parts for which any run has results.
    """

    runs: tuple[RunRow, ...]
    parts: tuple[TaskPart, ...]

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
        settings: settings other than the defaults, as text.
        curves: success rates during training, by part.
        lambdas: mixing weights during training.
        training: further metrics during training.
    """

    row: RunRow
    checkpoint: str = ""
    waits_for: str = ""
    depth: Count = 0
    distractors: Count = 0
    settings: dict[str, str] = msgspec.field(default_factory=dict)
    curves: dict[str, tuple[agent_metrics.CurvePoint, ...]] = msgspec.field(default_factory=dict)
    lambdas: tuple[agent_metrics.LambdaCurve, ...] = ()
    training: dict[agent_metrics.TrainingMetric, tuple[agent_metrics.SeedCurve, ...]] = (
        msgspec.field(default_factory=dict)
    )

    @property
    def pictures(self) -> dict[str, object]:
        """The curves as SVG; empty for a run without curves of the kind."""
        name = self.row.name
        figures = dict(self.training)
        figures.pop("test_success", None)  # has a separate picture
        return {
            "success": picture_of_success({name: self.curves}) if self.curves else "",
            "lambdas": picture_of_lambdas(name, self.lambdas) if self.lambdas else "",
            "training": pictures_of_metrics({name: figures}),
        }


def _view_runs(explored: Explored, _: RunsState) -> RunList:
    rows = [_row(*explored.followed(name)) for name in explored.runs]
    parts = set[TaskPart]().union(*(row.success for row in rows))
    # Columns in a fixed order, whatever the order of the runs.
    return RunList(
        runs=tuple(rows),
        parts=tuple(part for part in EVALUATED if part in parts),
    )


def _view_run(explored: Explored, state: RunState) -> RunView:
    name, run = explored.followed(state.run)
    row = _row(name, run)
    if row.status is None:
        waits = "The run has not started: the folder has no record." if row.is_live else ""
        return RunView(row, waits_for=waits)
    records = run.records()
    tasks = records.config.tasks
    return RunView(
        row=row,
        checkpoint=records.checkpoint,
        waits_for=_waits_for(records),
        depth=tasks.depth,
        distractors=tasks.distractors,
        settings={name: _shown(name, value) for name, value in records.config.differing().items()},
        curves=agent_metrics.success_curves([records]),
        lambdas=tuple(agent_metrics.lambda_curves([records])),
        training=agent_metrics.training_metrics([records]),
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
    )


def _success(records: AgentRun) -> dict[TaskPart, PartSuccess]:
    # The evaluation plays all tasks; the metrics during training are of a sample.
    if records.evaluation is not None:
        return {
            part: PartSuccess(rate.mean, (rate.ci_low, rate.ci_high))
            for part, rate in records.evaluation.success.items()
        }
    # The last value of each figure: not every line of metrics has all figures.
    figures: dict[str, float] = {}
    for row in records.metrics:
        figures |= row.figures
    last = {part: figures.get(f"{part}_success") for part in EVALUATED}
    return {part: PartSuccess(mean, None) for part, mean in last.items() if mean is not None}


def _waits_for(records: AgentRun) -> str:
    """Return a sentence about weights to come, and the remedy; empty for a finished run."""
    if records.run.status == "done":
        return ""
    uses = f"Episodes use the last checkpoint ({records.checkpoint or 'none yet'})"
    if records.run.status == "running":
        return (
            f"{uses}, which the run writes at the start and every "
            f"{records.config.trainer.checkpoint_every:,} steps."
        )
    return f"{uses}. Repeat the training command to resume and evaluate."


PAGE = Page(
    "runs",
    RunsState,
    _view_runs,
    title="Runs",
    is_there=attrgetter("runs"),
)
RUN = Page(
    "run",
    RunState,
    _view_run,
    subject="run",
    exported=lambda explored: map(RunState, explored.runs),
    is_there=attrgetter("runs"),
)
