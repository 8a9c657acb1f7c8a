"""Recipe knowledge by neighbour lists: features and scores of pairs at any size of a book."""

import math
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from types import MappingProxyType
from typing import Any, ClassVar, Self

import numpy as np
import torch
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits
from torch import Tensor, nn

from wordcraft_kg.base.tensors import torch_threads
from wordcraft_kg.graphs.arrays import Ids
from wordcraft_kg.graphs.triples import COMBINES_WITH, COMPONENT_OF, RELATIONS
from wordcraft_kg.models.scorers.neighbours.link_rows import (
    CELLS,
    OF_COMBINES,
    OF_COMPONENTS,
    LinkRows,
)
from wordcraft_kg.models.scorers.neighbours.lists import Lists, make_lists
from wordcraft_kg.models.scorers.pair_knowledge import PairKnowledge, pairs_of
from wordcraft_kg.models.scorers.ranker import RANKER, Ranker

OF_SLOTS = (
    *OF_COMPONENTS[:-2],
    "count",
    "evidence",
    "best_evidence",
    "words_evidence",
    "component",
)
"""Features of an ingredient x and a goal c; the sum and the minimum over both ingredients count.

Those of componentOf links, without ``goal_uses`` and ``goal_made``, come first.

| feature | meaning |
|---|---|
| count | log(1 + recipes that make c with x) |
| evidence | log of a sum over recipes that make c's neighbours, by likeness of c and of x |
| best_evidence, words_evidence | the largest term; the sum by words |
| component | score of componentOf(x, c) by the link ranker |
"""
OF_PAIRS = (
    "pair_evidence",
    "pair_words_evidence",
    "pair_best_evidence",
    "makes_anything",
    "makes_alike",
    "makes_best",
    "makes_anything_words",
    "makes_alike_words",
    "known",
    "makes",
    "pair_words",
    "pair_kernel",
    "itself",
    "goal_made",
    "goal_uses",
    "pair_regression",
    "combines_pair",
)
"""Features of a pair (a, b) and a goal c.

| feature | meaning |
|---|---|
| pair_evidence | log of the recipe-to-recipe kernel over recipes that make c's neighbours |
| pair_words_evidence, pair_best_evidence | the same by words; its largest term |
| makes_anything | log of known pairs (a', b') of neighbours, by likeness |
| makes_alike, makes_best | the same times the likeness of their results and c: sum, largest term |
| makes_anything_words, makes_alike_words | both sums by words |
| known, makes | a + b has known results; c is a known result |
| pair_words, pair_kernel, itself | word cosine and similarity of a and b; a equals b |
| goal_made, goal_uses | log(1 + recipes that make c, that use c) |
| pair_regression | combinesWith(a, b) by kernel regression |
| combines_pair | score of combinesWith(a, b), where outside knowledge tells of pairs; else 0 |
"""
FEATURES = (
    *(f"{name}_sum" for name in OF_SLOTS),
    *(f"{name}_min" for name in OF_SLOTS),
    *OF_PAIRS,
)
"""All features, in the order of the ranker's weights."""
_ROWS = 64
"""Fewest tables for a thread: starting it takes as long as a few tables."""
_BLOCK = 32
"""Most tables that a thread takes at once: few, so that all threads end at about the same time."""
LINK_FEATURES = {COMBINES_WITH: OF_COMBINES, COMPONENT_OF: OF_COMPONENTS}
"""Features of links by relation."""
LINK_RANKERS = tuple(f"{relation}_{name}" for relation in RELATIONS for name in RANKER)
"""Names of the link rankers' weights."""
LINK_TABLES = tuple(f"{relation}_table" for relation in RELATIONS)
"""Names of the tables of link scores."""
_TOGETHER = 256
"""Entities whose links are scored together."""
_FEW = 4
"""With more links of an entity than a share of 1 / 4, all its links are scored: that is faster."""
BUFFERS = (
    "num_own",
    "vectors",
    "near_words",
    "recipes",
    "seen",
    *RANKER,
    *LINK_RANKERS,
    *LINK_TABLES,
)
"""Names of the stored tensors."""


class NeighbourKnowledge(PairKnowledge):
    """Recipes, words and rankers, from which neighbour lists follow, for M models.

    The lists of a model are made when they are first needed, on the CPU, and are not stored: see
    the package for their mathematics and cost.

    Attributes:
        feature_names: :data:`FEATURES`.
        made_name: ``goal_made``.
        sampled_results: as in :class:`PairKnowledge`.
        buffer_names: :data:`BUFFERS`.
        num_own: shape (1,), int32: E, so that a file tells which entities are its own.
        vectors: shape (T, D), half: unit word vectors; D is 0 without words. Entities from E on are
            those of other books, which are neither on tables nor goals.
        near_words: shape (T, K_w), int32: neighbours by words, -1 at the end.
        recipes: shape (n, 3), int32: training recipes of all models together.
        seen: shape (M, n), bool: training recipes of each model.

    The link rankers' weights are buffers with the names in :data:`LINK_RANKERS` and the shapes of
    the rankers' weights in :class:`PairKnowledge`. Where links have features from outside the
    recipes, tables of their scores stand for the rankers: buffers with the names in
    :data:`LINK_TABLES`, shape (M, E, E), half, row = head; (M, 0, 0) elsewhere.
    """

    feature_names: ClassVar[tuple[str, ...]] = FEATURES
    made_name: ClassVar[str] = "goal_made"
    sampled_results: ClassVar[int] = 2_500
    buffer_names: ClassVar[tuple[str, ...]] = BUFFERS
    num_own: Tensor
    vectors: Tensor
    near_words: Tensor
    recipes: Tensor
    seen: Tensor

    def __init__(self, constants: Mapping[str, Tensor], num_entities: int | None = None):
        """Take the tensors in :data:`BUFFERS` by name.

        Args:
            constants: the tensors.
            num_entities: E; None for all T.
        """
        super().__init__()
        for name in BUFFERS:
            self.register_buffer(name, constants[name])
        self.num_entities = len(self.vectors) if num_entities is None else num_entities
        self._lists: dict[int, Lists] = {}
        self._link_rows: dict[int, LinkRows] = {}
        self.register_load_state_dict_post_hook(_forget)

    @classmethod
    def of_recipes(
        cls,
        recipes: Ids,
        vectors: NDArray[np.float16],
        near_words: Any,
        link_rankers: Mapping[int, Ranker] = MappingProxyType({}),
    ) -> Self:
        """Return the knowledge of recipes for a single model without ranker.

        Args:
            recipes: training recipes, ids (n, 3).
            vectors: unit word vectors, shape (E, D), zeros for entities without words.
            near_words: neighbours by words, shape (E, K_w), int32, -1 at the end.
            link_rankers: by relation; scores are 0 without one.
        """
        rows = torch.from_numpy(recipes.astype(np.int32))
        constants = {
            "num_own": torch.tensor([len(vectors)], dtype=torch.int32),
            "vectors": torch.from_numpy(vectors),
            "near_words": torch.from_numpy(near_words),
            "recipes": rows,
            "seen": torch.ones(1, len(rows), dtype=torch.bool),
            **_of_one_model(Ranker.empty(len(FEATURES))),
        }
        for number, relation in enumerate(RELATIONS):
            ranker = link_rankers.get(number) or Ranker.empty(len(LINK_FEATURES[number]))
            for name, weights in _of_one_model(ranker).items():
                constants[f"{relation}_{name}"] = weights
            constants[f"{relation}_table"] = torch.zeros(1, 0, 0, dtype=torch.half)
        return cls(constants)

    @classmethod
    def of_constants(cls, constants: Mapping[str, Tensor], num_entities: int) -> Self:  # noqa: D102 - inherited
        return cls(constants, num_entities)

    @classmethod
    def stacked(cls, models: Sequence[PairKnowledge]) -> Self:  # noqa: D102 - inherited
        known = [model for model in models if isinstance(model, NeighbourKnowledge)]
        # Models of folds share most recipes: each is stored once, with a mask for each model.
        of_all = torch.cat([model.recipes for model in known])
        every, number = of_all.unique(dim=0, return_inverse=True)
        num_models = sum(model.num_models for model in known)
        seen = torch.zeros(num_models, len(every), dtype=torch.bool)
        row = 0
        place = 0
        for model in known:
            # Where the model's recipes are in the common list.
            own = number[place : place + len(model.recipes)]
            seen[row : row + model.num_models, own] = model.seen
            row += model.num_models
            place += len(model.recipes)
        rankers = {
            name: torch.cat([getattr(model, name) for model in known])
            for name in (*RANKER, *LINK_RANKERS, *LINK_TABLES)
        }
        shared = {name: getattr(known[0], name) for name in ("num_own", "vectors", "near_words")}
        constants = {**shared, "recipes": every, "seen": seen, **rankers}
        stack = cls(constants, known[0].num_entities)
        # Lists that are made already serve the stack, too.
        first = 0
        for model in known:
            for number, lists in model._lists.items():
                stack._lists[first + number] = lists
            for number, rows in model._link_rows.items():
                stack._link_rows[first + number] = rows
            first += model.num_models
        return stack

    def with_link_tables(self, tables: Mapping[int, Tensor]) -> Self:
        """Return a copy whose links are scored by tables; only for a single model, M = 1.

        Args:
            tables: scores by relation, shape (E, E) each, row = head.
        """
        named = {f"{RELATIONS[number]}_table": each.half()[None] for number, each in tables.items()}
        return self.of_constants(self.constants() | named, self.num_entities)

    def of_entities(self, own: Tensor) -> Self:
        """Return the knowledge about the entities ``own``, ids (n,), which get the ids from 0.

        All other entities come last, and are no more than a source of knowledge.
        """
        is_other = torch.ones(self.num_entities, dtype=torch.bool).index_fill(0, own, False)
        order = torch.cat([own, is_other.nonzero()[:, 0]])
        place = torch.argsort(order)
        near = self.near_words[order].long()
        # -1, the end of a list, stays.
        renumbered = torch.where(near < 0, near, place[near.clamp(min=0)])
        recipes = place[self.recipes.long()]
        # As in a graph, the smaller ingredient comes first.
        recipes[:, :2] = recipes[:, :2].sort(1).values
        changed = {
            "num_own": torch.tensor([len(own)], dtype=torch.int32),
            "vectors": self.vectors[order],
            "near_words": renumbered.int(),
            "recipes": recipes.int(),
        }
        for name in LINK_TABLES:
            table = getattr(self, name)
            if table.numel():
                changed[name] = table[:, own][:, :, own]
        return self.of_constants(self.constants() | changed, len(own))

    def lists(self, model: int = 0) -> Lists:
        """Return a model's lists; made at the first call by one thread, so that none differ."""
        if model not in self._lists:
            recipes = self.recipes[self.seen[model]].cpu().numpy().astype(np.int64)
            near_words = self.near_words.cpu().numpy()
            others = list(self._lists.values())
            # All models have the same words: their lists share one copy.
            vectors = others[0].vectors if others else self.vectors.float().cpu().numpy()
            with torch_threads(1), threadpool_limits(1):
                self._lists[model] = make_lists(recipes, vectors, near_words)
        return self._lists[model]

    def features(  # noqa: D102 - inherited
        self,
        goal: Tensor,
        table: Tensor,
        model: Tensor,
        pairs: tuple[Tensor, Tensor] | None = None,
    ) -> Tensor:
        # Compiled loops are imported late: numba takes as long to import as all the rest.
        from wordcraft_kg.models.scorers.neighbours import feature_loops

        first, second = pairs or pairs_of(table.shape[1], table.device)
        one = first.cpu().numpy()
        other = second.cpu().numpy()
        goals = self._ids(goal)
        tables = self._ids(table)
        models = model.cpu().numpy()
        of_slots = np.zeros((*tables.shape, feature_loops.OF_SLOTS), dtype=np.float32)
        shape = (len(goals), len(one), feature_loops.OF_PAIRS)
        of_pairs = np.zeros(shape, dtype=np.float32)
        blocks: list[tuple[Lists, Ids]] = []
        for number in np.unique(models).tolist():
            rows = np.flatnonzero(models == number)
            num_blocks = math.ceil(len(rows) / _BLOCK)
            parts = np.array_split(rows, num_blocks)
            blocks += [(self.lists(number), part) for part in parts]

        def write(block: tuple[Lists, Ids]) -> None:
            """Write the features of a block's rows, which no other block has."""
            lists, rows = block
            slots = np.zeros((len(rows), *of_slots.shape[1:]), dtype=np.float32)
            pairs = np.zeros((len(rows), *of_pairs.shape[1:]), dtype=np.float32)
            feature_loops.table_features(lists, goals[rows], tables[rows], one, other, slots, pairs)
            of_slots[rows] = slots
            of_pairs[rows] = pairs

        # Blocks of all models together: a batch of a cross-fitted scorer has few rows for each.
        workers = min(torch.get_num_threads(), len(goals) // _ROWS)
        if workers <= 1:
            for block in blocks:
                write(block)
        else:
            # Rows do not depend on each other, and compiled loops run without Python's lock.
            with ThreadPoolExecutor(workers) as pool:
                list(pool.map(write, blocks))
        slots = torch.from_numpy(of_slots).to(goal.device)
        pairs_only = torch.from_numpy(of_pairs).to(goal.device)
        if self._link_table(COMPONENT_OF).numel():
            component = self._from_table(COMPONENT_OF, model, table, goal[:, None])
            a, b = (table.index_select(1, slot) for slot in (first, second))
            combines = self._from_table(COMBINES_WITH, model, a, b)
        elif len(one):
            # Features first, as rankers of several models need them.
            links = component_inputs(slots, pairs_only).permute(2, 0, 1)
            component = self._link_ranker(COMPONENT_OF).of_models(links, model)
            combines = torch.zeros(pairs_only.shape[:2], device=goal.device)
        else:
            # No pairs, and so no scores: all slots of a batch are empty.
            return torch.zeros(len(FEATURES), *pairs_only.shape[:2], device=goal.device)
        return features_of_pairs(slots, pairs_only, component, combines, first, second).permute(
            2, 0, 1
        )

    def _from_table(self, relation: int, model: Tensor, heads: Tensor, tails: Tensor) -> Tensor:
        """Return link scores of heads and tails, ids that broadcast to (B, N), as float32."""
        # Empty slots have no row; their pairs have no score either.
        last = self.num_entities - 1
        table = self._link_table(relation)
        return table[model[:, None], heads.clamp(max=last), tails.clamp(max=last)].float()

    def _link_ranker(self, relation: int) -> Ranker:
        """Return a relation's link rankers, of all models."""
        prefix = RELATIONS[relation]
        return Ranker(*(getattr(self, f"{prefix}_{name}") for name in RANKER))

    def _link_table(self, relation: int) -> Tensor:
        table: Tensor = getattr(self, f"{RELATIONS[relation]}_table")
        return table

    def link_rows(self, model: int = 0) -> LinkRows:
        """Return what computes the features of a model's links."""
        if model not in self._link_rows:
            self._link_rows[model] = LinkRows(self.lists(model))
        return self._link_rows[model]

    def link_scores(
        self,
        relation: int,
        entities: Tensor,
        candidates: Tensor | None = None,
        *,
        heads: bool = False,
        model: int = 0,
    ) -> Tensor:
        """Score the links of some entities by a link ranker.

        Args:
            relation: relation id.
            entities: ids on one side of the links, shape (B,).
            candidates: ids on the other side, shape (B, N); None for all entities.
            heads: whether candidates are the heads, not the tails.
            model: number of the model.

        Returns:
            shape (B, N), or (B, E), float32.
        """
        size = self.num_entities
        table = self._link_table(relation)
        if table.numel():
            of_entities = table[model][:, entities].T if heads else table[model][entities]
            return (
                of_entities if candidates is None else of_entities.gather(1, candidates)
            ).float()
        rows = self.link_rows(model)
        weights = self._link_ranker(relation).weights()
        ranker = Ranker(**{name: weights[name][model].cpu() for name in RANKER})
        width = size if candidates is None else candidates.shape[1]
        scores = torch.zeros(len(entities), width)
        step = max(1, CELLS // len(self.vectors))
        # Few and small products: further threads would mostly wait.
        with torch_threads(1):
            for start in range(0, len(entities), step):
                block = slice(start, start + step)
                some = entities[block].cpu().numpy()
                others = None if candidates is None else candidates[block].cpu().numpy()
                features = rows.of_relation(relation, some, others, heads=heads)
                scores[block] = ranker(features)[:, :width]
        return scores.to(entities.device)

    def scores_of_links(self, relation: int, heads: Tensor, tails: Tensor) -> Tensor:
        """Score links by the first model's link ranker.

        Links with the same head, or the same tail if these are fewer, are scored together.

        Args:
            relation: relation id.
            heads: ids, shape (n,).
            tails: ids, shape (n,).

        Returns:
            shape (n,), float32.
        """
        by_tail = len(tails.unique()) < len(heads.unique())
        key, other = (tails, heads) if by_tail else (heads, tails)
        order = key.argsort(stable=True)
        entities, counts = key[order].unique_consecutive(return_counts=True)
        starts = counts.cumsum(0) - counts
        # Entities with about as many links are scored together, so that little is computed twice.
        by_count = counts.argsort(stable=True)
        scores = torch.zeros(len(heads), device=heads.device)
        for some in by_count.split(_TOGETHER):
            width = int(counts[some].max())
            places = torch.arange(width, device=heads.device)
            # Entities with fewer links repeat their last one.
            last = (counts[some] - 1)[:, None]
            links = order[starts[some, None] + torch.minimum(places, last)]
            if _FEW * width > self.num_entities:
                of_all = self.link_scores(relation, entities[some], heads=by_tail)
                scores[links] = of_all.gather(1, other[links])
            else:
                candidates = other[links]
                scores[links] = self.link_scores(
                    relation,
                    entities[some],
                    candidates,
                    heads=by_tail,
                )
        return scores

    def support_of(  # noqa: D102 - inherited
        self,
        a: int,
        b: int,
        goal: int,
        model: int,
    ) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        from wordcraft_kg.models.scorers.neighbours.feature_loops import support_terms

        lists = self.lists(model)
        numbers = lists.support[goal]
        terms = np.zeros((len(numbers), 2), dtype=np.float32)
        support_terms(lists, a, b, goal, terms)
        # -1 ends the list, so the terms of its recipes come first.
        numbers = numbers[numbers >= 0]
        recipes = np.stack([lists.first, lists.second, lists.result], axis=1)[numbers]
        straight, crossed = torch.from_numpy(terms[: len(numbers)]).unbind(1)
        like_goal = torch.from_numpy(lists.support_alike[goal, : len(numbers)].copy())
        return torch.from_numpy(recipes.astype(np.int64)), like_goal, straight, crossed

    def component_scores(self, entities: Tensor) -> Tensor:  # noqa: D102 - inherited
        return self.link_scores(COMPONENT_OF, entities)

    def word_cosines(self, entity: int, others: Tensor) -> Tensor:  # noqa: D102 - inherited
        return self.vectors[others].float() @ self.vectors[entity].float()

    def have_recipes(self, entity: int, others: Tensor) -> Tensor:  # noqa: D102 - inherited
        lists = self.lists()
        first = torch.from_numpy(lists.first)
        second = torch.from_numpy(lists.second)
        partners = torch.cat([second[first == entity], first[second == entity]])
        return torch.isin(others, partners)

    def log_uses(self) -> Tensor:  # noqa: D102 - inherited
        uses = self.lists().num_uses[: self.num_entities]
        return torch.from_numpy(uses).float().log1p()

    def knows(self, recipes: Tensor, model: int) -> Tensor:  # noqa: D102 - inherited
        size = len(self.vectors)
        known = _codes(self.recipes[self.seen[model]].long(), size)
        return torch.isin(_codes(recipes.long(), size), known)

    def _ids(self, entities: Tensor) -> Ids:
        """Return ids for compiled loops, which check no bounds: -1 for E, the empty slot."""
        ids = entities.cpu().numpy()
        if ids.size and not 0 <= ids.min() <= ids.max() <= self.num_entities:
            raise IndexError(f"entity ids must be 0 .. {self.num_entities}")
        return np.where(ids == self.num_entities, -1, ids)

    def intermediates(
        self,
        goal: Tensor,
        table: Tensor,
        model: Tensor,
        *,
        attempts: int,
        width: int,
        near: int,
    ) -> Tensor:
        """Return entities that a plan may make before the goal, shape (B, W), the best first.

        Args:
            goal: shape (B,).
            table: shape (B, A), E for empty slots.
            model: shape (B,).
            attempts: attempts left, 2 or more.
            width: W; missing entities have the id E.
            near: entities that stand for all others in a further attempt.

        Raises:
            IndexError: for an id out of range.
        """
        from wordcraft_kg.models.scorers.neighbours.candidate_loops import intermediates

        goals = self._ids(goal)
        tables = self._ids(table)
        models = model.cpu().numpy()
        found = np.full((len(goals), width), -1, dtype=np.int32)
        for number in np.unique(models).tolist():
            rows = np.flatnonzero(models == number)
            # Indexing by rows makes a copy, which the loop fills.
            of_rows = found[rows]
            intermediates(
                self.lists(number),
                goals[rows],
                tables[rows],
                attempts - 2,
                near,
                of_rows,
            )
            found[rows] = of_rows
        ids = torch.from_numpy(found.astype(np.int64)).to(goal.device)
        # Entities of other books cannot be made.
        is_own = (ids >= 0) & (ids < self.num_entities)
        return ids.masked_fill(~is_own, self.num_entities)


def component_inputs(slots: Tensor, pairs: Tensor) -> Tensor:
    """Return the features of componentOf links between slots and goals, for the link ranker.

    Args:
        slots: features of slots, as loops write them, shape (B, A, 16).
        pairs: features of pairs, shape (B, P, 16): they tell the goals' numbers of recipes.

    Returns:
        shape (B, A, 14), in the order of :data:`~.link_rows.OF_COMPONENTS`.
    """
    of_links = len(OF_COMPONENTS) - 2
    numbers = [OF_PAIRS.index(name) for name in OF_COMPONENTS[of_links:]]
    # Pairs with an empty slot are zeros, others have the goal's numbers.
    of_goal = pairs[..., numbers].amax(1)
    of_goals = of_goal[:, None].expand(-1, slots.shape[1], -1)
    return torch.cat([slots[..., :of_links], of_goals], dim=-1)


def features_of_pairs(
    slots: Tensor,
    pairs: Tensor,
    component: Tensor,
    combines: Tensor,
    one: Tensor,
    other: Tensor,
) -> Tensor:
    """Return the features of pairs, in the order of :data:`FEATURES`.

    Args:
        slots: features of slots, as loops write them, shape (B, A, 16).
        pairs: features of pairs, shape (B, P, 16).
        component: link scores of slots and goals, shape (B, A).
        combines: link scores of pairs, shape (B, P).
        one: first slot of each pair, shape (P,).
        other: second slot of each pair, shape (P,).

    Returns:
        shape (B, P, F).
    """
    of_slots = torch.cat([slots, component[..., None]], dim=-1)
    of_one = of_slots.index_select(1, one)
    of_other = of_slots.index_select(1, other)
    least = torch.minimum(of_one, of_other)
    return torch.cat([of_one + of_other, least, pairs, combines[..., None]], dim=-1)


def _of_one_model(ranker: Ranker) -> dict[str, Tensor]:
    """Return a ranker's weights by name, with a first axis for a single model."""
    return {name: weights[None] for name, weights in ranker.weights().items()}


def _codes(recipes: Tensor, size: int) -> Tensor:
    """Return a number for each recipe, ids (n, 3), whatever the order of its ingredients."""
    low = torch.minimum(recipes[:, 0], recipes[:, 1])
    high = torch.maximum(recipes[:, 0], recipes[:, 1])
    return (low * size + high) * size + recipes[:, 2]


def _forget(knowledge: nn.Module, _: object) -> None:
    """Drop lists that were made from other recipes."""
    assert isinstance(knowledge, NeighbourKnowledge)
    knowledge._lists = {}
    knowledge._link_rows = {}
