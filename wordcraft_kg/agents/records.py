"""What the run folder of an agent keeps beside the weights."""

from pathlib import Path

import msgspec

from wordcraft_kg.agents.evaluation import Ending, Success
from wordcraft_kg.errors import ArtefactError
from wordcraft_kg.graphs.tasks import TaskPart
from wordcraft_kg.records import Record, Share, parse_lines, parse_record
from wordcraft_kg.runs.record import RunRecord, verified_bytes


class AgentSummary(Record, frozen=True, kw_only=True):
    """``evaluation.json``: what a training came to.

    Attributes:
        steps: environment steps done.
        seconds: of the whole run, evaluations and writing included.
        steps_per_second: of acting and learning alone.
        curves_share: of the seconds that went into the learning curves.
        parameters: of the policy.
        success: by part.
        outcomes: shares of the endings, by part.
        distractors: on the tables.
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
    """What a checkpoint of an agent's training notes beside its tensors.

    Attributes:
        seconds: of acting and learning.
        eval_seconds: of the learning curves.
        elapsed: of everything.
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
        seconds: since the start.
        figures: all else that has a value, by name: loss, success, test_success, lambda_u_first, ...
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


def read_summary(folder: Path, run: RunRecord) -> AgentSummary:
    """Read ``evaluation.json`` of a finished run.

    Raises:
        ArtefactError: if it is missing or damaged.
    """
    path = folder / "evaluation.json"
    summary = parse_record(verified_bytes(folder, run, path.name), AgentSummary, path)
    if not summary.success:
        raise ArtefactError(f"{path} is damaged: no tasks were played. Train the agent again.")
    return summary
