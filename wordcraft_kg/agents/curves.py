"""``metrics.jsonl``: training metrics and learning curves, in a run folder.

Lines are appended while training goes on, so that a run can be watched. A checkpoint records how
long the file was; resuming cuts later lines, which training writes again.
"""

import os
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

from wordcraft_kg.agents.evaluation import Evaluator, PolicyPlayer
from wordcraft_kg.base.artefacts import json_text
from wordcraft_kg.base.errors import ArtefactError, TaskError
from wordcraft_kg.envs.evaluation_tables import MOST_TASKS
from wordcraft_kg.envs.world import World
from wordcraft_kg.graphs.tasks import TaskPart
from wordcraft_kg.models.policies.policy import Policy
from wordcraft_kg.runs.trackers import Log

EVALUATED: tuple[TaskPart, ...] = ("train", "test")
"""Parts of the split on which a trained agent is evaluated."""
CURVE_TASKS = 4_000
"""Most tasks per part of the split for a point on a learning curve.

The final evaluation uses far more, see ``MOST_TASKS`` in ``envs.evaluation_tables``.
"""


class MetricsFile:
    """Appends lines to ``metrics.jsonl``, and passes them on to the run's trackers.

    Attributes:
        path: path of the file.
        eval_seconds: seconds spent on the learning curves so far.
    """

    def __init__(
        self,
        folder: Path,
        world: World,
        log: Log,
    ):
        """Prepare the evaluators of the learning curves.

        Args:
            folder: run folder.
            world: world of the training; its train and test parts are evaluated.
            log: sends a line to the trackers.

        Raises:
            ArtefactError: if the file is a link, through which another run would be written to.
        """
        self.path = folder / "metrics.jsonl"
        if self.path.is_symlink():
            raise ArtefactError(
                f"{self.path} is a link; expected a file. Train again with `force`."
            )
        self.eval_seconds = 0.0
        self._log = log
        self._evaluators = evaluators(world, curve=True)

    def size(self) -> int:
        """Flush the file to disk and return the size in bytes.

        A checkpoint counts on lines that are on disk, also after a power failure.
        """
        self.path.touch()
        with self.path.open("rb+") as file:
            os.fsync(file.fileno())
        return self.path.stat().st_size

    def cut(self, size: int) -> None:
        """Remove what was written after a checkpoint, when the file had ``size`` bytes.

        Raises:
            ValueError: if the file is shorter than that.
        """
        if self.path.stat().st_size < size:
            raise ValueError("metrics.jsonl is shorter than at the checkpoint")
        os.truncate(self.path, size)

    def evaluate(self, policy: Policy) -> dict[str, float]:
        """Evaluate a policy; return the success rate by curve, such as ``test_success``."""
        begun = time.perf_counter()
        point = {
            f"{part}_success": float(evaluator(PolicyPlayer(policy)).success.mean())
            for part, evaluator in self._evaluators.items()
        }
        self.eval_seconds += time.perf_counter() - begun
        return point

    def add(self, row: dict[str, Any]) -> None:
        """Append a line of metrics; without NaN and infinity, which JSON lacks."""
        # One write for a line, so that a reader sees whole lines but for the last.
        with self.path.open("ab") as file:
            file.write((json_text(row) + "\n").encode())
        self._log(
            row["step"],
            {name: value for name, value in row.items() if name != "step"},
        )


def evaluators(world: World, *, curve: bool = False) -> dict[TaskPart, Evaluator]:
    """Return evaluators for train and test tasks, by part.

    Args:
        world: world of the training, in any part.
        curve: take fewer tasks and, for train tasks, one table each, for learning curves.

    Returns:
        Evaluators by part; none for a part without tasks.

    Raises:
        ConfigError: if the graph has too few entities for the distractors beside a part's tasks.
    """
    result = {}
    for part in EVALUATED:
        with suppress(TaskError):  # without held-out recipes, a graph has no test tasks
            # The curve of test tasks is the one that is read closely.
            distractor_seeds = 1 if curve and part == "train" else None
            limit = CURVE_TASKS if curve else MOST_TASKS
            result[part] = Evaluator(
                world.variant(part=part),
                distractor_seeds=distractor_seeds,
                limit=limit,
            )
    return result
