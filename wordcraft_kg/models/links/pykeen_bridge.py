"""Bridge to PyKEEN: convert triples and models, and guard PyKEEN's global generators.

PyKEEN draws from the global generators of Python, NumPy and torch, which belong to the user's
program: :func:`pykeen_guard` seeds them for a training and restores them afterwards.

The page docs/link-prediction.md, *Custom scorers and PyKEEN models*, shows PyKEEN beside us.
"""

import gc
import logging
import random
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import numpy as np
import torch
from pykeen.models import Model
from pykeen.triples import TriplesFactory

from wordcraft_kg.base.errors import GraphMismatchError
from wordcraft_kg.graphs import RELATIONS, Ids, OpenedGraph, RecipeGraph
from wordcraft_kg.models.links.outside import OutsideTriples
from wordcraft_kg.models.scorers.factors import TableScorer
from wordcraft_kg.models.scorers.score_limits import check_table


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
    random.seed(value)
    np.random.seed(value)  # noqa: NPY002 - PyKEEN's negative samplers use this generator
    torch.manual_seed(value)


@contextmanager
def pykeen_guard(seed: int, threads: int) -> Iterator[None]:
    """Seed the global generators for PyKEEN and set torch's CPU threads; restore both afterwards.

    They are restored even after an error. Objects alive at the start are exempt from garbage
    collection: PyKEEN collects after each epoch, which takes 0.2 s for all imported objects.
    """
    states = random.getstate(), np.random.get_state(), torch.get_rng_state()  # noqa: NPY002
    cuda_states = torch.cuda.get_rng_state_all() if torch.cuda.is_available() else []
    threads_before = torch.get_num_threads()
    frozen_before = gc.get_freeze_count()
    torch.set_num_threads(threads)
    gc.freeze()
    try:
        seed_everything(seed)
        yield
    finally:
        random.setstate(states[0])
        np.random.set_state(states[1])  # noqa: NPY002
        torch.set_rng_state(states[2])
        if cuda_states:
            torch.cuda.set_rng_state_all(cuda_states)
        torch.set_num_threads(threads_before)
        # Unfreezing is all or nothing: objects that the user's program has frozen stay frozen.
        if not frozen_before:
            gc.unfreeze()


@contextmanager
def quiet_pykeen() -> Iterator[None]:
    """Suppress messages of PyKEEN, its helpers and torch's sparse optimisers on their options."""
    loggers = [logging.getLogger(name) for name in ("pykeen", "torch_max_mem")]
    levels = [logger.level for logger in loggers]
    for logger in loggers:
        logger.setLevel(logging.ERROR)
    try:
        with torch.sparse.check_sparse_tensor_invariants(enable=False):
            yield
    finally:
        for logger, level in zip(loggers, levels, strict=True):
            logger.setLevel(level)


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
        problems = []
        if missing:
            problems.append(f"{len(missing)} are missing ({', '.join(missing[:3])})")
        if unknown:
            problems.append(f"{len(unknown)} are unknown ({', '.join(unknown[:3])})")
        if problems:
            raise GraphMismatchError(
                f"the model's {name} do not match '{graph.name}': {', '.join(problems)}. Train "
                f"the model on dataset='wordcraft', dataset_kwargs={{'graph': {opened.source!r}}}."
            )
    # Before scoring, which would take long on a graph that is refused.
    check_table("a PyKEEN model", graph.num_entities)
    # A factory made from labelled triples sorts the labels, so its ids may differ from the graph's.
    entities = torch.tensor([factory.entity_to_id[label] for label in graph.entities])
    scores = all_scores(model, entities, [factory.relation_to_id[name] for name in RELATIONS])
    return TableScorer(scores, graph.entities, graph.hash, name=type(model).__name__)
