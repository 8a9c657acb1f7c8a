"""Scorers from models that PyKEEN's own pipeline has trained."""

import zlib
from pathlib import Path

import numpy as np
import pandas as pd
import torch
from pykeen.models import Model
from pykeen.triples import TriplesFactory

from wordcraft_kg.base.artefacts import check_output
from wordcraft_kg.base.errors import ArtefactError, ConfigError, GraphMismatchError
from wordcraft_kg.base.records import Count, Record
from wordcraft_kg.graphs.arrays import Ids
from wordcraft_kg.graphs.folder import KG, OpenedGraph, open_graph
from wordcraft_kg.graphs.triples import RELATIONS, is_in
from wordcraft_kg.models.links.pykeen_bridge import all_scores
from wordcraft_kg.models.saving import save_scorer
from wordcraft_kg.models.scorers.config import TABLE_LIMIT, table_bytes
from wordcraft_kg.models.scorers.factors import TableScorer

Vocabulary = dict[str, int]
"""PyKEEN's ids by label."""


class ImportedModel(Record):
    """A model of PyKEEN's as a model folder.

    Attributes:
        out: the folder.
        model: name of its class.
        triples: number of its training triples.
        held_out: number of those that only valid and test recipes give; with any, ``kg`` is full.
    """

    out: str
    model: str
    triples: Count
    held_out: Count
    kg: KG


def from_pykeen(model: Model, factory: TriplesFactory, opened: OpenedGraph) -> TableScorer:
    """Return the scorer of a model that PyKEEN has trained, by scoring all triples once.

    Args:
        model: the model, on any device; one with inverse triples is asked for tails like any other.
        factory: the triples that it was trained on. Its labels are matched with the graph's, its ids may differ.
        opened: the graph, and the split that the scorer is to be judged by.

    Raises:
        GraphMismatchError: if its entities or relations are not those of the graph.
        ConfigError: if the graph is too large for a table of all scores.

    Example:
        >>> from pykeen.pipeline import pipeline
        >>> data, quietly = {"graph": "kitchen"}, {"use_tqdm": False}
        >>> result = pipeline(
        ...     dataset="wordcraft", dataset_kwargs=data, model="DistMult", epochs=1, training_kwargs=quietly
        ... )
        >>> opened = open_graph("kitchen")
        >>> scorer = from_pykeen(result.model, result.training, opened)
        >>> save_scorer("models/distmult", scorer, opened, kg="partial").name
        'distmult'
    """
    return _scorer(model, dict(factory.entity_to_id), dict(factory.relation_to_id), opened)


def import_pykeen(
    result: str | Path, graph: str, out: str | Path, *, trust_pickle: bool = False, force: bool = False
) -> ImportedModel:
    """Write the model of a folder that ``PipelineResult.save_to_directory`` wrote as a model folder.

    Which triples the model has seen is read from the folder's training triples.

    Args:
        result: the folder.
        graph: graph folder, recipe book's file or known book's name.
        out: model folder to write.
        trust_pickle: read the model, which PyKEEN stores as a pickle. Reading a pickle runs whatever code is in it, so
            do this with files of your own, or of people whose programs you would run.
        force: replace ``out`` if it exists.

    Raises:
        ConfigError: unless ``trust_pickle``.
        ArtefactError: if the folder is incomplete, or holds no model of PyKEEN's.
        GraphMismatchError: if its entities or relations are not those of the graph.
        OutputExistsError: if ``out`` exists and ``force`` is False.
    """
    result, out = Path(result), Path(out)
    check_output(out, force=force)
    entities, relations = (_read_vocabulary(result, f"{what}_to_id.tsv.gz") for what in ("entity", "relation"))
    triples = _read_triples(result, len(entities), len(relations))
    pickled = result / "trained_model.pkl"
    if not pickled.is_file():
        raise ArtefactError(f"{pickled} is missing; expected a folder written by PyKEEN's save_to_directory.")
    if not trust_pickle:
        raise ConfigError(
            f"{pickled} is a pickle: reading it runs whatever code is in it. If it is your own, or you would run its "
            "author's programs, add `trust_pickle`. A model that is still in memory needs no pickle: "
            "from_pykeen and save_scorer in Python."
        )
    opened = open_graph(graph)
    model = _unpickled(pickled)
    scorer = _scorer(model, entities, relations, opened)
    held_out = int(is_in(opened.split.unseen, _in_ids(triples, entities, relations, opened), len(entities)).sum())
    kg: KG = "full" if held_out else "partial"
    name = type(model).__name__
    origin = f"{name}, trained by PyKEEN on {len(triples):,} triples, {held_out:,} of them held out by the split"
    save_scorer(out, scorer, opened, kg=kg, origin=origin, force=force)
    return ImportedModel(str(out), name, len(triples), held_out, kg)


def _scorer(model: Model, entities: Vocabulary, relations: Vocabulary, opened: OpenedGraph) -> TableScorer:
    graph = opened.graph
    for what, found, expected in (("entities", entities, graph.entities), ("relations", relations, RELATIONS)):
        lacking = [label for label in expected if label not in found]
        foreign = sorted(set(found) - set(expected))
        if lacking or foreign:
            said = [
                f"{len(labels)} {how} ({', '.join(labels[:3])})"
                for labels, how in ((lacking, "are missing"), (foreign, "are unknown"))
                if labels
            ]
            raise GraphMismatchError(
                f"the {what} of the model are not those of '{graph.name}': {', '.join(said)}. Train it on "
                f"dataset='wordcraft', dataset_kwargs={{'graph': {opened.source!r}}}."
            )
    if table_bytes(graph.num_entities) > TABLE_LIMIT:
        raise ConfigError(f"a table of all scores is too large for {graph.num_entities:,} entities.")
    scores = all_scores(
        model, torch.tensor([entities[label] for label in graph.entities]), [relations[name] for name in RELATIONS]
    )
    return TableScorer(scores, graph.entities, graph.hash, name=type(model).__name__)


def _in_ids(triples: Ids, entities: Vocabulary, relations: Vocabulary, opened: OpenedGraph) -> Ids:
    """Return triples of PyKEEN's ids as triples of the graph's."""
    of_entity = np.argsort([entities[label] for label in opened.graph.entities])
    of_relation = np.argsort([relations[name] for name in RELATIONS])
    heads, kinds, tails = triples.T
    return np.column_stack([of_entity[heads], of_relation[kinds], of_entity[tails]])


def _read_vocabulary(result: Path, name: str) -> Vocabulary:
    table = _read_table(result, name, ("id", "label"))
    if sorted(table["id"]) != list(range(len(table))):
        raise _damaged(result, name, f"its ids are not 0 to {len(table) - 1}")
    return dict(zip(table["label"], table["id"].tolist(), strict=True))


def _read_triples(result: Path, entities: int, relations: int) -> Ids:
    name, columns = "numeric_triples.tsv.gz", ("head", "relation", "tail")
    triples = _read_table(result, name, columns)[list(columns)].to_numpy(np.int64)
    if ((triples < 0) | (triples >= (entities, relations, entities))).any():
        raise _damaged(result, name, "a triple has an id that is in no vocabulary")
    return triples


def _read_table(result: Path, name: str, columns: tuple[str, ...]) -> pd.DataFrame:
    """Return one of the tables of ``training_triples/``; all columns but labels are of ids."""
    path = result / "training_triples" / name
    if not path.is_file():
        raise ArtefactError(f"{path} is missing; expected a folder written by PyKEEN's save_to_directory.")
    kinds = {column: str if column == "label" else np.int64 for column in columns}
    try:
        return pd.read_csv(path, sep="\t", usecols=list(columns), dtype=kinds, keep_default_na=False)
    except (ValueError, OSError, EOFError, zlib.error) as error:
        raise _damaged(result, name, str(error).splitlines()[0]) from None


def _damaged(result: Path, name: str, reason: str) -> ArtefactError:
    return ArtefactError(f"{result / 'training_triples' / name} is damaged ({reason}). Restore a copy.")


def _unpickled(path: Path) -> Model:
    try:
        model = torch.load(path, map_location="cpu", weights_only=False)
    except Exception as error:  # whatever classes of another version raise while they are rebuilt
        reason = (str(error) or type(error).__name__).splitlines()[0]
        raise ArtefactError(f"{path} cannot be read ({reason}). Was it written by another version of PyKEEN?") from None
    if not isinstance(model, Model):
        raise ArtefactError(f"{path} holds a {type(model).__name__}; expected a model of PyKEEN's.")
    return model
