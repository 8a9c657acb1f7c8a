"""The scorer of a model folder."""

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, Literal

import torch

from wordcraft_kg.base.errors import ArtefactError, GraphMismatchError, reason
from wordcraft_kg.base.records import Record, parse_record
from wordcraft_kg.base.tensors import read_tensors, with_prefix
from wordcraft_kg.graphs.recipe_graph import RecipeGraph
from wordcraft_kg.graphs.triples import RELATIONS
from wordcraft_kg.models.scorers.calibration import Probabilities
from wordcraft_kg.models.scorers.config import TABLE_LIMIT, table_bytes
from wordcraft_kg.models.scorers.cross_fitting import CrossFitted, FoldsRecord
from wordcraft_kg.models.scorers.factors import ComplExScorer, FactorsScorer, factor_names
from wordcraft_kg.models.scorers.opinions import OpinionScorer, check_opinions
from wordcraft_kg.models.scorers.protocol import check_scorer
from wordcraft_kg.models.scorers.recipes import RecipeScorer, check_tensors
from wordcraft_kg.models.scorers.scorer import Scorer
from wordcraft_kg.models.scorers.tables import TableScorer
from wordcraft_kg.runs.record import RunRecord, read_finished_run, verified_bytes

FOLDS_RECORD, FOLDS_TENSORS, CALIBRATION = "folds.json", "folds.safetensors", "calibration.json"
"""The folds of a cross-fitted model: what is known of them, their tensors ``fold0.entity_real``, ..., and what makes
probabilities of scores."""
FOLD_OUTPUTS = (FOLDS_RECORD, FOLDS_TENSORS, CALIBRATION)
OF_RECIPE = "of_recipe"
"""The tensor that says which recipe is in which fold."""
TAUGHT = "taught"
"""The results of a dose, see :class:`~wordcraft_kg.graphs.doses.Dose`; absent if all train recipes were learned."""

ScorerKind = Literal["complex", "factors", "table", "recipes", "opinions"]
"""What a scorer is stored as: embeddings, the factors of its scores, the scores themselves, what recipes say, or
opinions with weights."""


class Vocabulary(Record, frozen=True, kw_only=True):
    """``vocabulary.json``: the meaning of the rows of the tensors.

    Attributes:
        scorer: kind of the scorer.
        graph: hash of the graph that the ids belong to.
        entities: labels of entities in id order.
        relations: labels of relations in id order.
    """

    format: Literal["wordcraft-kg vocabulary 1"]
    scorer: ScorerKind
    graph: str
    entities: tuple[str, ...]
    relations: tuple[str, ...]


def load_scorer(folder: str | Path, *, graph: RecipeGraph | None = None, device: str = "cpu") -> Scorer:
    """Load the scorer of a model folder.

    Args:
        folder: folder written by ``train-complex``, ``train-links``, ``train-recipes`` or ``ask-opinions``.
        graph: if given, the scorer must belong to it.
        device: torch device to score on.

    Returns:
        the scorer; a :class:`~wordcraft_kg.models.scorers.cross_fitting.CrossFitted` one if the folder has folds.

    Raises:
        ArtefactError: if the folder is unfinished or incomplete, or a file in it or one of its folds is damaged.
        GraphMismatchError: if it belongs to another graph, or the folds to another split.

    Example:
        >>> scorer = load_scorer("models/kitchen")
        >>> scorer.score("water", "combinesWith", ["flour", "salt"]).shape
        torch.Size([2])
    """
    folder = Path(folder)
    run = read_finished_run(
        folder, "a model of train-complex, train-links, train-recipes or ask-opinions", "model.safetensors"
    )
    tensors = read_tensors(folder / "model.safetensors", verified_bytes(folder, run, "model.safetensors"))
    scorer: Scorer
    path = folder / "vocabulary.json"
    vocabulary = parse_record(verified_bytes(folder, run, path.name), Vocabulary, path)
    try:
        _check_shapes(vocabulary, tensors)
        scorer = make_scorer(
            vocabulary.scorer, tensors, vocabulary.entities, vocabulary.graph, device=device, name=folder.name
        )
    except (KeyError, TypeError, ValueError, RuntimeError) as error:
        raise ArtefactError(f"{folder} does not hold a scorer ({reason(error)}). Train it again.") from None
    if FOLDS_RECORD in run.outputs:
        scorer = _cross_fitted(folder, run, scorer, vocabulary)
    if graph is not None:
        check_scorer(scorer, graph)
    return scorer


def _cross_fitted(folder: Path, run: RunRecord, scorer: Scorer, vocabulary: Vocabulary) -> CrossFitted:
    """Add the models of the folds; each becomes a scorer when it is asked for."""
    path = folder / FOLDS_TENSORS
    record = parse_record(verified_bytes(folder, run, FOLDS_RECORD), FoldsRecord, folder / FOLDS_RECORD)
    tensors = read_tensors(path, verified_bytes(folder, run, path.name))
    if record.hash != run.inputs.get("folds"):
        raise GraphMismatchError(
            f"{folder / FOLDS_RECORD} is of the folds {record.hash[:12]}, but the model was trained with "
            f"{run.inputs.get('folds', 'none')[:12]}. Train it again, or restore a copy."
        )
    makers = []
    for fold in range(record.count):
        part = with_prefix(tensors, f"fold{fold}.")
        try:
            _check_shapes(vocabulary, part)
        except (KeyError, ValueError, IndexError) as error:
            raise ArtefactError(
                f"fold {fold} of {record.count} is missing or damaged in {path} ({reason(error)}). "
                "Train again, or restore a copy."
            ) from None
        settings = {"device": scorer.device, "name": f"{scorer.name}, without fold {fold}"}
        entities, graph_hash = vocabulary.entities, vocabulary.graph
        makers.append(partial(make_scorer, vocabulary.scorer, part, entities, graph_hash, **settings))
    if OF_RECIPE not in tensors or tensors[OF_RECIPE].ndim != 1:
        raise ArtefactError(f"{path} does not say which recipe is in which fold. Train again, or restore a copy.")
    results = tensors.get(TAUGHT)
    if results is not None and (results.shape != tensors[OF_RECIPE].shape or results.is_floating_point()):
        raise ArtefactError(f"{path} does not say what each recipe was taught as. Train again, or restore a copy.")
    probabilities = None
    if CALIBRATION in run.outputs:  # folders of before have none
        path = folder / CALIBRATION
        probabilities = parse_record(verified_bytes(folder, run, CALIBRATION), Probabilities, path)
    return CrossFitted(
        scorer,
        makers,
        tensors[OF_RECIPE].numpy(),
        record,
        probabilities,
        taught=None if results is None else results.numpy(),
    )


def _check_shapes(vocabulary: Vocabulary, tensors: dict[str, torch.Tensor]) -> None:
    """Raise KeyError or ValueError if the tensors are not those of the vocabulary, or of another type."""
    if vocabulary.scorer == "recipes":
        check_tensors(tensors, len(vocabulary.entities))
        return
    if vocabulary.scorer == "opinions":
        check_opinions(tensors, len(vocabulary.entities))
        return
    size, relations = len(vocabulary.entities), len(RELATIONS)
    expected: dict[str, tuple[int, ...]] = {"scores": (relations, size, size)}
    if vocabulary.scorer == "complex":
        dim = tensors["entity_real"].shape[-1]
        rows = {"entity": size, "relation": relations}
        expected = {f"{what}_{part}": (rows[what], dim) for what in rows for part in ("real", "imag")}
    elif vocabulary.scorer == "factors":
        expected = {name: (size, tensors[left].shape[-1]) for left, right in factor_names() for name in (left, right)}
    for name, shape in expected.items():
        if tensors[name].dtype != torch.float32:
            raise ValueError(f"{name} is of {tensors[name].dtype}, not {torch.float32}")
        if tensors[name].shape != shape:
            raise ValueError(f"{name} has shape {tuple(tensors[name].shape)}, its vocabulary needs {shape}")


def kind_of(tensors: Mapping[str, torch.Tensor]) -> ScorerKind:
    """Return the kind of scorer that tensors are of."""
    marks: dict[str, ScorerKind] = {
        "speaking": "recipes",
        "opinions": "opinions",
        "scores": "table",
        factor_names()[0][0]: "factors",
    }
    return next((kind for name, kind in marks.items() if name in tensors), "complex")


def make_scorer(
    kind: ScorerKind, tensors: dict[str, torch.Tensor], entities: Sequence[str], graph_hash: str, **settings: Any
) -> Scorer:
    """Make a scorer from the tensors of a trained model: a table where it fits :data:`TABLE_LIMIT`.

    Args:
        kind: kind, as in ``vocabulary.json``.
        tensors: tensors that this kind needs.
        entities: labels in id order.
        graph_hash: hash of the graph that the ids belong to.
        settings: ``device`` and ``name``.

    Raises:
        KeyError: if a tensor is missing.
        ValueError: if one does not fit the entities.
    """
    if kind == "recipes":
        return RecipeScorer(tensors, entities, graph_hash, **settings)
    if kind == "opinions":
        return OpinionScorer(tensors, entities, graph_hash, **settings)
    if kind == "table":
        return TableScorer(tensors["scores"], entities, graph_hash, **settings)
    scorer: Scorer
    if kind == "factors":
        factors = [(tensors[left], tensors[right]) for left, right in factor_names()]
        scorer = FactorsScorer(factors, entities, graph_hash, **settings)
    else:
        scorer = ComplExScorer(tensors, entities, graph_hash, **settings)
    return TableScorer.of(scorer) if table_bytes(len(entities)) <= TABLE_LIMIT else scorer
