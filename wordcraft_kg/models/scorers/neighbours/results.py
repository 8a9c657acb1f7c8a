"""Results of a pair, without a look at all entities: candidates, and how likely each is.

Candidates come from two sides: results of the pair's neighbours, and those that the pair encoder
scores highest among all entities. A network of its own, the ranker of results, scores them by the
same features as the recipe ranker, which compares pairs that might make one goal and so learns
nothing about how frequent a goal is. Without an encoder there is the first side alone, and the
recipe ranker scores it.

With E entities and C candidates, a pair costs E Z for the encoder's scores, and C times the
features of a recipe.
"""

import numpy as np
import torch
from torch import Tensor

from wordcraft_kg.models.scorers.neighbours.candidate_loops import results_of_pairs
from wordcraft_kg.models.scorers.neighbours.knowledge import RecipeKnowledge
from wordcraft_kg.models.scorers.neighbours.lists import Lists
from wordcraft_kg.models.scorers.neighbours.pair_encoder import PairEncoder
from wordcraft_kg.models.scorers.neighbours.pair_features import only_pair

CANDIDATES = 64
"""Results that each side proposes: on a validation part of Infinite Craft, 32, 48 and 64 hold the
true result of .74, .77 and .80 of the pairs, if a known recipe makes it."""
_PAIRS = 64
"""Pairs whose results are scored at once."""


def propose_results(
    lists: Lists,
    encoder: PairEncoder | None,
    a: Tensor,
    b: Tensor,
    number: int = CANDIDATES,
) -> Tensor:
    """Return candidates for the results of pairs, each once, by ascending id; -1 at the end.

    Args:
        lists: of the same recipes as the encoder.
        encoder: scores all entities; None without.
        a: ids, shape (n,).
        b: ids, shape (n,).
        number: candidates of each side.

    Returns:
        shape (n, 2 number), int64; (n, number) without an encoder.
    """
    size = len(lists.norms)
    width = min(number, size)
    list_results = np.full((len(a), width), -1, dtype=np.int32)
    # Columns of a table are strided: machine code of another kind would be compiled for them.
    first = np.ascontiguousarray(a.cpu().numpy())
    second = np.ascontiguousarray(b.cpu().numpy())
    results_of_pairs(lists, first, second, list_results)
    proposals = torch.from_numpy(list_results).long()
    if encoder is not None:
        encoder_results = torch.empty(len(a), width, dtype=torch.int64)
        for start in range(0, len(a), _PAIRS):
            block = slice(start, start + _PAIRS)
            scores = encoder.result_scores(a[block], b[block])
            encoder_results[block] = scores.topk(width, dim=1).indices
        proposals = torch.cat([proposals, encoder_results], dim=1)
    # Empty places, and those of a candidate that both sides propose, go to the end.
    ordered = proposals.masked_fill(proposals < 0, size).sort(1).values
    is_again = torch.zeros_like(ordered, dtype=torch.bool)
    previous = ordered[:, :-1]
    is_again[:, 1:] = ordered[:, 1:] == previous
    candidates = ordered.masked_fill(is_again, size).sort(1).values
    return candidates.masked_fill(candidates == size, -1)


@torch.no_grad()
def results_of(
    knowledge: RecipeKnowledge,
    a: Tensor,
    b: Tensor,
    *,
    model: int = 0,
    number: int = CANDIDATES,
) -> tuple[Tensor, Tensor]:
    """Return candidates for the results of pairs, and their scores, best first.

    Args:
        knowledge: with or without an encoder.
        a: ids, shape (n,).
        b: ids, shape (n,).
        model: number of the model.
        number: candidates of each side.

    Returns:
        ids, shape (n, C), int64, E where there are fewer; and scores in nats, shape (n, C), -inf
        likewise: log-odds against each other; recipe scores without an encoder.
    """
    knowledge.ids(torch.stack([a, b]))  # raises IndexError
    lists = knowledge.lists(model)
    nothing = knowledge.num_entities
    has_ranker = knowledge.has_result_ranker
    encoder = knowledge.encoder(model) if has_ranker else None
    proposed = propose_results(lists, encoder, a, b, number).to(a.device)
    # Entities of other books, which come last, cannot be made.
    ids = proposed.masked_fill((proposed < 0) | (proposed > nothing), nothing)
    ranker = knowledge.ranker("results_" if has_ranker else "").model(model)
    # A recipe is a table of two slots, whose only pair is slot 0 with slot 1. In one order:
    # rounding would differ between a + b and b + a.
    table = torch.stack([torch.minimum(a, b), torch.maximum(a, b)], dim=1)
    width = ids.shape[1]
    scores = torch.zeros(ids.shape, device=a.device)
    for start in range(0, len(a), _PAIRS):
        block = slice(start, start + _PAIRS)
        # Each candidate is a goal for its pair's table: (pairs, C) to (pairs · C,).
        goals = ids[block].flatten()
        tables = table[block].repeat_interleave(width, 0)
        models = torch.full_like(goals, model)
        features = knowledge.features(goals, tables, models, only_pair(a.device))
        # (pairs · C, 1) to (pairs, C).
        scores[block] = ranker(features).view(-1, width)
    scores = scores.masked_fill(ids == nothing, -torch.inf)
    # Stable: equal scores keep the order of ids on every device.
    order = torch.sort(scores, dim=1, descending=True, stable=True).indices
    return ids.gather(1, order), scores.gather(1, order)
