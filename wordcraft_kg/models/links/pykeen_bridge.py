"""Bridge to PyKEEN: convert triples, compute all scores, and guard the global generators that PyKEEN seeds."""

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
    """Return triples (T, 3), and outside triples if any, as a PyKEEN triples factory with the graph's ids first."""
    nodes, relations, more = (
        ((), (), triples[:0])
        if outside is None
        else (outside.nodes, outside.relations, outside.triples)
    )
    return TriplesFactory(
        mapped_triples=torch.from_numpy(np.concatenate([triples, more])),
        entity_to_id={label: i for i, label in enumerate((*graph.entities, *nodes))},
        relation_to_id={label: i for i, label in enumerate((*RELATIONS, *relations))},
        create_inverse_triples=create_inverse_triples,
    )


@torch.no_grad()
def all_scores(model: Model, entities: torch.Tensor, relations: Sequence[int]) -> torch.Tensor:
    """Return all scores by relation, head and tail, (R, E, E), for PyKEEN ids in result order."""
    entities = entities.to(model.device)
    # 64 heads at a time: some interactions build a (heads, entities, dim) tensor.
    rows = [
        torch.cat(
            [
                model.predict_t(torch.stack([heads, torch.full_like(heads, relation)], dim=1))[
                    :, entities
                ]
                for heads in entities.split(64)
            ]
        )
        for relation in relations
    ]
    return torch.stack(rows).cpu()


def seed_everything(seed: int, epoch: int = 0) -> None:
    """Seed the global generators that PyKEEN uses (Python, NumPy, torch) by seed and epoch, in :func:`pykeen_guard`."""
    value = int(np.random.SeedSequence([seed, epoch]).generate_state(1)[0])
    random.seed(value)
    np.random.seed(value)  # noqa: NPY002 - PyKEEN's negative samplers use this generator
    torch.manual_seed(value)


@contextmanager
def pykeen_guard(seed: int, threads: int) -> Iterator[None]:
    """Seed the global generators for PyKEEN and set torch's CPU threads; restore both afterwards.

    Objects alive at the start are exempt from garbage collection: PyKEEN collects after each epoch, which takes 0.2 s
    for all imported objects.
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
        if not frozen_before:
            gc.unfreeze()


@contextmanager
def quiet_pykeen() -> Iterator[None]:
    """Suppress warnings from PyKEEN and torch about internal options."""
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
