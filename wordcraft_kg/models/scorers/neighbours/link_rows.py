"""Features of links between one entity and all others, or some of them.

A table of crafting asks for few links at a time, which :mod:`.feature_loops` looks up one by one.
Link prediction asks for all links of an entity. Most features of them are 0 beside a few, so loops
follow the known links from the entity instead: its neighbours, what is linked with these, and what
is near to that. Both ways give the same features.
"""

from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from wordcraft_kg.graphs.arrays import Ids
from wordcraft_kg.graphs.triples import COMBINES_WITH, COMPONENT_OF
from wordcraft_kg.models.scorers.kernel import TEXT, completion_parts
from wordcraft_kg.models.scorers.neighbours.lists import Floats, Lists, Numbers

BY_ROWS = 50_000
"""Most entities with which the links to some candidates are found among all links of an entity."""
OF_COMPONENTS = (
    "words",
    "kernel",
    "uses",
    "made",
    "link",
    "link_words",
    "link_exact",
    "link_to_goal",
    "link_reverse",
    "link_with_goal",
    "combines",
    "regression",
    "goal_uses",
    "goal_made",
)
"""Features of a componentOf link from x to c, in the order of the link ranker's weights.

| feature | meaning |
|---|---|
| words, kernel | word cosine and similarity of x and c |
| uses, made | log(1 + recipes that use x, that make x) |
| link, link_words | log of known links x' -> c' of neighbours, by likeness and by words |
| link_exact, link_to_goal | the same for x' = x alone, and for c' = c alone |
| link_reverse | log of links from c to neighbours of x: c as ingredient, x as result |
| link_with_goal, combines | log of x's neighbours that combine with c; whether x does |
| regression | componentOf(x, c) by kernel regression |
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
    "near_pairs_exact",
    "near_pairs",
    "regression",
)
"""Features of a combinesWith link between a and b, in the order of the link ranker's weights.

| feature | meaning |
|---|---|
| words, kernel | word cosine and similarity of a and b |
| uses_*, made_sum | sum and difference of log(1 + recipes that use it, that make it) |
| itself | whether a equals b |
| completion | log of paths over pairs with the same result, see ``kernel.completion`` |
| near_pairs_exact | log of known pairs of a and a neighbour of b, or the other way round |
| near_pairs | log of known pairs of neighbours, by likeness, each with the number of its results |
| regression | combinesWith(a, b) by kernel regression |
"""
CELLS = 2**17
"""Links whose features are in memory at once, about."""
_NO_LEAST = np.float32(0)
_DENSE = 32
"""With more candidates than a share of 1 / 32 of all entities, products with all are faster: they
copy no candidate's row."""


class Near(NamedTuple):
    """Neighbours of T entities, one after the other, the most similar first.

    Attributes:
        starts: where each entity's neighbours begin and the last one's end, shape (T + 1,).
        ids: the neighbours.
        alike: squared similarities.
        words: word cosines to the power 4.
    """

    starts: Ids
    ids: Numbers
    alike: Floats
    words: Floats


class Linked(NamedTuple):
    """Entities that are linked with each of T entities.

    Attributes:
        starts: where each entity's links begin and the last one's end, shape (T + 1,).
        ids: the linked entities, ascending.
        counts: number of recipes with the link, or 1.
    """

    starts: Ids
    ids: Numbers
    counts: Floats


class SparseRows(NamedTuple):
    """A sparse matrix with T rows.

    Attributes:
        starts: where each row begins and the last one ends, shape (T + 1,).
        columns: columns of the numbers that are not 0, row by row.
        values: these numbers.
    """

    starts: Ids
    columns: Numbers
    values: Floats

    @classmethod
    def of(cls, matrix: Any) -> "SparseRows":
        """Return the arrays of a SciPy matrix by rows, in the types that loops are compiled for."""
        return cls(
            matrix.indptr.astype(np.int64),
            matrix.indices.astype(np.int32),
            matrix.data.astype(np.float32),
        )


class _BothWays(NamedTuple):
    """Neighbour lists by entity, and by neighbour: who lists an entity as a neighbour."""

    near: Near
    back: Near


class LinkRows:
    """Computes features of links from a model's lists."""

    def __init__(self, lists: Lists):
        """Turn lists and hash tables into arrays that loops follow from an entity."""
        size = len(lists.norms)
        self.lists = lists
        self._uses = np.log1p(lists.num_uses).astype(np.float32)
        self._made = np.log1p(lists.num_makers).astype(np.float32)
        self._used_lists = _both_ways(lists.used, lists.used_alike, lists.used_words)
        self._made_lists = _both_ways(lists.made, lists.made_alike, lists.made_words)
        itself = np.arange(size, dtype=np.int32)[:, None]
        ones = np.ones((size, 1), dtype=np.float32)
        self._itself = _both_ways(itself, ones, ones)
        # Each recipe is read from both ingredients, but once if they are the same.
        is_other = lists.first != lists.second
        ingredients = np.concatenate([lists.first, lists.second[is_other]])
        partners = np.concatenate([lists.second, lists.first[is_other]])
        results = np.concatenate([lists.result, lists.result[is_other]])
        self._makes = _links(ingredients, results, size)
        self._made_of = Linked(lists.part_starts, lists.parts, lists.part_counts.astype(np.float32))
        self._pairs = _links(ingredients, partners, size)
        # The same links, each counted once whatever the number of its results.
        self._partners = self._pairs._replace(counts=np.ones_like(self._pairs.counts))

    def of_relation(
        self,
        relation: int,
        entities: Ids,
        candidates: Ids | None = None,
        *,
        heads: bool = False,
    ) -> Tensor:
        """Return the features of a relation's links: :meth:`combines` or :meth:`components`.

        combinesWith is symmetric, so ``heads`` counts for componentOf alone.

        Args:
            relation: relation id.
            entities: ids on one side, shape (B,).
            candidates: ids on the other side, shape (B, N); None for all entities.
            heads: whether candidates are the heads.

        Returns:
            shape (B, N, F), float32.
        """
        if candidates is not None and len(self._uses) > BY_ROWS:
            return self._one_by_one(relation, entities, candidates, heads=heads)
        features = []
        # Sums of a block have a cell for each of its entities and all others.
        step = max(1, CELLS // len(self._uses))
        for start in range(0, len(entities), step):
            block = slice(start, start + step)
            some = entities[block]
            others = None if candidates is None else candidates[block]
            if relation == COMBINES_WITH:
                features.append(self.combines(some, others))
            else:
                features.append(self.components(some, others, heads=heads))
        if not features:
            names = OF_COMBINES if relation == COMBINES_WITH else OF_COMPONENTS
            num_candidates = 0 if candidates is None else candidates.shape[1]
            return torch.zeros(0, num_candidates, len(names))
        return torch.cat(features)

    def _one_by_one(
        self,
        relation: int,
        entities: Ids,
        candidates: Ids,
        *,
        heads: bool,
    ) -> Tensor:
        """Return the features of :meth:`of_relation`, up to rounding, each link by itself.

        Following all links of an entity takes time for all entities, also for one candidate.

        Args:
            relation: relation id.
            entities: ids on one side, shape (B,).
            candidates: ids on the other side, shape (B, N).
            heads: whether candidates are the heads.
        """
        # Compiled loops are imported late: numba takes as long to import as all the rest.
        from wordcraft_kg.models.scorers.neighbours import link_loops

        keys = entities
        slots = candidates
        if relation == COMPONENT_OF and not heads:
            # The loops take links to one goal at a time, and here each candidate is a goal.
            keys = candidates.ravel()
            slots = np.repeat(entities, candidates.shape[1])[:, None]
        names = OF_COMPONENTS if relation == COMPONENT_OF else OF_COMBINES
        features = np.zeros((*slots.shape, len(names)), dtype=np.float32)
        if relation == COMPONENT_OF:
            link_loops.component_features(self.lists, keys, slots, features)
        else:
            # Plain tuples: machine code on the disk names the types of its arguments.
            halves, pairs = map(tuple, self.halves)
            link_loops.combines_features(self.lists, halves, pairs, keys, slots, features)
        return torch.from_numpy(features).view(*candidates.shape, len(names))

    def components(
        self,
        entities: Ids,
        candidates: Ids | None = None,
        *,
        heads: bool = False,
    ) -> Tensor:
        """Return the features of componentOf links, see :data:`OF_COMPONENTS`.

        Args:
            entities: ingredients, or goals if ``heads`` are asked for; ids, shape (B,).
            candidates: the other side of each link, ids (B, N); None for all entities.
            heads: whether candidates are the ingredients.

        Returns:
            shape (B, N, 14), float32.
        """
        from wordcraft_kg.models.scorers.neighbours.feature_loops import LEAST

        used = self._used_lists
        made = self._made_lists
        itself = self._itself
        makes = self._makes
        made_of = self._made_of
        partners = self._partners
        # (neighbours of x, links, neighbours of c), and links read from c.
        paths = (
            (used, makes, made, made_of, LEAST),
            (itself, makes, made, made_of, _NO_LEAST),
            (used, makes, itself, made_of, _NO_LEAST),
            (made, made_of, itself, makes, _NO_LEAST),
            (used, partners, itself, partners, _NO_LEAST),
        )
        sums = []
        for number, (of_head, links, of_tail, reverse, least) in enumerate(paths):
            path = (of_head.near, links, of_tail.back)
            if heads:
                path = (of_tail.near, reverse, of_head.back)
            # Only the first path has a feature by words, `link_words`.
            found = self._follow(entities, *path, least, by_words=number == 0)
            sums.append(found)
        link, exact, to_goal, with_result, with_goal = sums
        lists = self.lists
        sides = (lists.right, lists.left) if heads else (lists.left, lists.right)
        words, kernel = self._alike(entities, candidates)
        of_entity = _Side(
            uses=self._uses[entities, None],
            made=self._made[entities, None],
        )
        of_others = _Side(
            uses=_at(self._uses[None], candidates),
            made=_at(self._made[None], candidates),
        )
        head, tail = (of_others, of_entity) if heads else (of_entity, of_others)
        is_partner, _ = self._follow(entities, itself.near, partners, itself.back, _NO_LEAST)
        features = [
            words,
            kernel,
            head.uses,
            head.made,
            _log(_at(link[0], candidates)),
            _log(_at(link[1], candidates)),
            _log(_at(exact[0], candidates)),
            _log(_at(to_goal[0], candidates)),
            _log(_at(with_result[0], candidates)),
            _log(_at(with_goal[0], candidates)),
            _at(is_partner, candidates),
            _products(*sides, entities, candidates),
            tail.uses,
            tail.made,
        ]
        return _stacked(features, words.shape)

    def combines(self, entities: Ids, candidates: Ids | None = None) -> Tensor:
        """Return the features of combinesWith links, see :data:`OF_COMBINES`.

        Args:
            entities: ids, shape (B,).
            candidates: the other entity of each link, ids (B, N); None for all entities.

        Returns:
            shape (B, N, 10), float32.
        """
        from wordcraft_kg.models.scorers.neighbours.feature_loops import LEAST

        used = self._used_lists
        itself = self._itself
        # Neighbours on both sides: a limit on the product of similarities skips most pairs of
        # neighbours. With `itself` on one side there are few paths, and all count.
        near_pairs, _ = self._follow(entities, used.near, self._pairs, used.back, LEAST)
        of_own, _ = self._follow(entities, used.near, self._partners, itself.back, _NO_LEAST)
        of_other, _ = self._follow(entities, itself.near, self._partners, used.back, _NO_LEAST)
        words, kernel = self._alike(entities, candidates)
        # Shape (B, 1) against (B, N), or (1, T).
        uses = self._uses[entities, None]
        other_uses = _at(self._uses[None], candidates)
        made = self._made[entities, None]
        other_made = _at(self._made[None], candidates)
        others = candidates
        if others is None:
            others = np.arange(len(self._uses))[None]
        is_itself = others == entities[:, None]
        completed = self._completion(entities)
        features = [
            words,
            kernel,
            uses + other_uses,
            np.abs(uses - other_uses),
            made + other_made,
            is_itself.astype(np.float32),
            _log(_at(completed, candidates)),
            _log(_at(of_own + of_other, candidates)),
            _log(_at(near_pairs, candidates)),
            _products(self.lists.pair_left, self.lists.right, entities, candidates),
        ]
        return _stacked(features, words.shape)

    def _follow(
        self,
        entities: Ids,
        near: Near,
        links: Linked,
        back: Near,
        least: np.float32,
        *,
        by_words: bool = False,
    ) -> tuple[Floats, Floats]:
        """Return the sums of ``row_loops.follow``, (B, T), and those by words, else (B, 0).

        Args:
            entities: ids, shape (B,).
            near: neighbours of entities.
            links: what these are linked with.
            back: who lists these as neighbours.
            least: products of two similarities below this number are skipped.
            by_words: whether to add up by words, too.
        """
        # Compiled loops are imported late: numba takes as long to import as all the rest.
        from wordcraft_kg.models.scorers.neighbours.row_loops import follow

        size = len(self._uses)
        sums = np.zeros((len(entities), size), dtype=np.float32)
        sums_by_words = np.zeros((len(entities), size if by_words else 0), dtype=np.float32)
        # Plain tuples: machine code on the disk names the types of its arguments, and could not be
        # read any more if one of these classes had another name.
        arrays = (tuple(near), tuple(links), tuple(back))
        follow(entities, *arrays, least, sums, sums_by_words)
        return sums, sums_by_words

    def _alike(self, entities: Ids, candidates: Ids | None) -> tuple[Floats, Floats]:
        """Return word cosines and similarities k, as ``similar.similarity``, (B, N) each."""
        lists = self.lists
        structure = np.zeros((len(entities), len(lists.norms)), dtype=np.float32)
        for row, entity in enumerate(entities.tolist()):
            start = lists.near_starts[entity]
            end = lists.near_starts[entity + 1]
            neighbours = lists.near[start:end]
            structure[row, neighbours] = lists.near_cosines[start:end]
        words = _products(lists.vectors, lists.vectors, entities, candidates)
        own_norms = lists.norms[entities, None]
        other_norms = _at(lists.norms[None], candidates)
        norms = own_norms * other_norms
        positive = np.maximum(words, 0)
        of_words = np.float32(TEXT) * positive**2
        together = _at(structure, candidates) + of_words
        kernel = together / np.sqrt(norms)
        # Rounding can lift the similarity of equal profiles above 1.
        kernel = np.minimum(kernel, 1)
        others = candidates
        if others is None:
            others = np.arange(len(lists.norms))[None]
        is_same = others == entities[:, None]
        # An entity resembles itself, also without words.
        words[is_same] = 1
        kernel[is_same] = 1
        return words, kernel

    def _completion(self, entities: Ids) -> Floats:
        """Return ``kernel.completion`` of some entities and all others, shape (B, T)."""
        nodes, pairs = self._nodes_and_pairs
        rows = self._nodes_by_entity[entities]
        # From the left: few rows stay few in each product.
        scores = rows @ pairs @ pairs @ pairs @ nodes
        return np.asarray(scores.toarray(), dtype=np.float32)

    @cached_property
    def halves(self) -> "tuple[SparseRows, SparseRows]":
        """The matrices H, shape (T, nodes), and R, shape (nodes, nodes): completion is H R Hᵀ.

        With the matrices of :func:`~wordcraft_kg.models.scorers.kernel.completion_parts`, H is
        nodesᵀ R.
        """
        nodes, pairs = self._nodes_and_pairs
        half = nodes.T @ pairs
        return SparseRows.of(half.tocsr()), SparseRows.of(pairs)

    @cached_property
    def _nodes_by_entity(self) -> Any:
        """The nodes of each entity, sparse, shape (T, nodes)."""
        nodes, _ = self._nodes_and_pairs
        return nodes.T.tocsr()

    @cached_property
    def _nodes_and_pairs(self) -> tuple[Any, Any]:
        lists = self.lists
        recipes = np.stack([lists.first, lists.second, lists.result], axis=1)
        return completion_parts(recipes.astype(np.int64), len(lists.norms))


class _Side(NamedTuple):
    """How often recipes use and make the entities on one side of links, as logarithms."""

    uses: Floats
    made: Floats


def _both_ways(ids: Numbers, alike: Floats, words: Floats) -> _BothWays:
    """Return lists by entity and by neighbour.

    Args:
        ids: each entity's neighbours, shape (T, K), -1 at the end.
        alike: squared similarities, shape (T, K), descending.
        words: word cosines to the power 4, shape (T, K).
    """
    is_listed = ids >= 0
    rows, _ = np.nonzero(is_listed)
    entities = rows.astype(np.int32)
    neighbours = ids[is_listed]
    of_alike = alike[is_listed]
    of_words = words[is_listed]
    near = Near(_starts(entities, len(ids)), neighbours, of_alike, of_words)
    # By neighbour, then the most similar first, so that a search may end early.
    order = np.lexsort((entities, -of_alike, neighbours))
    starts = _starts(neighbours, len(ids))
    back = Near(starts, entities[order], of_alike[order], of_words[order])
    return _BothWays(near, back)


def _links(heads: Numbers, tails: Numbers, size: int) -> Linked:
    """Return the distinct links by head, with the number of times that each is given."""
    codes = heads.astype(np.int64) * size + tails
    distinct, counts = np.unique(codes, return_counts=True)
    rows, columns = np.divmod(distinct, size)
    starts = _starts(rows, size)
    return Linked(starts, columns.astype(np.int32), counts.astype(np.float32))


def _starts(rows: NDArray[np.integer], size: int) -> Ids:
    """Return where each of ``size`` rows begins and the last one ends, shape (size + 1,)."""
    ends = np.cumsum(np.bincount(rows, minlength=size))
    return np.concatenate([[0], ends]).astype(np.int64)


def _at(table: Floats, candidates: Ids | None) -> Floats:
    """Return the values of a table (B, T), or (1, T), at the candidates (B, N); None for all."""
    if candidates is None:
        return table
    if len(table) == 1:
        return table[0][candidates]
    return np.take_along_axis(table, candidates, axis=1)


def _products(
    left: Floats,
    right: Floats,
    entities: Ids,
    candidates: Ids | None,
) -> Floats:
    """Return ``left[entity] · right[candidate]``, shape (B, N)."""
    if candidates is None:
        return left[entities] @ right.T
    of_entities = left[entities]
    if _DENSE * candidates.shape[1] > len(right):
        of_all = of_entities @ right.T
        return _at(of_all, candidates)
    of_candidates = right[candidates]
    return np.asarray(np.einsum("bm,bnm->bn", of_entities, of_candidates))


def _log(sums: Floats) -> Floats:
    from wordcraft_kg.models.scorers.neighbours.feature_loops import FLOOR

    return np.log(FLOOR + sums)


def _stacked(features: list[Floats], shape: tuple[int, ...]) -> Tensor:
    """Return features of the same shape, or ones that broadcast to it, along a new last axis."""
    every = [np.broadcast_to(feature, shape) for feature in features]
    return torch.from_numpy(np.stack(every, axis=-1).astype(np.float32, copy=False))
