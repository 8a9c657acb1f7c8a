"""What is kept of a finished task beside its folder's own files: figures small enough to read thousands of them.

``figures.json`` is written last, so it also says that the task is done.
"""

import hashlib
import json
from pathlib import Path
from typing import Any, TypeVar

from wordcraft_kg.base.artefacts import dump_json, read_json, write_atomically
from wordcraft_kg.base.errors import ArtefactError
from wordcraft_kg.base.records import Count, Record, Share, as_record, as_values
from wordcraft_kg.evaluation.reference import PlayedGraph
from wordcraft_kg.studies.results import Curve

FIGURES_FILE = "figures.json"
F = TypeVar("F", bound="Figures")


class Figures(Record, frozen=True, kw_only=True):
    """Figures of any task.

    Attributes:
        seconds: how long the training took; 0 of a graph.
        versions: of packages.
    """

    seconds: float
    versions: dict[str, str]


class ScorerFigures(Figures, frozen=True, kw_only=True):
    """Figures of a scorer.

    Attributes:
        mrr: leak-free MRR on the test triples; None if it has seen them, or there are none.
        kg: graph that it was trained on.
    """

    mrr: Share | None
    kg: str


class RunFigures(Figures, frozen=True, kw_only=True):
    """Figures of an agent's run; see :class:`~wordcraft_kg.studies.results.RunResult`."""

    graph: PlayedGraph
    success: dict[str, Share]
    by_plan: dict[str, Share]
    endings: dict[str, Share]
    won: str
    draws: Count
    curve: Curve
    steps: Count
    steps_per_second: Count


def write_figures(folder: Path, figures: Figures) -> None:
    """Write ``figures.json``, which marks the task as done; a hash of its content comes first."""
    values = as_values(figures)
    write_atomically(folder / FIGURES_FILE, dump_json({"sha256": _hash(values), "figures": values}), durable=True)


def read_figures(folder: Path, kind: type[F]) -> F:
    """Read ``figures.json``.

    Raises:
        ArtefactError: if it is missing, damaged or was edited.
    """
    path = folder / FIGURES_FILE
    values = read_json(path)
    if not isinstance(values, dict) or values.keys() != {"sha256", "figures"}:
        raise ArtefactError(f"{path} is damaged: expected 'sha256' and 'figures'. The same command makes it again.")
    if _hash(values["figures"]) != values["sha256"]:
        raise ArtefactError(
            f"{path} is damaged or was changed: its hash does not fit. The same command makes it again."
        )
    return as_record(values["figures"], kind, path)


def _hash(values: Any) -> str:
    return hashlib.sha256(json.dumps(values, sort_keys=True, ensure_ascii=False).encode()).hexdigest()
