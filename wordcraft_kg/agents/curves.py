"""``metrics.jsonl``: training metrics and learning curves, in a run folder."""

import json
import os
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

from wordcraft_kg.agents.evaluation import Evaluator, PolicyPlayer
from wordcraft_kg.base.errors import ArtefactError, TaskError
from wordcraft_kg.envs.evaluation_tables import MOST_TASKS
from wordcraft_kg.envs.world import World
from wordcraft_kg.graphs.tasks import TaskPart
from wordcraft_kg.models.policies.policy import Policy
from wordcraft_kg.runs.trackers import Log

EVALUATED: tuple[TaskPart, ...] = ("train", "test")
"""Parts of the split on which a trained agent is evaluated."""
CURVE_TASKS = 4_000
"""Maximum number of tasks per part of the split for a point on a learning curve; the final evaluation uses far more."""


class MetricsFile:
    """Writer for ``metrics.jsonl`` and trackers, never through a link; ``eval_seconds`` is the time for curves."""

    def __init__(self, folder: Path, world: World, log: Log):
        self.path = folder / "metrics.jsonl"
        if self.path.is_symlink():  # the file may belong to another run
            raise ArtefactError(
                f"{self.path} is a link; expected a file. Train again with `force`."
            )
        self.eval_seconds = 0.0
        self._log = log
        self._evaluators = evaluators(world, curve=True)

    def size(self) -> int:
        """Flush the file to disk and return the size in bytes."""
        self.path.touch()
        with self.path.open("rb+") as file:
            os.fsync(file.fileno())
        return self.path.stat().st_size

    def cut(self, size: int) -> None:
        """Truncate the file to ``size`` bytes; ValueError if the file is shorter."""
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
        """Append a line of metrics."""
        with self.path.open("ab") as file:
            file.write((json.dumps(row, allow_nan=False) + "\n").encode())
        self._log(row["step"], {name: value for name, value in row.items() if name != "step"})


def evaluators(world: World, *, curve: bool = False) -> dict[TaskPart, Evaluator]:
    """Return evaluators for train and test tasks, by part; ``curve`` takes fewer tasks, for learning curves."""
    result = {}
    for part in EVALUATED:
        with suppress(TaskError):  # without held-out recipes, a graph has no test tasks
            distractor_seeds = 1 if curve and part == "train" else None
            limit = CURVE_TASKS if curve else MOST_TASKS
            result[part] = Evaluator(
                world.variant(part=part), distractor_seeds=distractor_seeds, limit=limit
            )
    return result
