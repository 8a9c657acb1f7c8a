"""Records of training and evaluation in the run folder of an agent."""

from pathlib import Path

import msgspec

from wordcraft_kg.agents.outcomes import Ending, Success
from wordcraft_kg.base.artefacts import read_large_file
from wordcraft_kg.base.errors import ArtefactError
from wordcraft_kg.base.records import Count, Record, Share, parse_lines
from wordcraft_kg.graphs.tasks import TaskPart
from wordcraft_kg.runs.files import RunFiles

EPISODES_FILE = "episodes.jsonl"


class AgentSummary(Record, frozen=True, kw_only=True):
    """``evaluation.json``: the final evaluation.

    Attributes:
        steps: number of environment steps.
        seconds: duration of the run, including evaluation and writing.
        steps_per_second: speed of acting and learning.
        curves_share: share of the time spent on learning curves.
        parameters: number of parameters of the policy.
        success: success by split.
        outcomes: shares of the endings by split.
        distractors: number of distractors.
    """

    steps: int
    seconds: float
    steps_per_second: int
    curves_share: float
    parameters: int
    success: dict[TaskPart, Success]
    outcomes: dict[TaskPart, dict[Ending, Share]]
    distractors: int


class AgentProgress(Record, frozen=True, kw_only=True):
    """Progress of training in a checkpoint.

    Attributes:
        seconds: time spent acting and learning.
        eval_seconds: time spent on learning curves.
        elapsed: total time.
        metrics_bytes: length of ``metrics.jsonl``.
    """

    seconds: float
    eval_seconds: float
    elapsed: float
    metrics_bytes: int


class MetricsRow(msgspec.Struct, frozen=True, kw_only=True):
    """A line of ``metrics.jsonl``.

    Attributes:
        step: number of environment steps.
        seconds: time since the start.
        figures: metrics by name: loss, success, test_success, lambda_u_first, ...
    """

    step: int
    seconds: float
    figures: dict[str, float] = {}


def read_metrics(data: bytes, path: Path) -> list[MetricsRow]:
    """Parse ``metrics.jsonl``.

    Raises:
        ArtefactError: naming the line and the field.
    """
    when = parse_lines(data, MetricsRow, path)
    figures = parse_lines(data, dict[str, float | None], path)
    return [
        msgspec.structs.replace(row, figures={name: value for name, value in line.items() if value is not None})
        for row, line in zip(when, figures, strict=True)
    ]


class PlayedTask(Record):
    """A line of ``episodes.jsonl``: the episodes of a task in the final evaluation.

    Attributes:
        part: split of the task.
        goal: entity to make.
        start: starting ingredients; together with the goal, they identify the task.
        success: share of successful draws.
        endings: ending of each draw.
        picks: number of picks of each draw.
    """

    part: TaskPart
    goal: str
    start: tuple[str, ...]
    success: Share
    endings: tuple[Ending, ...]
    picks: tuple[Count, ...]


def read_episodes(folder: Path) -> list[PlayedTask]:
    """Read ``episodes.jsonl`` of a finished run.

    Raises:
        ArtefactError: if the file is missing or damaged, naming the line.
    """
    path = folder / EPISODES_FILE
    return parse_lines(read_large_file(path), PlayedTask, path)


def read_summary(files: RunFiles) -> AgentSummary:
    """Read ``evaluation.json`` of a finished run.

    Raises:
        ArtefactError: if the file is missing or damaged.
    """
    summary = files.record("evaluation.json", AgentSummary)
    if not summary.success:
        raise ArtefactError(
            f"{files.folder / 'evaluation.json'} is damaged: no tasks were played. Train the agent again."
        )
    return summary
