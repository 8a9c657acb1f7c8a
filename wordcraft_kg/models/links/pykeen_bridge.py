"""Bridge to PyKEEN: convert triples, compute all scores, and guard PyKEEN's global generators.

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

from wordcraft_kg.graphs.arrays import Ids
from wordcraft_kg.graphs.recipe_graph import RecipeGraph
from wordcraft_kg.graphs.triples import RELATIONS
from wordcraft_kg.models.links.outside import OutsideTriples


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
