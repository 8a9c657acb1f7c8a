"""Records in an agent's run folder: progress, metrics, evaluated episodes and final evaluation."""

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
    """``evaluation.json``: an agent's final evaluation after ``steps`` environment steps.

    Attributes:
        seconds: run time, with evaluation and writing.
        parameters: number of trained parameters.
        steps_per_second: environment steps per second of training, without evaluation.
        curves_share: share of the run time for learning curves.
        success: success rate by part of the split.
        outcomes: episode shares by part and termination reason.
        distractors: number of distractors.
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
    """Progress at a checkpoint: seconds of training, of learning curves and in all; bytes of ``metrics.jsonl``."""

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
    """Parse the content of ``metrics.jsonl``; ArtefactError with ``path``, naming the damaged line and field."""
    rows = parse_lines(data, MetricsRow, path)
    figures = parse_lines(data, dict[str, float | None], path)
    return [
        msgspec.structs.replace(
            row, figures={name: value for name, value in line.items() if value is not None}
        )
        for row, line in zip(rows, figures, strict=True)
    ]


class PlayedTask(Record):
    """A line in ``episodes.jsonl``: a task's episodes in the final evaluation, one for each distractor seed.

    Attributes:
        part: part of the split.
        start: starting ingredients; goal and start identify the task.
        success: share of episodes that made the goal.
        terminations: termination reason by episode.
        actions: length by episode, in actions.
    """

    part: TaskPart
    goal: str
    start: tuple[str, ...]
    success: Share
    terminations: tuple[TerminationReason, ...]
    actions: tuple[Count, ...]


def read_episodes(folder: Path) -> list[PlayedTask]:
    """Read ``episodes.jsonl`` from a finished run; ArtefactError if the file is missing or damaged, naming the line."""
    path = folder / EPISODES_FILE
    return parse_lines(read_large_file(path), PlayedTask, path)


def read_summary(files: RunFiles) -> AgentSummary:
    """Read ``evaluation.json`` from a finished run; ArtefactError if the file is missing or damaged."""
    summary = files.record("evaluation.json", AgentSummary)
    if not summary.success:
        path = files.folder / "evaluation.json"
        raise ArtefactError(f"{path} is damaged: no tasks were played. Train the agent again.")
    return summary
