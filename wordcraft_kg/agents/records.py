"""Training and evaluation records in the run folder of an agent."""

from pathlib import Path

import msgspec

from wordcraft_kg.agents.outcomes import Success, TerminationReason
from wordcraft_kg.base.artefacts import read_large_file
from wordcraft_kg.base.errors import ArtefactError
from wordcraft_kg.base.records import Count, Record, Share, parse_lines
from wordcraft_kg.graphs.tasks import TaskPart
from wordcraft_kg.runs.files import RunFiles

EPISODES_FILE = "episodes.jsonl"


class AgentSummary(Record, frozen=True, kw_only=True):
    """``evaluation.json``: the final evaluation by split, after ``steps`` environment steps.

    Attributes:
        seconds: run time, including evaluation and writing.
        steps_per_second: speed in training, without evaluation.
        curves_share: share of the run time for learning curves.
        outcomes: episode shares by termination reason.
    """

    steps: int
    seconds: float
    steps_per_second: int
    curves_share: float
    parameters: int
    success: dict[TaskPart, Success]
    outcomes: dict[TaskPart, dict[TerminationReason, Share]]
    distractors: int


class AgentProgress(Record, frozen=True, kw_only=True):
    """Training progress in a checkpoint.

    Attributes:
        seconds: time for acting and learning.
        eval_seconds: time for learning curves.
        elapsed: total time.
        metrics_bytes: length of ``metrics.jsonl``.
    """

    seconds: float
    eval_seconds: float
    elapsed: float
    metrics_bytes: int


class MetricsRow(msgspec.Struct, frozen=True, kw_only=True):
    """A line in ``metrics.jsonl``: environment steps, seconds since the start, and metrics by name."""

    step: int
    seconds: float
    figures: dict[str, float] = {}


def read_metrics(data: bytes, path: Path) -> list[MetricsRow]:
    """Parse ``metrics.jsonl``.

    Raises:
        ArtefactError: naming the line and the field.
    """
    rows = parse_lines(data, MetricsRow, path)
    figures = parse_lines(data, dict[str, float | None], path)
    return [
        msgspec.structs.replace(row, figures={name: value for name, value in line.items() if value is not None})
        for row, line in zip(rows, figures, strict=True)
    ]


class PlayedTask(Record):
    """A line in ``episodes.jsonl``: a task's episodes in the final evaluation, by distractor seed.

    Attributes:
        start: starting ingredients; goal and start identify the task.
        success: success rate.
        actions: episode lengths.
    """

    part: TaskPart
    goal: str
    start: tuple[str, ...]
    success: Share
    terminations: tuple[TerminationReason, ...]
    actions: tuple[Count, ...]


def read_episodes(folder: Path) -> list[PlayedTask]:
    """Read ``episodes.jsonl`` from a finished run.

    Raises:
        ArtefactError: if the file is missing or damaged, naming the line.
    """
    path = folder / EPISODES_FILE
    return parse_lines(read_large_file(path), PlayedTask, path)


def read_summary(files: RunFiles) -> AgentSummary:
    """Read ``evaluation.json`` from a finished run.

    Raises:
        ArtefactError: if the file is missing or damaged.
    """
    summary = files.record("evaluation.json", AgentSummary)
    if not summary.success:
        path = files.folder / "evaluation.json"
        raise ArtefactError(f"{path} is damaged: no tasks were played. Train the agent again.")
    return summary
