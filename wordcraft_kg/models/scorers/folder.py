"""The scorer of a model folder."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import torch

from wordcraft_kg.errors import ArtefactError
from wordcraft_kg.graphs.recipe_graph import RecipeGraph
from wordcraft_kg.graphs.triples import RELATIONS
from wordcraft_kg.models.scorers.embeddings import ComplExScorer
from wordcraft_kg.models.scorers.protocol import check_scorer
from wordcraft_kg.models.scorers.scorer import Scorer
from wordcraft_kg.models.scorers.tables import TABLE_LIMIT, TableScorer
from wordcraft_kg.runs.record import read_finished_run, verified_bytes
from wordcraft_kg.tensors import read_tensors


def load_scorer(folder: str | Path, *, graph: RecipeGraph | None = None, device: str = "cpu") -> Scorer:
    """Load the scorer of a model folder.

    Args:
        folder: written by ``train-complex`` or ``train-links``.
        graph: if given, the scorer must belong to it.
        device: where to score.

    Raises:
        ArtefactError: if the folder is unfinished or incomplete, or a file in it was damaged.
        GraphMismatchError: if it belongs to another graph.
    """
    folder = Path(folder)
    run = read_finished_run(folder, "wordcraft-kg train-complex")
    tensors = read_tensors(folder / "model.safetensors", verified_bytes(folder, run, "model.safetensors"))
    try:
        vocabulary = json.loads(verified_bytes(folder, run, "vocabulary.json"))
        kind, entities, graph_hash = vocabulary["scorer"], vocabulary["entities"], vocabulary["graph"]
        scorer = make_scorer(kind, tensors, entities, graph_hash, device=device, name=folder.name)
    except ArtefactError:
        raise
    except (KeyError, TypeError, ValueError) as error:
        raise ArtefactError(f"{folder} does not hold a scorer ({error!r}). Train it again.") from None
    if graph is not None:
        check_scorer(scorer, graph)
    return scorer


def make_scorer(
    kind: str, tensors: dict[str, torch.Tensor], entities: Sequence[str], graph_hash: str, **settings: Any
) -> Scorer:
    """Make a scorer from the tensors of a trained model: a table where it fits :data:`TABLE_LIMIT`.

    Args:
        kind: ``complex`` (embeddings) or ``table`` (scores), as in ``vocabulary.json``.
        tensors: what that kind needs.
        entities: labels in id order.
        graph_hash: of the graph that the ids belong to.
        settings: ``device`` and ``name``.

    Raises:
        ValueError: for another kind.
    """
    if kind not in ("complex", "table"):
        raise ValueError(f"no kind of scorer '{kind}'")
    if kind == "table":
        return TableScorer(tensors["scores"], entities, graph_hash, **settings)
    scorer = ComplExScorer(tensors, entities, graph_hash, **settings)
    return scorer.to_table() if len(RELATIONS) * len(entities) ** 2 * 4 <= TABLE_LIMIT else scorer
