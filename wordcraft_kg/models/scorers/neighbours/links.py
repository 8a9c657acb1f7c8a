"""Features of links: their names, and how they are computed for any entities and candidates.

Each link is computed by itself: loops follow the neighbours of both entities to the known links.
Those of componentOf share what depends on the result, so links are asked for by result. See "The
rankers" in docs/explanation/recipe-scorer.md.
"""

import numpy as np
import torch
from torch import Tensor

from wordcraft_kg.graphs import COMBINES_WITH, COMPONENT_OF, Ids
from wordcraft_kg.models.scorers.neighbours import link_loops
from wordcraft_kg.models.scorers.neighbours.lists import Lists

OF_COMPONENTS = (
    "words",
    "kernel",
    "uses",
    "made",
    "link",
    "link_words",
    "link_reverse",
    "link_with_goal",
    "combines",
    "link_partners",
    "link_steps",
    "regression",
    "word_regression",
    "goal_uses",
    "goal_made",
)
"""Features of a componentOf link from x to c, in the order of the link ranker's weights.

| feature | meaning |
|---|---|
| words, kernel | word cosine and similarity of x and c |
| uses, made | log(1 + recipes that use x, that make x) |
| link, link_words | log of known links x' -> c' of neighbours, by likeness and by words |
| link_reverse | log of links from c to neighbours of x: c as ingredient, x as result |
| link_with_goal, combines | log of x's neighbours that combine with c; whether x does |
| link_partners | log(1 + ingredients of c that combine with x) |
| link_steps | log(1 + ingredients of c that x is an ingredient of) |
| regression, word_regression | componentOf(x, c) by kernel regression: by k, by word vectors |
| goal_uses, goal_made | log(1 + recipes that use c, that make c) |
"""
OF_COMBINES = (
    "words",
    "kernel",
    "uses_sum",
    "uses_difference",
    "made_sum",
    "itself",
    "completion",
    "near_pairs",
    "word_regression",
)
"""Features of a combinesWith link between a and b, in the order of the link ranker's weights.

| feature | meaning |
|---|---|
| words, kernel | word cosine and similarity of a and b |
| uses_*, made_sum | sum and difference of log(1 + recipes that use it, that make it) |
| itself | whether a equals b |
| completion | log of paths over pairs with the same result, see ``kernel.completion`` |
| near_pairs | log of known pairs of a and a neighbour of b, or the other way round |
| word_regression | combinesWith(a, b) by kernel regression of word vectors |
"""
LINK_FEATURES = {COMBINES_WITH: OF_COMBINES, COMPONENT_OF: OF_COMPONENTS}
"""Names of the features of each relation."""
CELLS = 2**17
"""Links whose features are in memory at once, about."""


def links_by_key(lists: Lists, relation: int, keys: Ids, slots: Ids) -> Tensor:
    """Return the features of links between keys and slots.

    Args:
        lists: the lists.
        relation: relation id.
        keys: the results of componentOf links, or one end of combinesWith links; ids, shape (B,),
            -1 for none.
        slots: the other ends, ids, shape (B, A), -1 for none.

    Returns:
        shape (B, A, F), float32; zeros without a key or slot.
    """
    features = np.zeros((*slots.shape, len(LINK_FEATURES[relation])), dtype=np.float32)
    # Arrays without gaps, for which the loops are compiled.
    arrays = np.ascontiguousarray(keys), np.ascontiguousarray(slots), features
    if relation == COMBINES_WITH:
        link_loops.combines_features(lists, *arrays)
    else:
        link_loops.component_features(lists, *arrays)
    return torch.from_numpy(features)


def link_features(
    lists: Lists,
    relation: int,
    entities: Ids,
    candidates: Ids | None = None,
    *,
    heads: bool = False,
) -> Tensor:
    """Return the features of a relation's links between entities and candidates.

    combinesWith is symmetric, so ``heads`` counts for componentOf alone.

    Args:
        lists: the lists.
        relation: relation id.
        entities: ids on one side, shape (B,).
        candidates: ids on the other side, shape (B, N); None for all entities.
        heads: whether candidates are the heads.

    Returns:
        shape (B, N, F), float32.
    """
    size = len(lists.norms)
    has_results = relation == COMPONENT_OF and not heads
    if candidates is None and has_results:
        # Each entity is a result, and all heads share what depends on it: (T, B, F) to (B, T, F).
        slots = np.broadcast_to(entities, (size, len(entities)))
        by_result = links_by_key(lists, relation, np.arange(size), slots)
        return by_result.transpose(0, 1)
    if candidates is None:
        candidates = np.broadcast_to(np.arange(size), (len(entities), size))
    if has_results:
        heads_of_links = np.repeat(entities, candidates.shape[1])[:, None]
        one_by_one = links_by_key(lists, relation, candidates.ravel(), heads_of_links)
        return one_by_one.view(*candidates.shape, -1)
    return links_by_key(lists, relation, entities, candidates)
