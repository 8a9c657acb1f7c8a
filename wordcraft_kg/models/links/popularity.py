"""Popularity (log counts in the training triples) as part of ComplEx, in further dimensions.

A softmax over entities first learns how often each entity is an answer. On a small book the
embeddings learn little more, and counting works better. So a multiple of the log counts is added to
the scores. As further dimensions of the embeddings, the counts need no other kind of scorer.

The page docs/link-prediction.md describes the setting under *Tuning*.
"""

import numpy as np
import torch

from wordcraft_kg.graphs.arrays import Ids
from wordcraft_kg.graphs.triples import RELATIONS

DIMS = 3 * len(RELATIONS)
"""Number of complex dimensions for popularity, over all relations."""


def log_counts(triples: Ids, num_entities: int) -> tuple[torch.Tensor, torch.Tensor]:
    """Count entities as heads and as tails.

    Args:
        triples: ids of shape (T, 3).
        num_entities: number of entities E.

    Returns:
        ``log(1 + n)`` of the counts as head and as tail, by relation: two float32 tensors of shape
        (R, E).
    """
    heads, relations, tails = triples.T

    def log_count(ends: Ids) -> torch.Tensor:
        cells = relations * num_entities + ends
        counts = np.bincount(cells, minlength=len(RELATIONS) * num_entities)
        logs = torch.from_numpy(np.log1p(counts).astype(np.float32))
        return logs.reshape(len(RELATIONS), num_entities)

    return log_count(heads), log_count(tails)


def with_popularity(
    embeddings: dict[str, torch.Tensor], triples: Ids, weight: float
) -> dict[str, torch.Tensor]:
    """Add ``weight * (log(1 + n_head) + log(1 + n_tail))`` to all scores of ComplEx embeddings.

    Let ``f`` be the head term, ``g`` the tail term, ``x = (f + g) / 2`` and ``y = (f - g) / 2``. In
    a relation's three dimensions, entities have ``s + x / 2s``, ``s - x / 2s`` and ``s + i y / s``,
    and the relation has 1, -1 and -i:

    ``(s + x_h/2s)(s + x_t/2s) - (s - x_h/2s)(s - x_t/2s) = x_h + x_t`` and
    ``Re[-i (s + i y_h/s)(s - i y_t/s)] = y_h - y_t``, together ``f_h + g_t``. Any s > 0 is correct;
    ``s^2 = max |x| / 2`` keeps the cancelling terms as small as the sum.

    Args:
        embeddings: ``entity_real``, ``entity_imag`` (E, d), ``relation_real`` and ``relation_imag``
            (R, d).
        triples: the counted triples, ids of shape (T, 3).
        weight: 0 or more; 0 changes nothing.

    Returns:
        the same tensors with d + 6 dimensions.
    """
    if not weight:
        return embeddings
    as_head, as_tail = log_counts(triples, len(embeddings["entity_real"]))
    entity = []
    relation = []
    for number in range(len(RELATIONS)):
        f = weight * as_head[number]
        g = weight * as_tail[number]
        x = (f + g) / 2
        y = (f - g) / 2
        # Above 0 even if all counts are 0, because s is a divisor.
        s = (x.abs().max() / 2).sqrt().clamp(min=1e-3)
        half = x / (2 * s)
        entity.append(torch.stack([s + half, s - half, s + 1j * y / s], dim=1))
        # Other relations have zeros in these dimensions, so their scores do not change.
        rows = torch.zeros(len(RELATIONS), 3, dtype=torch.cfloat)
        rows[number] = torch.tensor([1, -1, -1j])
        relation.append(rows)
    of_entity_dims = torch.cat(entity, dim=1)
    more_of_relations = torch.cat(relation, dim=1)
    dims = {
        "entity_real": of_entity_dims.real,
        "entity_imag": of_entity_dims.imag,
        "relation_real": more_of_relations.real,
        "relation_imag": more_of_relations.imag,
    }
    return {name: torch.cat([embeddings[name], part], dim=1) for name, part in dims.items()}
