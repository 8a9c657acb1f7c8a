"""Bridge to PyKEEN: convert triples and models, and guard PyKEEN's global generators.

Triples from knowledge folders join the graph's in a training. Ids extend the graph's: further nodes
follow the E entities, and their relations follow the game's two. So the first E embeddings are the
entities', and the saved model holds these alone.

PyKEEN draws from the global generators of Python, NumPy and torch, which belong to the user's
program: :func:`pykeen_guard` seeds them for a training and restores them afterwards.

The page docs/link-prediction.md, *Custom scorers and PyKEEN models*, shows PyKEEN beside us, and
docs/outside-knowledge.md describes joint training.
"""

import gc
import logging
import random
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
import torch
from pykeen.models import Model
from pykeen.triples import TriplesFactory
from pykeen.utils import set_random_seed

from wordcraft_kg.base.errors import ConfigError, GraphMismatchError
from wordcraft_kg.base.tensors import torch_threads
from wordcraft_kg.graphs import RELATIONS, Ids, OpenedGraph, RecipeGraph, frozen
from wordcraft_kg.models.knowledge.knowledge_folder import TRIPLES, knowledge_files, read_triples_of
from wordcraft_kg.models.links.link_records import OutsideSummary
from wordcraft_kg.models.scorers.factors import TableScorer
from wordcraft_kg.models.scorers.score_limits import check_table


@dataclass(frozen=True, eq=False)
class OutsideTriples:
    """Triples over a graph's E entities and further nodes and relations.

    Attributes:
        nodes: names of the further nodes, with ids from E.
        relations: names of the further relations, with ids from 2.
        triples: ids of shape (T, 3), distinct, sorted.
        summary: numbers for reports, with the share of entities in the triples.
    """

    nodes: tuple[str, ...]
    relations: tuple[str, ...]
    triples: Ids
    summary: OutsideSummary


def outside_hashes(folders: Sequence[str]) -> dict[str, str]:
    """Return the hash of each folder's triples, for the run record.

    Raises:
        ConfigError: if a folder holds no triples.
        ArtefactError: if a folder is incomplete or damaged.
    """
    hashes = {}
    for number, folder in enumerate(folders, 1):
        outputs = knowledge_files(folder).run.outputs
        if TRIPLES not in outputs:
            raise ConfigError(
                f"`with` '{folder}' holds tables and no triples. Expected a folder from "
                "import-knowledge; `train-recipes` uses tables."
            )
        hashes[f"outside graph {number}"] = outputs[TRIPLES]
    return hashes


def read_outside(folders: Sequence[str], entities: Sequence[str]) -> OutsideTriples | None:
    """Read the triples of knowledge folders, with ids for a graph's ``entities``.

    Equal names in several folders are one node or relation.

    Returns:
        the triples; None without folders.

    Raises:
        ConfigError: if a folder has no triples, none with an entity, or a relation with the name of
            a recipe relation.
        ArtefactError: if a folder is incomplete or damaged.
    """
    # Raises ConfigError if a folder has no triples.
    if not outside_hashes(folders):
        return None
    places = {label: place for place, label in enumerate(entities)}
    relations: dict[str, int] = {name: place for place, name in enumerate(RELATIONS)}
    rows = list[tuple[int, int, int]]()
    for folder in folders:
        ends = set[int]()
        for head, relation, tail in read_triples_of(knowledge_files(folder)):
            # Such triples would count as recipes, also as those of the test part.
            if relation in RELATIONS:
                raise ConfigError(
                    f"`with` '{folder}': '{relation}' is a relation of recipes. Rename this "
                    "relation, and import the triples again."
                )
            # A new name gets the next id.
            head_id = places.setdefault(head, len(places))
            relation_id = relations.setdefault(relation, len(relations))
            tail_id = places.setdefault(tail, len(places))
            rows.append((head_id, relation_id, tail_id))
            ends |= {head_id, tail_id}
        if not any(end < len(entities) for end in ends):
            raise ConfigError(
                f"`with` '{folder}': none of the {len(ends):,} nodes in {TRIPLES} is one of the "
                f"{len(entities):,} entities, such as '{entities[0]}'. Make the folder for this "
                "graph."
            )
    # Equal triples of several folders are one.
    triples = frozen(np.unique(np.array(rows, dtype=np.int64), axis=0))
    endpoints = np.unique(triples[:, [0, 2]])
    summary = OutsideSummary(
        triples=len(triples),
        nodes=len(places) - len(entities),
        relations=len(relations) - len(RELATIONS),
        coverage=int((endpoints < len(entities)).sum()) / len(entities),
    )
    nodes = tuple(places)[len(entities) :]
    return OutsideTriples(nodes, tuple(relations)[len(RELATIONS) :], triples, summary)


def triples_factory(
    graph: RecipeGraph,
    triples: Ids,
    outside: OutsideTriples | None = None,
    *,
    create_inverse_triples: bool = False,
) -> TriplesFactory:
    """Return triples as a PyKEEN triples factory, with the graph's ids first.

    Args:
        graph: the recipe graph.
        triples: the graph's triples, ids of shape (T, 3).
        outside: triples from outside the book, which follow; None without.
        create_inverse_triples: as in PyKEEN.
    """
    entities = graph.entities
    relations: tuple[str, ...] = RELATIONS
    if outside is not None:
        entities += outside.nodes
        relations += outside.relations
        triples = np.concatenate([triples, outside.triples])
    return TriplesFactory(
        # A copy: PyKEEN keeps the tensor, and the graph's arrays are read-only.
        mapped_triples=torch.from_numpy(triples.copy()),
        entity_to_id={label: i for i, label in enumerate(entities)},
        relation_to_id={label: i for i, label in enumerate(relations)},
        create_inverse_triples=create_inverse_triples,
    )


@torch.no_grad()
def all_scores(model: Model, entities: torch.Tensor, relations: Sequence[int]) -> torch.Tensor:
    """Return a model's scores for all triples.

    Args:
        model: a PyKEEN model, which is left in evaluation mode.
        entities: PyKEEN's ids of the entities, in result order, shape (E,).
        relations: PyKEEN's ids of the relations, in result order.

    Returns:
        shape (R, E, E), by relation, head and tail, on the CPU.
    """
    entities = entities.to(model.device)
    tables = []
    for relation in relations:
        rows = []
        # 64 heads at a time: some interactions build a (heads, entities, dim) tensor.
        for heads in entities.split(64):
            queries = torch.stack([heads, torch.full_like(heads, relation)], dim=1)
            rows.append(model.predict_t(queries)[:, entities])
        tables.append(torch.cat(rows))
    return torch.stack(tables).cpu()


def seed_everything(seed: int, epoch: int = 0) -> None:
    """Seed the global generators that PyKEEN uses (Python, NumPy, torch) by seed and epoch.

    Call this within :func:`pykeen_guard`, which restores them.
    """
    # A hash of both numbers: seed + epoch would give seed 1 the random numbers of seed 0, an epoch
    # later.
    value = int(np.random.SeedSequence([seed, epoch]).generate_state(1)[0])
    set_random_seed(value)


@contextmanager
def pykeen_guard(seed: int, threads: int) -> Iterator[None]:
    """Seed the global generators for PyKEEN, set torch's CPU threads, and suppress messages.

    Messages are those of PyKEEN, its helpers and torch's sparse optimisers on their options. All is
    restored afterwards, even after an error. Objects alive at the start are exempt from garbage
    collection: PyKEEN collects after each epoch, which takes 0.2 s for all imported objects.
    """
    python_state = random.getstate()
    numpy_state = np.random.get_state()  # noqa: NPY002
    loggers = [logging.getLogger(name) for name in ("pykeen", "torch_max_mem")]
    levels = [logger.level for logger in loggers]
    for logger in loggers:
        logger.setLevel(logging.ERROR)
    gc.freeze()
    try:
        with (
            torch.random.fork_rng(range(torch.cuda.device_count())),
            torch_threads(threads),
            torch.sparse.check_sparse_tensor_invariants(enable=False),
        ):
            seed_everything(seed)
            yield
    finally:
        random.setstate(python_state)
        np.random.set_state(numpy_state)  # noqa: NPY002
        for logger, level in zip(loggers, levels, strict=True):
            logger.setLevel(level)
        gc.unfreeze()


def from_pykeen(model: Model, factory: TriplesFactory, opened: OpenedGraph) -> TableScorer:
    """Return a scorer for a trained PyKEEN model, with a table of all triples' scores.

    Args:
        model: a trained PyKEEN model on any device, perhaps with inverse triples.
        factory: the model's training triples. Labels must match the graph; ids may differ.
        opened: the recipe graph.

    Raises:
        GraphMismatchError: if model and graph have different entities or relations.
        ConfigError: if the graph is too large for a score table.

    Example:
        >>> from pykeen.pipeline import pipeline
        >>> data, quietly = {"graph": "kitchen"}, {"use_tqdm": False}
        >>> result = pipeline(
        ...     dataset="wordcraft",
        ...     dataset_kwargs=data,
        ...     model="DistMult",
        ...     epochs=1,
        ...     training_kwargs=quietly,
        ... )
        >>> opened = open_graph("kitchen")
        >>> scorer = from_pykeen(result.model, result.training, opened)
        >>> save_scorer("models/distmult", scorer, opened, kg="partial").name
        'distmult'
    """
    graph = opened.graph
    for name, ids, expected in (
        ("entities", factory.entity_to_id, graph.entities),
        ("relations", factory.relation_to_id, RELATIONS),
    ):
        missing = [label for label in expected if label not in ids]
        unknown = sorted(set(ids) - set(expected))
        if missing or unknown:
            raise GraphMismatchError(
                f"the model's {name} do not match '{graph.name}': {len(missing)} are missing "
                f"({', '.join(missing[:3])}), {len(unknown)} are unknown "
                f"({', '.join(unknown[:3])}). Train the model on dataset='wordcraft', "
                f"dataset_kwargs={{'graph': {opened.source!r}}}."
            )
    # Before scoring, which would take long on a graph that is refused.
    check_table("a PyKEEN model", graph.num_entities)
    # A factory made from labelled triples sorts the labels, so its ids may differ from the graph's.
    entities = torch.tensor([factory.entity_to_id[label] for label in graph.entities])
    scores = all_scores(model, entities, [factory.relation_to_id[name] for name in RELATIONS])
    return TableScorer(scores, graph.entities, graph.hash, name=type(model).__name__)
