"""Load scorers from model folders, and write scorers."""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, Literal

import safetensors.torch
import torch

from wordcraft_kg.base.artefacts import dump_json, write_atomically
from wordcraft_kg.base.errors import ArtefactError, ConfigError, GraphMismatchError, reason
from wordcraft_kg.base.records import Record, as_values
from wordcraft_kg.base.registry import Registry
from wordcraft_kg.base.tensors import copied, with_prefix
from wordcraft_kg.graphs.folds import Folds
from wordcraft_kg.graphs.recipe_graph import RecipeGraph
from wordcraft_kg.graphs.triples import RELATIONS, is_in, recipe_triples
from wordcraft_kg.models.scorers.calibration import Probabilities, predictions
from wordcraft_kg.models.scorers.config import TABLE_LIMIT, table_bytes
from wordcraft_kg.models.scorers.cross_fitting import CrossFitted, Fold, FoldsRecord, whole_of
from wordcraft_kg.models.scorers.factors import ComplExScorer, TableScorer
from wordcraft_kg.models.scorers.protocol import FactoredScorer, TripleScorer, check_scorer
from wordcraft_kg.models.scorers.ranking import mean_reciprocal_rank, rank_triples, sampled_for
from wordcraft_kg.models.scorers.recipes import RecipeScorer
from wordcraft_kg.models.scorers.scorer import Scorer, StoredScorer
from wordcraft_kg.runs.files import RunFiles
from wordcraft_kg.runs.record import read_finished_run

WEIGHTS, VOCABULARY = "model.safetensors", "vocabulary.json"
FOLDS_RECORD, FOLDS_TENSORS, CALIBRATION = "folds.json", "folds.safetensors", "calibration.json"
"""Files in a cross-fitted model: fold record, tensors ``fold0.entity_real``, ..., and calibration."""
FOLD_OUTPUTS = (FOLDS_RECORD, FOLDS_TENSORS, CALIBRATION)
OF_RECIPE = "of_recipe"
"""Tensor with folds by recipe."""
TRAIN_RESULTS = "train_results"
"""Tensor with the train sample's results; absent for unchanged train recipes."""
MODEL = "a model folder from train-complex, train-links or train-recipes"

SCORERS: Registry[type[StoredScorer]] = Registry(
    "wordcraft_kg.models", {kind.kind: kind for kind in (ComplExScorer, TableScorer, RecipeScorer)}
)
"""Stored scorers by kind, the key in ``vocabulary.json``."""


class Vocabulary(Record, frozen=True, kw_only=True):
    """The file ``vocabulary.json``: scorer kind, graph hash, and labels of the tensors' rows in id order."""

    format: Literal["wordcraft-kg vocabulary 1"] = "wordcraft-kg vocabulary 1"
    scorer: str
    graph: str
    entities: tuple[str, ...]
    relations: tuple[str, ...]


def load_scorer(
    folder: str | Path, *, graph: RecipeGraph | None = None, device: str = "cpu"
) -> Scorer:
    """Load a scorer from a model folder.

    A training command or ``save_scorer`` writes the folder. If given, ``graph`` must be the scorer's graph. The result
    is a :class:`~wordcraft_kg.models.scorers.cross_fitting.CrossFitted` scorer if the folder has folds. ArtefactError
    if the folder is unfinished, incomplete or damaged, GraphMismatchError if the scorer belongs to another graph, or
    the folds to another split.

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
            f"{folder / VOCABULARY} names scorer kind {vocabulary.scorer[:100]!r}; expected {' or '.join(SCORERS)}. "
            "Install the package that provides this kind, or restore a copy."
        )
    try:
        SCORERS[vocabulary.scorer].check(tensors, len(vocabulary.entities))
        scorer = make_scorer(
            vocabulary.scorer,
            tensors,
            vocabulary.entities,
            vocabulary.graph,
            device=device,
            name=folder.name,
        )
    except (KeyError, TypeError, ValueError, RuntimeError) as error:
        raise ArtefactError(
            f"{folder} does not contain a scorer ({reason(error)}). Train again."
        ) from None
    if FOLDS_RECORD in files.run.outputs:
        scorer = _cross_fitted(files, scorer, vocabulary)
    if graph is not None:
        check_scorer(scorer, graph)
    return scorer


def _cross_fitted(files: RunFiles, scorer: Scorer, vocabulary: Vocabulary) -> CrossFitted:
    path, inputs = files.folder / FOLDS_TENSORS, files.run.inputs
    record, tensors = files.record(FOLDS_RECORD, FoldsRecord), files.tensors(FOLDS_TENSORS)
    if record.hash != inputs.get("folds"):
        raise GraphMismatchError(
            f"{files.folder / FOLDS_RECORD} describes folds {record.hash[:12]}, but the model was trained with "
            f"{inputs.get('folds', 'none')[:12]}. Train again, or restore a copy."
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
        makers.append(
            partial(
                make_scorer,
                vocabulary.scorer,
                part,
                vocabulary.entities,
                vocabulary.graph,
                **settings,
            )
        )
    if OF_RECIPE not in tensors or tensors[OF_RECIPE].ndim != 1:
        raise ArtefactError(
            f"{path} has no assignment from recipes to folds. Train again, or restore a copy."
        )
    train_results = tensors.get(TRAIN_RESULTS)
    if train_results is not None and (
        train_results.shape != tensors[OF_RECIPE].shape or train_results.is_floating_point()
    ):
        raise ArtefactError(f"{path} has damaged train results. Train again, or restore a copy.")
    probabilities = (
        files.record(CALIBRATION, Probabilities) if CALIBRATION in files.run.outputs else None
    )
    results = None if train_results is None else train_results.numpy()
    return CrossFitted(scorer, makers, tensors[OF_RECIPE].numpy(), record, probabilities, results)


def make_scorer(
    kind: str,
    tensors: Mapping[str, torch.Tensor],
    entities: Sequence[str],
    graph_hash: str,
    **settings: Any,
) -> Scorer:
    """Make a scorer of a kind in :data:`SCORERS`; KeyError for a missing, ValueError for a wrong tensor."""
    scorer = SCORERS[kind].restored(tensors, entities, graph_hash, **settings)
    is_small = table_bytes(len(entities)) <= TABLE_LIMIT
    return TableScorer.of(scorer) if is_small and isinstance(scorer, FactoredScorer) else scorer


Tensors = Mapping[str, torch.Tensor]


def stored(scorer: TripleScorer) -> StoredScorer:
    """Return an equal scorer that can be stored, perhaps as a table; ConfigError if too large or not finite."""
    scorer, size = whole_of(scorer), len(scorer.entities)
    result: StoredScorer
    if isinstance(scorer, StoredScorer) and not isinstance(scorer, TableScorer):
        result = scorer
    elif table_bytes(size) <= TABLE_LIMIT:
        tables = [
            scorer.table(relation).to("cpu", torch.float32) for relation in range(len(RELATIONS))
        ]
        for relation, table in zip(RELATIONS, tables, strict=True):
            if table.shape != (size, size):
                raise ConfigError(
                    f"the scorer's {relation} table has shape {tuple(table.shape)}; expected {(size, size)}, by "
                    "head and tail."
                )
        result = TableScorer(torch.stack(tables), scorer.entities, scorer.graph_hash)
    else:
        raise ConfigError(
            f"a score table for {size:,} entities takes {len(RELATIONS) * size**2 * 4 / 2**20:,.0f} MiB; expected at "
            f"most {TABLE_LIMIT / 2**20:.0f} MiB. Only a ComplExScorer can be saved without a table."
        )
    if not all(torch.isfinite(tensor).all() for tensor in result.tensors().values()):
        raise ConfigError("some scores are not finite numbers. Nothing was written.")
    return result


def write_scorer(folder: Path, kind: str, tensors: Tensors, graph: RecipeGraph) -> None:
    """Write a scorer's tensors and vocabulary (kind, graph hash, labels) into a folder."""
    vocabulary = Vocabulary(
        scorer=kind, graph=graph.hash, entities=graph.entities, relations=RELATIONS
    )
    write_atomically(folder / WEIGHTS, safetensors.torch.save(copied(dict(tensors))))
    write_atomically(folder / VOCABULARY, dump_json(as_values(vocabulary)))


def write_folds(
    folder: Path, folds: Folds, whole: Scorer, kind: str, part: Callable[[int], tuple[str, Tensors]]
) -> FoldsRecord:
    """Write the models trained without each fold, and return the fold record.

    ``part`` returns the training triples' hash and the tensors for the model without a given fold; ``whole`` is the
    scorer trained on all train recipes, ``kind`` the kind of the fold scorers.
    """
    graph = folds.split.graph
    tensors = {OF_RECIPE: torch.from_numpy(folds.of_recipe.copy())}
    if folds.is_subsample:
        tensors[TRAIN_RESULTS] = torch.from_numpy(folds.train_sample.results.copy())
    records, histograms = [], []
    for number in range(folds.count):
        trained_on, own_tensors = part(number)
        tensors |= {f"fold{number}.{name}": tensor for name, tensor in own_tensors.items()}
        seen = folds.triples([number])
        own = recipe_triples(folds.recipes_of(number))
        queries = sampled_for(graph, own[~is_in(own, seen, graph.num_entities)])
        left_out = make_scorer(kind, own_tensors, graph.entities, graph.hash)
        histograms.append(predictions(left_out, folds, number))
        mrr, in_sample = (
            mean_reciprocal_rank(rank_triples(scorer, queries, folds.triples()))
            if len(queries)
            else None
            for scorer in (left_out, whole)
        )
        records.append(
            Fold(
                trained_on=trained_on,
                triples=len(seen),
                queries=2 * len(queries),
                mrr=mrr,
                in_sample_mrr=in_sample,
            )
        )
    record = FoldsRecord(seed=folds.seed, hash=folds.hash, folds=tuple(records))
    write_atomically(
        folder / CALIBRATION, dump_json(as_values(Probabilities.fit(whole, folds, histograms)))
    )
    write_atomically(folder / FOLDS_TENSORS, safetensors.torch.save(tensors))
    write_atomically(folder / FOLDS_RECORD, dump_json(as_values(record)))
    return record
