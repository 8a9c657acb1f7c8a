"""Popularity (log counts of entities in the training triples) as part of ComplEx, in three dimensions per relation.

A softmax over entities first learns how often each entity is an answer. On a small book the embeddings learn little
more, and counting works better. So a multiple of the log counts is added to the scores.
"""

import numpy as np
import torch

from wordcraft_kg.graphs.arrays import Ids
from wordcraft_kg.graphs.triples import RELATIONS

DIMS = 3 * len(RELATIONS)
"""Number of complex dimensions for popularity, over all relations."""


def log_counts(triples: Ids, num_entities: int) -> tuple[torch.Tensor, torch.Tensor]:
    """Count entities as heads and as tails of triples (T, 3); return ``log(1 + n)``, two tensors of shape (R, E)."""
    heads, relations, tails = triples.T
    shape = (len(RELATIONS), num_entities)
    counts = (
        np.bincount(relations * num_entities + ends, minlength=shape[0] * shape[1])
        for ends in (heads, tails)
    )
    as_head, as_tail = (
        torch.from_numpy(np.log1p(count).astype(np.float32)).reshape(shape) for count in counts
    )
    return as_head, as_tail


def with_popularity(
    embeddings: dict[str, torch.Tensor], triples: Ids, weight: float
) -> dict[str, torch.Tensor]:
    """Return ComplEx embeddings with ``weight * (log(1 + n_head) + log(1 + n_tail))`` added to all scores.

    Let ``f`` be the head term, ``g`` the tail term, ``x = (f + g) / 2`` and ``y = (f - g) / 2``. In a relation's three
    dimensions, entities have ``s + x / 2s``, ``s - x / 2s`` and ``s + i y / s``, and the relation has 1, -1 and -i:

    ``(s + x_h/2s)(s + x_t/2s) - (s - x_h/2s)(s - x_t/2s) = x_h + x_t`` and
    ``Re[-i (s + i y_h/s)(s - i y_t/s)] = y_h - y_t``, together ``f_h + g_t``. Any s > 0 is correct;
    ``s^2 = max |x| / 2`` keeps the cancelling terms as small as the sum.

    ``embeddings`` are ``entity_real``, ``entity_imag`` (E, d), ``relation_real`` and ``relation_imag`` (R, d); the
    result has d + 6 dimensions. A weight of 0 changes nothing.
    """
    if not weight:
        return embeddings
    as_head, as_tail = (
        weight * counts for counts in log_counts(triples, len(embeddings["entity_real"]))
    )
    entity, relation = [], []
    for number, (f, g) in enumerate(zip(as_head, as_tail, strict=True)):
        x, y = (f + g) / 2, (f - g) / 2
        s = (x.abs().max() / 2).sqrt().clamp(min=1e-3)
        entity.append(torch.stack([s + x / (2 * s), s - x / (2 * s), s + 1j * y / s], dim=1))
        rows = torch.zeros(len(RELATIONS), 3, dtype=torch.cfloat)
        rows[number] = torch.tensor([1, -1, -1j])
        relation.append(rows)
    more = {"entity": torch.cat(entity, dim=1), "relation": torch.cat(relation, dim=1)}
    return {
        f"{what}_{part}": torch.cat([embeddings[f"{what}_{part}"], getattr(values, part)], dim=1)
        for what, values in more.items()
        for part in ("real", "imag")
    }
