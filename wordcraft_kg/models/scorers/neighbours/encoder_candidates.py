"""Entities that a plan may make before its goal, by the pair encoder.

Neighbour lists propose what similar pairs make. The encoder proposes what the table's pairs might
make, among all entities, and prefers those that make the goal with an entity on the table::

    w(x) = max_{a, b in T} log P(x | a, b) + max_{t in T + x} s(x, t, goal)

P is the softmax of the encoder's scores over all results. With E entities and A slots, a state
costs A² E Z.
"""

import torch
from torch import Tensor

from wordcraft_kg.models.scorers.neighbours.pair_encoder import PairEncoder

LIKELY = 128
"""Entities that the table's pairs make most likely, and whose use for the goal is scored."""


@torch.no_grad()
def likely_intermediates(
    encoder: PairEncoder,
    goal: int,
    table: Tensor,
    number: int,
    likely: int = LIKELY,
) -> Tensor:
    """Return entities that a plan may make before the goal, the best first.

    Args:
        encoder: scores all results.
        goal: id of the goal.
        table: ids of the entities on the table, shape (A,), without empty slots.
        number: most entities to return.
        likely: entities whose use is scored.

    Returns:
        ids, shape (n,), with n up to ``number``; neither the goal nor entities on the table.
    """
    size = len(encoder.bias)
    one, other = torch.triu_indices(len(table), len(table), device=table.device)
    of_pairs = encoder.result_scores(table[one], table[other])
    makes = of_pairs.log_softmax(1).amax(0)
    # Neither the goal nor an entity on the table is made before the goal.
    makes[table] = -torch.inf
    makes[goal] = -torch.inf
    most = min(likely, size - len(table.unique()) - 1)
    if most <= 0:
        return table[:0]
    best = makes.topk(most)
    # Each candidate with all entities on the table, and with itself.
    partners = torch.cat([table.expand(most, -1), best.indices[:, None]], dim=1)
    candidates = best.indices[:, None].expand_as(partners)
    goals = torch.full_like(best.indices, goal)
    needs = encoder.features(candidates, partners, goals)[..., 0].amax(1)
    order = torch.sort(best.values + needs, descending=True, stable=True).indices
    return best.indices[order[:number]]
