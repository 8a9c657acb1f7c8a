"""Loading the scorer of a model folder."""

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, Literal

import torch

from wordcraft_kg.base.errors import ArtefactError, GraphMismatchError, reason
from wordcraft_kg.base.records import Record
from wordcraft_kg.base.registry import Registry
from wordcraft_kg.base.tensors import with_prefix
from wordcraft_kg.graphs.recipe_graph import RecipeGraph
from wordcraft_kg.models.scorers.calibration import Probabilities
from wordcraft_kg.models.scorers.config import TABLE_LIMIT, table_bytes
from wordcraft_kg.models.scorers.cross_fitting import CrossFitted, FoldsRecord
from wordcraft_kg.models.scorers.factors import ComplExScorer, FactorsScorer
from wordcraft_kg.models.scorers.protocol import FactoredScorer, check_scorer
from wordcraft_kg.models.scorers.recipes import RecipeScorer
from wordcraft_kg.models.scorers.scorer import Scorer, StoredScorer
from wordcraft_kg.models.scorers.tables import TableScorer
from wordcraft_kg.runs.files import RunFiles
from wordcraft_kg.runs.record import read_finished_run

WEIGHTS, VOCABULARY = "model.safetensors", "vocabulary.json"
FOLDS_RECORD, FOLDS_TENSORS, CALIBRATION = "folds.json", "folds.safetensors", "calibration.json"
"""Files of a cross-fitted model: record of the folds, tensors ``fold0.entity_real``, ..., and calibration."""
FOLD_OUTPUTS = (FOLDS_RECORD, FOLDS_TENSORS, CALIBRATION)
OF_RECIPE = "of_recipe"
"""Tensor with the fold of each recipe."""
TAUGHT = "taught"
"""Tensor with the results of a :class:`~wordcraft_kg.graphs.doses.Dose`; absent for unchanged train recipes."""
MODEL = "a model of train-complex, train-links, train-recipes or ask-opinions"

SCORERS: Registry[type[StoredScorer]] = Registry(
    "wordcraft_kg.models", {kind.kind: kind for kind in (ComplExScorer, FactorsScorer, TableScorer, RecipeScorer)}
)
"""Stored scorers by kind, the key in ``vocabulary.json``."""


class Vocabulary(Record, frozen=True, kw_only=True):
    """``vocabulary.json``: the meaning of tensor rows.

    Attributes:
        scorer: kind of scorer.
        graph: hash of the graph.
        entities: entity labels in id order.
        relations: relation labels in id order.
    """

    format: Literal["wordcraft-kg vocabulary 1"] = "wordcraft-kg vocabulary 1"
    scorer: str
    graph: str
    entities: tuple[str, ...]
    relations: tuple[str, ...]


def load_scorer(folder: str | Path, *, graph: RecipeGraph | None = None, device: str = "cpu") -> Scorer:
    """Load the scorer of a model folder.

    Args:
        folder: folder written by a training command, ``ask-opinions`` or ``save_scorer``.
        graph: if given, the scorer must belong to this graph.
        device: torch device.

    Returns:
        the scorer; a :class:`~wordcraft_kg.models.scorers.cross_fitting.CrossFitted` scorer if the folder has folds.

    Raises:
        ArtefactError: if the folder is unfinished, incomplete or damaged.
        GraphMismatchError: if the scorer belongs to another graph, or the folds to another split.

    Example:
        >>> scorer = load_scorer("models/kitchen")
        >>> scorer.score("water", "combinesWith", ["flour", "salt"]).shape
        torch.Size([2])
    """
    folder = Path(folder)
    files = RunFiles(folder, read_finished_run(folder, MODEL, WEIGHTS))
    tensors, vocabulary = files.tensors(WEIGHTS), files.record(VOCABULARY, Vocabulary)
    if vocabulary.scorer not in SCORERS:
        raise ArtefactError(
            f"{folder / VOCABULARY} names a scorer of kind {vocabulary.scorer[:100]!r}; expected one of "
            f"{', '.join(SCORERS)}. Install the package that it comes from, or restore a copy."
        )
    try:
        SCORERS[vocabulary.scorer].check(tensors, len(vocabulary.entities))
        scorer = make_scorer(
            vocabulary.scorer, tensors, vocabulary.entities, vocabulary.graph, device=device, name=folder.name
        )
    except (KeyError, TypeError, ValueError, RuntimeError) as error:
        raise ArtefactError(f"{folder} does not hold a scorer ({reason(error)}). Train it again.") from None
    if FOLDS_RECORD in files.run.outputs:
        scorer = _cross_fitted(files, scorer, vocabulary)
    if graph is not None:
        check_scorer(scorer, graph)
    return scorer


def _cross_fitted(files: RunFiles, scorer: Scorer, vocabulary: Vocabulary) -> CrossFitted:
    """Add the fold models, which become scorers on first use."""
    path, inputs = files.folder / FOLDS_TENSORS, files.run.inputs
    record, tensors = files.record(FOLDS_RECORD, FoldsRecord), files.tensors(FOLDS_TENSORS)
    if record.hash != inputs.get("folds"):
        raise GraphMismatchError(
            f"{files.folder / FOLDS_RECORD} is of the folds {record.hash[:12]}, but the model was trained with "
            f"{inputs.get('folds', 'none')[:12]}. Train it again, or restore a copy."
        )
    makers = []
    for fold in range(record.count):
        part = with_prefix(tensors, f"fold{fold}.")
        try:
            SCORERS[vocabulary.scorer].check(part, len(vocabulary.entities))
        except (KeyError, ValueError, IndexError) as error:
            raise ArtefactError(
                f"fold {fold} of {record.count} is missing or damaged in {path} ({reason(error)}). "
                "Train again, or restore a copy."
            ) from None
        settings = {"device": scorer.device, "name": f"{scorer.name}, without fold {fold}"}
        makers.append(partial(make_scorer, vocabulary.scorer, part, vocabulary.entities, vocabulary.graph, **settings))
    if OF_RECIPE not in tensors or tensors[OF_RECIPE].ndim != 1:
        raise ArtefactError(f"{path} does not say which recipe is in which fold. Train again, or restore a copy.")
    taught = tensors.get(TAUGHT)
    if taught is not None and (taught.shape != tensors[OF_RECIPE].shape or taught.is_floating_point()):
        raise ArtefactError(f"{path} does not say what each recipe was taught as. Train again, or restore a copy.")
    # Folders of earlier versions have no calibration.
    probabilities = files.record(CALIBRATION, Probabilities) if CALIBRATION in files.run.outputs else None
    return CrossFitted(
        scorer,
        makers,
        tensors[OF_RECIPE].numpy(),
        record,
        probabilities,
        taught=None if taught is None else taught.numpy(),
    )


def make_scorer(
    kind: str, tensors: Mapping[str, torch.Tensor], entities: Sequence[str], graph_hash: str, **settings: Any
) -> Scorer:
    """Make a scorer from the tensors of a trained model; factored scorers become tables within the limit.

    Args:
        kind: key of :data:`SCORERS`.
        tensors: tensors of this kind.
        entities: labels in id order.
        graph_hash: hash of the graph.
        settings: ``device`` and ``name``.

    Raises:
        KeyError: if a tensor is missing.
        ValueError: if a tensor does not fit the entities.
    """
    scorer = SCORERS[kind].restored(tensors, entities, graph_hash, **settings)
    is_small = table_bytes(len(entities)) <= TABLE_LIMIT
    return TableScorer.of(scorer) if is_small and isinstance(scorer, FactoredScorer) else scorer
