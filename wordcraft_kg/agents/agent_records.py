"""Records in an agent's run folder: progress, metrics, evaluated episodes and final evaluation.

The field names are those in the files, so a renamed field makes existing runs unreadable.
"""

from pathlib import Path
from typing import Annotated, Literal, get_args

import msgspec

from wordcraft_kg.base import Count, Record, Share, parse_lines, read_large_file
from wordcraft_kg.graphs.tasks import TaskPart
from wordcraft_kg.runs.record import RunFiles

TerminationReason = Literal["goal", "same_twice", "one_right_part", "no_right_part", "no_recipe"]
TERMINATION_REASONS: tuple[TerminationReason, ...] = get_args(TerminationReason)
"""Termination reasons of an episode, by its last attempt; the first match in this order counts.

| reason | the last pair |
|---|---|
| goal | made the goal |
| same_twice | was an entity with itself |
| one_right_part | has an ingredient for the goal in a plan |
| no_right_part | made something else |
| no_recipe | made nothing |
"""


class Success(Record):
    """A player's success on the tasks in a part of the split, all or a sample of them.

    Attributes:
        mean: share of episodes that made the goal.
        ci_low: lower end of the 95 % interval of ``mean``, over tasks: the interval resamples the
            groups of tasks that the split holds out together.
        ci_high: upper end.
        tasks: number of tasks.
        distractor_seeds: tables per task.
        by_plan: share of episodes in which a plan's last pair made the goal.
        actions: mean episode length in actions.
    """

    mean: Share
    ci_low: Share
    ci_high: Share
    tasks: Count
    distractor_seeds: Count
    by_plan: Share
    actions: float


EPISODES_FILE = "episodes.jsonl"
"""Name of the file with the episodes of the final evaluation, a line for each task."""


class AgentSummary(Record, frozen=True, kw_only=True):
    """``evaluation.json``: an agent's final evaluation.

    Attributes:
        steps: environment steps of the training.
        seconds: run time, with evaluation and writing.
        parameters: number of trained parameters.
        steps_per_second: environment steps per second of training, without evaluation.
        success: success rate by part of the split.
        outcomes: episode shares by part and termination reason, which sum to 1 in each part.
        distractors: number of distractors in the evaluated tasks.
    """

    steps: int
    seconds: float
    steps_per_second: int
    parameters: int
    # A finished run has at least train tasks.
    success: Annotated[dict[TaskPart, Success], msgspec.Meta(min_length=1)]
    outcomes: dict[TaskPart, dict[TerminationReason, Share]]
    distractors: int


class AgentProgress(Record, frozen=True, kw_only=True):
    """What a checkpoint of an agent's training records besides its tensors.

    Attributes:
        seconds: time of acting and learning.
        elapsed: time of everything, earlier parts of a resumed run included.
        metrics_bytes: length of ``metrics.jsonl``, to which a resumed run cuts the file.
    """

    seconds: float
    elapsed: float
    metrics_bytes: int


class MetricsRow(msgspec.Struct, frozen=True, kw_only=True):
    """A line in ``metrics.jsonl``.

    Attributes:
        step: environment steps so far.
        seconds: seconds since the start.
        figures: all other metrics by name, such as ``loss`` or ``test_success``; without those that
            are null in the file.
    """

    step: int
    seconds: float
    figures: dict[str, float] = {}


def read_metrics(data: bytes, path: Path) -> list[MetricsRow]:
    """Parse the content of ``metrics.jsonl``.

    Raises:
        ArtefactError: naming ``path`` and the damaged line and field.
    """
    # Read twice: fields with a name of their own, and all other metrics, whatever their names.
    rows = parse_lines(data, MetricsRow, path)
    lines = parse_lines(data, dict[str, float | None], path)
    complete = []
    for row, line in zip(rows, lines, strict=True):
        figures = {name: value for name, value in line.items() if value is not None}
        complete.append(msgspec.structs.replace(row, figures=figures))
    return complete


class PlayedTask(Record):
    """A line in ``episodes.jsonl``: a task's episodes in the final evaluation.

    There is one episode for each distractor seed.

    Attributes:
        part: part of the split.
        goal: label of the entity to make.
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
    """Read ``episodes.jsonl`` from a finished run.

    Raises:
        ArtefactError: if the file is missing or damaged, naming the line.
    """
    path = folder / EPISODES_FILE
    return parse_lines(read_large_file(path), PlayedTask, path)


def read_summary(files: RunFiles) -> AgentSummary:
    """Read ``evaluation.json`` from a finished run.

    Raises:
        ArtefactError: if the file is missing or damaged, or holds no result.
    """
    return files.record("evaluation.json", AgentSummary)
