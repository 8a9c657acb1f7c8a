"""Opening a model folder for evaluation: its scorer, the graph and split that it was trained on, and its record."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from wordcraft_kg.graphs.folder import KG, OpenedGraph
from wordcraft_kg.models.links.config import read_config
from wordcraft_kg.models.scorers.folder import load_scorer
from wordcraft_kg.models.scorers.scorer import Scorer
from wordcraft_kg.runs.inputs import open_run_graph
from wordcraft_kg.runs.record import read_finished_run, verified_bytes


@dataclass(frozen=True)
class OpenedModel:
    """A trained link predictor with everything that its evaluation needs.

    Attributes:
        scorer: loaded from the folder.
        opened: the graph and split that it was trained on, checked by hash.
        kg: ``partial`` or ``full``.
        provenance: facts for a report.
        trace: a row an epoch.
    """

    scorer: Scorer
    opened: OpenedGraph
    kg: KG
    provenance: dict[str, Any]
    trace: list[dict[str, float]]


def open_model(folder: Path, graph: str | None = None) -> OpenedModel:
    """Open a model folder.

    Args:
        folder: written by ``train-complex`` or ``train-links``.
        graph: where its graph is now, if it has moved.

    Raises:
        ArtefactError: if the folder is unfinished or damaged, or the graph is not where it was.
        GraphMismatchError: if the graph or its split is not the one that the model was trained on.
    """
    run = read_finished_run(folder, "wordcraft-kg train-complex")
    scorer = load_scorer(folder)
    verified_bytes(folder, run, "config.toml")
    config, recorded_graph = read_config(folder)
    opened = open_run_graph(folder, run, graph or recorded_graph)
    metrics = json.loads(verified_bytes(folder, run, "metrics.json"))
    trace = [json.loads(line) for line in verified_bytes(folder, run, "trace.jsonl").splitlines()]
    provenance = {
        "trained by": " ".join(run["argv"]),
        "finished": run["ended"],
        "training": f"{metrics['epochs']} epochs, {metrics['seconds']:.1f} s, {metrics['parameters']:,} parameters",
        "on its own training triples": f"MRR {metrics['train_mrr']:.3f}",
        "settings": ", ".join(f"{name} {value}" for name, value in vars(config).items()),
        "versions": ", ".join(f"{name} {number}" for name, number in run["versions"].items()),
        "weights": run["outputs"]["model.safetensors"],
    }
    return OpenedModel(scorer, opened, config.kg, provenance, trace)
