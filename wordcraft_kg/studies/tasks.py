"""Tasks in a study, and their outcomes.

A task has a folder, named after inputs and settings.
"""

import hashlib
import json
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

Kind = Literal["graphs", "scorers", "runs"]
"""Kind of result that a task makes, and subfolder in the results folder."""
TerminationReason = Literal["done", "failed", "interrupted"]


@dataclass(frozen=True, eq=False)
class Task:
    """A task in a study: a graph folder, a model folder or an agent's run folder to make.

    Attributes:
        kind: kind of result.
        settings: everything that decides the result, as plain JSON values; inputs by their
            addresses.
        title: the task in a line for people; not a part of the address.
        needs: addresses of the inputs: none, the graph, or the graph and the scorer.
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
        """Folder relative to the results folder: kind and settings hash."""
        text = json.dumps(self.settings, sort_keys=True, ensure_ascii=False, allow_nan=False)
        return f"{self.kind}/{hashlib.sha256(text.encode()).hexdigest()[:16]}"

    def folder(self, root: Path) -> Path:
        """Return the folder for the output of this training in the results folder ``root``."""
        return root / self.address


@dataclass(frozen=True)
class Outcome:
    """How a task ended.

    Attributes:
        address: address of the task.
        termination: done, failed, or interrupted with a checkpoint.
        error: the error in a line; empty without an error.
        detail: traceback of an error that is not the user's; else empty.
        disk_full: whether the disk was full, which ends the study.
    """

    address: str
    termination: TerminationReason
    error: str = ""
    detail: str = ""
    disk_full: bool = False
