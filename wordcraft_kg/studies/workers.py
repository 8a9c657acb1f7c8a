"""Where tasks are performed: the interface that the engine knows, whether processes of this machine or a cluster."""

from typing import Protocol

from wordcraft_kg.studies.tasks import Outcome, Task


class Workers(Protocol):
    """Performs tasks whose inputs are there; results lie in the results folder when a task is reported as done."""

    @property
    def places(self) -> int:
        """Number of tasks that can be performed at once; may change while a cluster grows or shrinks."""

    def start(self, task: Task) -> None:
        """Begin a task; returns at once."""

    def wait(self, seconds: float) -> list[Outcome]:
        """Return the outcomes of tasks that have ended since the last call; wait for one, but no longer than this."""

    def stop(self) -> None:
        """End all that runs: trainings keep their last checkpoint where the folder is within reach."""
