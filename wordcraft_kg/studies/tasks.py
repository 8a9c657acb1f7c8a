"""The tasks of a study, each addressed by its inputs and settings, and the interface of those who perform them."""

import hashlib
import json
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Literal, Protocol

Kind = Literal["graphs", "scorers", "runs"]
"""What a task makes, which is also the folder of the results folder that holds it."""
Ending = Literal["done", "failed", "interrupted"]


@dataclass(frozen=True, eq=False)
class Task:
    """A piece of work: a graph folder, a model folder or the run folder of an agent.

    Attributes:
        settings: everything that decides the outcome, as plain values; inputs by their addresses.
        title: a line for people; not part of the address.
        needs: addresses of the tasks whose folders it reads.
        threads: CPU threads.
        device: torch device.
    """

    kind: Kind
    settings: dict[str, Any]
    title: str
    needs: tuple[str, ...] = ()
    threads: int = 1
    device: str = "cpu"

    @cached_property
    def address(self) -> str:
        """Folder inside the results folder: the kind, and a hash of the settings."""
        text = json.dumps(self.settings, sort_keys=True, ensure_ascii=False, allow_nan=False)
        return f"{self.kind}/{hashlib.sha256(text.encode()).hexdigest()[:16]}"

    def folder(self, root: Path) -> Path:
        """Return its folder inside a results folder."""
        return root / self.address


@dataclass(frozen=True)
class Outcome:
    """The end of a task: interrupted means that it can go on.

    Attributes:
        error: a line.
        detail: the traceback of an error that is no user's.
        disk_full: whether the disk was full, so that there is no point in going on.
    """

    address: str
    ending: Ending
    error: str = ""
    detail: str = ""
    disk_full: bool = False


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
