"""The records in an agent's run folder besides the weights."""

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
    """``evaluation.json``: the outcome of a training.

    Attributes:
        steps: environment steps done.
        seconds: duration of the whole run, including evaluations and writing.
        steps_per_second: speed of acting and learning alone.
        curves_share: share of the seconds spent on the learning curves.
        parameters: number of the policy's parameters.
        success: success by part.
        outcomes: shares of the endings, by part.
        distractors: number of distractors on the tables.
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
    """What a checkpoint of an agent's training records besides its tensors.

    Attributes:
        seconds: time spent acting and learning.
        eval_seconds: time spent on the learning curves.
        elapsed: time of everything.
        metrics_bytes: length of ``metrics.jsonl``.
    """

    seconds: float
    eval_seconds: float
    elapsed: float
    metrics_bytes: int


class MetricsRow(msgspec.Struct, frozen=True, kw_only=True):
    """A line of ``metrics.jsonl``.

    Attributes:
        step: environment steps done.
        seconds: seconds since the start.
        figures: all other values by name: loss, success, test_success, lambda_u_first, ...
    """

    step: int
    seconds: float
    figures: dict[str, float] = {}


def read_metrics(data: bytes, path: Path) -> list[MetricsRow]:
    """Read ``metrics.jsonl``.

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
    """A line of ``episodes.jsonl``: a task of the last evaluation, and how its episodes ended.

    Attributes:
        part: part that was played.
        goal: what was to be made.
        start: starting ingredients, which with the goal say which task it is.
        success: share of the draws of distractors with which the goal was made.
        endings: how each draw ended.
        picks: picks of each draw.
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
        ArtefactError: if it is missing or damaged, naming the line.
    """
    path = folder / EPISODES_FILE
    return parse_lines(read_large_file(path), PlayedTask, path)


def read_summary(files: RunFiles) -> AgentSummary:
    """Read ``evaluation.json`` of a finished run.

    Raises:
        ArtefactError: if it is missing or damaged.
    """
    summary = files.record("evaluation.json", AgentSummary)
    if not summary.success:
        raise ArtefactError(
            f"{files.folder / 'evaluation.json'} is damaged: no tasks were played. Train the agent again."
        )
    return summary
