"""Load scorers from model folders, and write scorers and their folds.

A folder is data, not code: tensors are read by safetensors, records by their types, and both are
checked before a scorer is made, so a damaged or forged folder is an error instead of a wrong
answer.

The page docs/architecture.md, *On disk*, lists the files.
"""

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from copy import copy
from functools import partial
from pathlib import Path
from typing import Any, Literal

import safetensors.torch
import torch

from wordcraft_kg.base import (
    ArtefactError,
    ConfigError,
    GraphMismatchError,
    Record,
    as_values,
    dump_json,
    reason,
    write_atomically,
)
from wordcraft_kg.base.registry import Registry
from wordcraft_kg.base.tensors import MAX_WEIGHT, check_tensors, copied, largest, with_prefix
from wordcraft_kg.graphs import RELATIONS, Folds, Ids, RecipeGraph, is_in, triples_hash
from wordcraft_kg.models.scorers.cross_fitting import CrossFitted, Fold, FoldsRecord, whole_of
from wordcraft_kg.models.scorers.factors import ComplExScorer, SetTableScorer, TableScorer
from wordcraft_kg.models.scorers.probabilities import HeldOut, Probabilities, score_fold
from wordcraft_kg.models.scorers.protocol import TripleScorer, check_scorer
from wordcraft_kg.models.scorers.ranking import (
    mean_reciprocal_rank,
    rank_triples,
    sampled,
    sampled_for,
)
from wordcraft_kg.models.scorers.recipes import RecipeScorer
from wordcraft_kg.models.scorers.score_limits import check_table
from wordcraft_kg.models.scorers.scorer import Scorer, StoredScorer
from wordcraft_kg.models.scorers.sets.scorer import SetScorer
from wordcraft_kg.runs.record import RunFiles, read_finished_run

WEIGHTS = "model.safetensors"
VOCABULARY = "vocabulary.json"
FOLDS_RECORD = "folds.json"
FOLDS_TENSORS = "folds.safetensors"
"""Tensors of a cross-fitted model's folds, by names such as ``fold0.entity_real``."""
CALIBRATION = "calibration.json"
FOLD_OUTPUTS = (FOLDS_RECORD, FOLDS_TENSORS, CALIBRATION)
"""Further files of a cross-fitted model."""
FOLD_TRIPLES = 5_000
"""Most triples of a fold that are ranked, by two models: enough to see that it was left out."""
FOLD_SCORES = 2**23
"""Most scores for tails of these triples, but for the first 50: less time in large books."""
OF_RECIPE = "of_recipe"
"""Name of the tensor with each recipe's fold."""
TRAIN_RESULTS = "train_results"
"""Name of the tensor with the train sample's results; absent for unchanged train recipes."""
MODEL = "a model folder from train-complex, train-links or train-recipes"

_STORED = (ComplExScorer, TableScorer, RecipeScorer, SetScorer, SetTableScorer)
SCORERS: Registry[type[StoredScorer]] = Registry(
    "wordcraft_kg.models",
    {kind.kind: kind for kind in _STORED},
)
"""Stored scorers by kind, the key in ``vocabulary.json``."""


class Vocabulary(Record, frozen=True, kw_only=True):
    """The file ``vocabulary.json``: the meaning of the rows of the tensors.

    Attributes:
        format: name and version of the file format.
        scorer: scorer kind, a key in :data:`SCORERS`.
        graph: content hash of the recipe graph that the ids belong to.
        entities: labels of entities, in id order.
        relations: labels of relations, in id order.
    """

    format: Literal["wordcraft-kg vocabulary 1"] = "wordcraft-kg vocabulary 1"
    scorer: str
    graph: str
    entities: tuple[str, ...]
    relations: tuple[str, ...]

    def __post_init__(self) -> None:
        if self.relations != RELATIONS:
            raise ValueError(f"the relations are not {', '.join(RELATIONS)}")
        if len(set(self.entities)) < len(self.entities):
            raise ValueError("a label occurs twice among the entities")


def load_scorer(
    folder: str | Path,
    *,
    graph: RecipeGraph | None = None,
    device: str = "cpu",
) -> Scorer:
    """Load a scorer from a model folder.

    Args:
        folder: folder from a training command or ``save_scorer``.
        graph: the scorer must belong to this graph; None for any.
        device: torch device for scores.

    Returns:
        the scorer; a :class:`~wordcraft_kg.models.scorers.cross_fitting.CrossFitted` scorer if the
        folder has folds.

    Raises:
        ArtefactError: if the folder is unfinished, incomplete or damaged.
        GraphMismatchError: if the scorer belongs to another graph, or the folds to another
            training.

    Example:
        >>> scorer = load_scorer("models/kitchen")
        >>> scorer.score("water", "combinesWith", ["flour", "salt"]).shape
        torch.Size([2])
    """
    folder = Path(folder)
    files = RunFiles(folder, read_finished_run(folder, MODEL, WEIGHTS))
    tensors = files.tensors(WEIGHTS)
    vocabulary = files.record(VOCABULARY, Vocabulary)
    if vocabulary.scorer not in SCORERS:
        raise ArtefactError(
            f"{folder / VOCABULARY} names scorer kind {vocabulary.scorer[:100]!r}; expected "
            f"{' or '.join(SCORERS)}. Install the package that provides this kind, or restore a "
            "copy."
        )
    # RuntimeError is torch's, for tensors whose shapes do not fit together.
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
        folded = _cross_fitted(files, scorer, vocabulary, tensors)
        if isinstance(scorer, SetScorer):
            # It answers queries of its own, such as for goals that the graph lacks. The model of
            # all folds stays without them, for in-sample scores.
            scorer = copy(scorer)
            scorer.cross_fitted = folded
        else:
            scorer = folded
    if graph is not None:
        check_scorer(scorer, graph)
    return scorer


def _cross_fitted(
    files: RunFiles,
    scorer: Scorer,
    vocabulary: Vocabulary,
    full_tensors: "Tensors",
) -> CrossFitted:
    """Add the models of the folds; each becomes a scorer when it is first needed.

    ``full_tensors`` are the tensors of ``scorer``, some of which the folds share.
    """
    path = files.folder / FOLDS_TENSORS
    inputs = files.run.inputs
    record = files.record(FOLDS_RECORD, FoldsRecord)
    tensors = files.tensors(FOLDS_TENSORS)
    # Scores of another training's folds would leak the recipes that they were trained on.
    if record.hash != inputs.get("folds"):
        raise GraphMismatchError(
            f"{files.folder / FOLDS_RECORD} describes folds {record.hash[:12]}, but the model was "
            f"trained with {inputs.get('folds', 'none')[:12]}. Train again, or restore a copy."
        )
    kind = SCORERS[vocabulary.scorer]
    shared = {name: full_tensors[name] for name in kind.shared}
    parts = [shared | with_prefix(tensors, f"fold{fold}.") for fold in range(record.count)]
    ids = [name for name in (OF_RECIPE, TRAIN_RESULTS) if name == OF_RECIPE or name in tensors]
    # Checked now, because a fold's scorer is made in the middle of a training.
    try:
        for part in parts:
            kind.check(part, len(vocabulary.entities))
        check_tensors(tensors, dict.fromkeys(ids, "recipes int64"))
        # A recipe of a fold without a model would be scored by another fold's, or by none.
        if (tensors[OF_RECIPE] >= record.count).any():
            raise ValueError(f"{OF_RECIPE} names other folds than those of {FOLDS_RECORD}")
    except (KeyError, ValueError, IndexError) as error:
        raise ArtefactError(
            f"the models of {record.count} folds are incomplete or damaged in {path} "
            f"({reason(error)}). Train again, or restore a copy."
        ) from None
    makers = [
        partial(
            make_scorer,
            vocabulary.scorer,
            part,
            vocabulary.entities,
            vocabulary.graph,
            device=scorer.device,
            name=f"{scorer.name}, without fold {fold}",
        )
        for fold, part in enumerate(parts)
    ]
    results = tensors.get(TRAIN_RESULTS)
    probabilities = None
    if CALIBRATION in files.run.outputs:
        probabilities = files.record(CALIBRATION, Probabilities)
    return CrossFitted(
        scorer,
        makers,
        tensors[OF_RECIPE].numpy(),
        record,
        probabilities,
        train_results=None if results is None else results.numpy(),
    )


def make_scorer(
    kind: str,
    tensors: Mapping[str, torch.Tensor],
    entities: Sequence[str],
    graph_hash: str,
    **settings: Any,
) -> Scorer:
    """Make a scorer from a trained model's tensors.

    Args:
        kind: a key in :data:`SCORERS`.
        tensors: the tensors of this kind, by name.
        entities: labels in id order.
        graph_hash: content hash of the recipe graph that the ids belong to.
        settings: ``device`` and ``name``.

    Raises:
        KeyError: for an unknown kind, or if a tensor is missing.
        ValueError: if a tensor does not fit the entities.
    """
    return SCORERS[kind].restored(tensors, entities, graph_hash, **settings)


Tensors = Mapping[str, torch.Tensor]


def stored(scorer: TripleScorer) -> StoredScorer:
    """Return an equal scorer that can be stored: the scorer itself, or its score table.

    Of a cross-fitted scorer, this is the scorer trained on all folds.

    Raises:
        ConfigError: if a table would be too large, has the wrong shape, or a score is not a finite
            number.
    """
    scorer = whole_of(scorer)
    size = len(scorer.entities)
    result: StoredScorer
    # A table is made again, even from a table: its shape and type were never checked.
    if isinstance(scorer, StoredScorer) and not isinstance(scorer, TableScorer):
        result = scorer
    else:
        check_table("saving a scorer that is not a ComplExScorer", size)
        tables = [
            scorer.table(relation).to("cpu", torch.float32) for relation in range(len(RELATIONS))
        ]
        for relation, table in zip(RELATIONS, tables, strict=True):
            if table.shape != (size, size):
                raise ConfigError(
                    f"the scorer's {relation} table has shape {tuple(table.shape)}; expected "
                    f"{(size, size)}, by head and tail."
                )
        result = TableScorer(torch.stack(tables), scorer.entities, scorer.graph_hash)
    # A NaN would make every rank wrong, and no error would say so.
    if not all(largest(tensor) <= MAX_WEIGHT for tensor in result.tensors().values()):
        raise ConfigError(
            f"some scores are not finite, or above {MAX_WEIGHT:g}. Nothing was written. Divide the "
            "scores by a number."
        )
    return result


def write_scorer(folder: Path, kind: str, tensors: Tensors, graph: RecipeGraph) -> None:
    """Write a scorer's tensors and vocabulary into a folder.

    Args:
        folder: existing folder.
        kind: a key in :data:`SCORERS`.
        tensors: tensors by name, on any device.
        graph: the recipe graph, whose hash and labels go into the vocabulary.
    """
    vocabulary = Vocabulary(
        scorer=kind,
        graph=graph.hash,
        entities=graph.entities,
        relations=RELATIONS,
    )
    # Copies, because safetensors refuses tensors that share memory, such as views.
    write_atomically(folder / WEIGHTS, safetensors.torch.save(copied(dict(tensors))))
    write_atomically(folder / VOCABULARY, dump_json(as_values(vocabulary)))


def write_folds(
    folder: Path,
    folds: Folds,
    whole: Scorer,
    kind: str,
    part: Callable[[int], Tensors],
    *,
    restored: Callable[[int, Tensors], Scorer] | None = None,
    workers: int = 1,
) -> FoldsRecord:
    """Write the models trained without each fold, and return the fold record.

    Args:
        folder: existing folder.
        folds: the folds and the training recipes.
        whole: the scorer trained on all folds.
        kind: kind of the fold scorers, a key in :data:`SCORERS`.
        part: returns, for a fold's number, the tensors of the model trained without this fold.
        restored: makes a fold's scorer from its number and tensors; None for :func:`make_scorer`.
        workers: threads that evaluate models beside each other.
    """
    graph = folds.split.graph
    tensors = {OF_RECIPE: torch.from_numpy(folds.of_recipe.copy())}
    if folds.is_subsample:
        tensors[TRAIN_RESULTS] = torch.from_numpy(folds.train_sample.results.copy())
    # Filtered by all train triples: test recipes must not leak into a model folder.
    train_triples = folds.triples()

    def make_queries(number: int) -> Ids:
        in_sample_triples = folds.triples([number])
        # Other folds' recipes give some of the fold's triples too; these are not out of sample.
        fold_triples = folds.triples_of(number)
        new = fold_triples[~is_in(fold_triples, in_sample_triples, graph.num_entities)]
        affordable = max(50, FOLD_SCORES // graph.num_entities)
        return sampled(sampled_for(graph, new), min(FOLD_TRIPLES, affordable))

    queries = [make_queries(number) for number in range(folds.count)]

    def evaluated(number: int) -> tuple[Tensors, float | None, HeldOut]:
        own_tensors = part(number)
        left_out = (
            restored(number, own_tensors)
            if restored
            else make_scorer(kind, own_tensors, graph.entities, graph.hash)
        )
        mrr = _mrr(left_out, queries[number], train_triples)
        return own_tensors, mrr, score_fold(left_out, folds, number)

    def in_sample() -> list[float | None]:
        return [_mrr(whole, fold_queries, train_triples) for fold_queries in queries]

    records = []
    predicted = []
    shared = SCORERS[kind].shared
    pool = ThreadPoolExecutor(workers)
    try:
        # In one thread: what the whole model keeps, such as its lists, is made once.
        in_sample_mrrs = pool.submit(in_sample)
        evaluations = pool.map(evaluated, range(folds.count))
        for number, (own_tensors, mrr, held_out_scores) in enumerate(evaluations):
            tensors |= {
                f"fold{number}.{name}": tensor
                for name, tensor in own_tensors.items()
                if name not in shared
            }
            triples = folds.triples([number])
            fold = Fold(
                trained_on=triples_hash(triples),
                triples=len(triples),
                queries=2 * len(queries[number]),
                mrr=mrr,
                in_sample_mrr=in_sample_mrrs.result()[number],
            )
            records.append(fold)
            predicted.append(held_out_scores)
    finally:
        # After Ctrl-C, evaluations that are not begun are never made.
        pool.shutdown(cancel_futures=True)
    record = FoldsRecord(seed=folds.seed, hash=folds.hash, folds=tuple(records))
    probabilities = Probabilities.fit(whole, folds, predicted)
    write_atomically(folder / CALIBRATION, dump_json(as_values(probabilities)))
    write_atomically(folder / FOLDS_TENSORS, safetensors.torch.save(tensors))
    write_atomically(folder / FOLDS_RECORD, dump_json(as_values(record)))
    return record


def _mrr(scorer: Scorer, queries: Ids, known_triples: Ids) -> float | None:
    if not len(queries):
        return None
    return mean_reciprocal_rank(rank_triples(scorer, queries, known_triples))
