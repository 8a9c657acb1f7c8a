"""Recipe knowledge by neighbour lists: scores of pairs and links, and what supports them."""

import math
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from types import MappingProxyType
from typing import Any, NamedTuple, Self

import numpy as np
import torch
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits
from torch import Tensor, nn

from wordcraft_kg.base.tensors import torch_threads
from wordcraft_kg.graphs.arrays import Ids, recipe_keys
from wordcraft_kg.graphs.triples import COMBINES_WITH, COMPONENT_OF, RELATIONS
from wordcraft_kg.models.scorers.neighbours.link_rows import CELLS, LinkRows
from wordcraft_kg.models.scorers.neighbours.lists import Lists, make_lists
from wordcraft_kg.models.scorers.neighbours.pair_encoder import ENCODER, PairEncoder
from wordcraft_kg.models.scorers.neighbours.pair_features import (
    FEATURES,
    OF_ENCODER,
    component_inputs,
    features_of_pairs,
    pairs_of,
    square_of,
)
from wordcraft_kg.models.scorers.neighbours.stored import (
    LINK_FEATURES,
    LINK_RANKERS,
    LINK_TABLES,
    RESULT_RANKER,
    WITH_ENCODER,
    check_stored,
    num_features,
    stored_names,
)
from wordcraft_kg.models.scorers.ranker import RANKER, Ranker

_ROWS = 64
"""Fewest tables for a thread: starting it takes as long as a few tables."""
_BLOCK = 32
"""Most tables that a thread takes at once: few, so that all threads end at about the same time."""
_TOGETHER = 256
"""Entities whose links are scored together."""
_FEW = 4
"""With more links of an entity than a share of 1 / 4, all its links are scored: that is faster."""
LEAST_SHARE = 0.01
"""Smallest evidence share of a supporting recipe that counts as a reason."""


class Support(NamedTuple):
    """A known recipe that supports another recipe, by ids, and its weight.

    The weight is the recipe similarity, 1 for equality: the product of entity similarities for both
    ingredients (in the better order) and the result. ``share`` is relative to the sum over all
    supporting recipes, ``strength`` to the strongest of them.
    """

    recipe: tuple[int, int, int]
    weight: float
    share: float
    strength: float


class RecipeKnowledge(nn.Module):
    """Recipes, words and rankers, from which neighbour lists follow, for M models.

    The lists of a model are made when they are first needed, on the CPU, and are not stored: see
    the package for their mathematics and cost.

    Attributes:
        num_own: shape (1,), int32: E, so that a file tells which entities are its own.
        vectors: shape (T, D), half: unit word vectors; D is 0 without words. Entities from E on are
            those of other books, which are neither on tables nor goals.
        near_words: shape (T, K_w), int32: neighbours by words, -1 at the end.
        recipes: shape (n, 3), int32: training recipes of all models together.
        seen: shape (M, n), bool: training recipes of each model.
        num_entities: E, also the id of an empty slot.
        has_encoder: whether there is a pair encoder.
        first: the recipe rankers' weights, with H hidden units: shape (M, F, H).
        first_bias: shape (M, H).
        second: shape (M, H).
        bias: shape (M,).
        workers: most threads that compute features, whose number never changes a bit; None for as
            many as torch uses.

    The link rankers' weights are buffers with the names in :data:`~.stored.LINK_RANKERS`, shaped as
    those of the recipe rankers. Where links have features from outside the recipes, tables of their
    scores stand for the rankers: buffers with the names in :data:`~.stored.LINK_TABLES`, shape (M,
    E, E), half, row = head; (M, 0, 0) elsewhere.
    """

    num_entities: int
    first: Tensor
    first_bias: Tensor
    second: Tensor
    bias: Tensor
    num_own: Tensor
    vectors: Tensor
    near_words: Tensor
    recipes: Tensor
    seen: Tensor
    results_second: Tensor

    def __init__(
        self,
        constants: Mapping[str, Tensor],
        num_entities: int | None = None,
        num_models: int | None = None,
    ):
        """Take the tensors in :data:`~.stored.BUFFERS` by name, on which all loops rely.

        Args:
            constants: the tensors, perhaps from a damaged file.
            num_entities: E, which the tensors must agree with; None for the stored number.
            num_models: M likewise.

        Raises:
            KeyError: if a tensor is missing.
            ValueError: if a tensor does not fit, see :func:`~.stored.check_stored`.
        """
        super().__init__()
        self.workers: int | None = None
        if num_entities is None:
            num_entities = int(constants["num_own"].sum())
        check_stored(constants, num_entities, num_models)
        self.num_entities = num_entities
        self._names = stored_names(constants)
        for name in self._names:
            self.register_buffer(name, constants[name])
        self.has_encoder = self._names == WITH_ENCODER
        self._lists: dict[int, Lists] = {}
        self._link_rows: dict[int, LinkRows] = {}
        self.register_load_state_dict_post_hook(_renew)

    @classmethod
    def of_recipes(
        cls,
        recipes: Ids,
        vectors: NDArray[np.float16],
        near_words: Any,
        link_rankers: Mapping[int, Ranker] = MappingProxyType({}),
        encoder: PairEncoder | None = None,
    ) -> Self:
        """Return the knowledge of recipes for a single model without ranker.

        Args:
            recipes: training recipes, ids (n, 3).
            vectors: unit word vectors, shape (E, D), zeros for entities without words.
            near_words: neighbours by words, shape (E, K_w), int32, -1 at the end.
            link_rankers: by relation; scores are 0 without one.
            encoder: pair encoder of the same words; None without.
        """
        of_pairs = Ranker.empty(num_features(has_encoder=encoder is not None))
        rows = torch.from_numpy(recipes.astype(np.int32))
        constants = {
            "num_own": torch.tensor([len(vectors)], dtype=torch.int32),
            "vectors": torch.from_numpy(vectors),
            "near_words": torch.from_numpy(near_words),
            "recipes": rows,
            "seen": torch.ones(1, len(rows), dtype=torch.bool),
            **_of_one_model(of_pairs),
        }
        for number, relation in enumerate(RELATIONS):
            ranker = link_rankers.get(number) or Ranker.empty(len(LINK_FEATURES[number]))
            for name, weights in _of_one_model(ranker).items():
                constants[f"{relation}_{name}"] = weights
            constants[f"{relation}_table"] = torch.zeros(1, 0, 0, dtype=torch.half)
        if encoder is not None:
            constants |= {name: tensor[None] for name, tensor in encoder.named().items()}
            for name, weights in _of_one_model(of_pairs).items():
                constants[f"results_{name}"] = weights
        return cls(constants)

    @classmethod
    def stacked(cls, models: Sequence[Self]) -> Self:
        """Combine several models' knowledge, with the same entities, along axis M."""
        # Models of folds share most recipes: each is stored once, with a mask for each model.
        of_all = torch.cat([model.recipes for model in models])
        every, number = of_all.unique(dim=0, return_inverse=True)
        num_models = sum(model.num_models for model in models)
        seen = torch.zeros(num_models, len(every), dtype=torch.bool)
        row = 0
        place = 0
        for model in models:
            next_row = row + model.num_models
            next_place = place + len(model.recipes)
            # Where the model's recipes are in the common list.
            own = number[place:next_place]
            seen[row:next_row, own] = model.seen
            row = next_row
            place = next_place
        names = [*RANKER, *LINK_RANKERS, *LINK_TABLES]
        if models[0].has_encoder:
            names += [*ENCODER, *RESULT_RANKER]
        constants = {
            "num_own": models[0].num_own,
            "vectors": models[0].vectors,
            "near_words": models[0].near_words,
            "recipes": every,
            "seen": seen,
        }
        for name in names:
            of_models = [getattr(model, name) for model in models]
            constants[name] = torch.cat(of_models)
        stack = cls(constants)
        # Lists that are made already serve the stack, too.
        first = 0
        for model in models:
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
        named = {}
        for number, table in tables.items():
            # With a first axis for the single model.
            named[f"{RELATIONS[number]}_table"] = table.half()[None]
        return type(self)(self.constants() | named)

    def of_entities(self, own: Tensor) -> Self:
        """Return the knowledge about the entities ``own``, ids (n,), which get the ids from 0.

        All other entities come last, and are no more than a source of knowledge.
        """
        is_other = torch.ones(self.num_entities, dtype=torch.bool)
        is_other[own] = False
        others = is_other.nonzero()[:, 0]
        # The old id of each new one, and the new id of each old one.
        order = torch.cat([own, others])
        place = torch.argsort(order)
        near = self.near_words[order].long()
        new_ids = place[near.clamp(min=0)]
        # -1, the end of a list, stays.
        renumbered = torch.where(near < 0, near, new_ids)
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
                own_rows = table[:, own]
                changed[name] = own_rows[:, :, own]
        return type(self)(self.constants() | changed)

    def lists(self, model: int = 0) -> Lists:
        """Return a model's lists; made at the first call by one thread, so that none differ."""
        if model not in self._lists:
            of_model = self.recipes[self.seen[model]]
            recipes = of_model.cpu().numpy().astype(np.int64)
            near_words = self.near_words.cpu().numpy()
            others = list(self._lists.values())
            # All models have the same words: their lists share one copy.
            vectors = others[0].vectors if others else self.vectors.float().cpu().numpy()
            with torch_threads(1), threadpool_limits(1):
                lists = make_lists(recipes, vectors, near_words)
            if others:
                lists = lists._replace(cosines=others[0].cosines)
            self._lists[model] = lists
        return self._lists[model]

    def share_lists(self, other: "RecipeKnowledge") -> None:
        """Take lists from ``other``, now and later, if it has the same recipes and words.

        Sources of a restored policy would make and keep the same lists otherwise.
        """
        names = ("vectors", "near_words", "recipes", "seen")
        pairs = [(getattr(self, name), getattr(other, name)) for name in names]
        if all(torch.equal(own, theirs) for own, theirs in pairs):
            self._lists = other._lists
            self._link_rows = other._link_rows

    def features(
        self,
        goal: Tensor,
        table: Tensor,
        model: Tensor,
        pairs: tuple[Tensor, Tensor] | None = None,
    ) -> Tensor:
        """Return the features of slot pairs.

        Args:
            goal: ids, shape (B,), int64.
            table: entity ids in the slots, shape (B, A), int64; E for empty slots.
            model: which of the M stacked models to use, shape (B,), int64.
            pairs: first and second slot of P pairs, shape (P,) each; None for all pairs in
                :func:`pairs_of`.

        Returns:
            shape (F, B, P), float32, in the order of :data:`~.pair_features.FEATURES`, then those
            of :data:`~.pair_features.OF_ENCODER` if there is an encoder.

        Raises:
            IndexError: for an entity id out of range.
        """
        # Compiled loops are imported late: numba takes as long to import as all the rest.
        from wordcraft_kg.models.scorers.neighbours import feature_loops

        first, second = pairs or pairs_of(table.shape[1], table.device)
        one = first.cpu().numpy()
        other = second.cpu().numpy()
        goals = self.ids(goal)
        tables = self.ids(table)
        of_slots = np.zeros((*tables.shape, feature_loops.OF_SLOTS), dtype=np.float32)
        shape = (len(goals), len(one), feature_loops.OF_PAIRS)
        of_pairs = np.zeros(shape, dtype=np.float32)

        def write(number: int, rows: Ids) -> None:
            # Arrays without gaps, for which the loops are compiled.
            own_slots = np.zeros((len(rows), *of_slots.shape[1:]), dtype=np.float32)
            own_pairs = np.zeros((len(rows), *of_pairs.shape[1:]), dtype=np.float32)
            feature_loops.table_features(
                self.lists(number),
                goals[rows],
                tables[rows],
                one,
                other,
                own_slots,
                own_pairs,
            )
            of_slots[rows] = own_slots
            of_pairs[rows] = own_pairs

        self._for_each_block(model, write)
        slots = torch.from_numpy(of_slots).to(goal.device)
        pairs_only = torch.from_numpy(of_pairs).to(goal.device)
        if self._link_table(COMPONENT_OF).numel():
            component = self._from_table(COMPONENT_OF, model, table, goal[:, None])
            # The entities of each pair, shape (B, P).
            a = table.index_select(1, first)
            b = table.index_select(1, second)
            combines = self._from_table(COMBINES_WITH, model, a, b)
        elif len(one):
            # Features first, as rankers of several models need them.
            links = component_inputs(slots, pairs_only).permute(2, 0, 1)
            component = self._link_ranker(COMPONENT_OF).of_models(links, model)
            combines = torch.zeros(pairs_only.shape[:2], device=goal.device)
        else:
            # No pairs, and so no scores: all slots of a batch are empty.
            width = num_features(has_encoder=self.has_encoder)
            return torch.zeros(width, *pairs_only.shape[:2], device=goal.device)
        features = features_of_pairs(slots, pairs_only, component, combines, first, second)
        if self.has_encoder:
            a = table.index_select(1, first)
            b = table.index_select(1, second)
            encoded = self._encoded(goal, a, b, model)
            features = torch.cat([features, encoded], dim=-1)
        # (B, P, F) to (F, B, P).
        return features.permute(2, 0, 1)

    def _encoded(self, goal: Tensor, a: Tensor, b: Tensor, model: Tensor) -> Tensor:
        """Return the encoders' features of pairs and goals, shape (B, P, 3).

        Args:
            goal: ids, shape (B,); E for no goal.
            a: ids, shape (B, P); E for an empty slot.
            b: ids, shape (B, P), likewise.
            model: number of the model, shape (B,).
        """
        size = self.num_entities
        # Pairs with an empty slot, and rows without a goal, are zeros, as all their features.
        has_no_goal = (goal == size)[:, None]
        is_empty = (a == size) | (b == size) | has_no_goal
        # Any entity will do in an empty place.
        first = a.clamp(max=size - 1)
        second = b.clamp(max=size - 1)
        goals = goal.clamp(max=size - 1)
        features = torch.zeros(*a.shape, len(OF_ENCODER), device=goal.device)
        for number in model.unique().tolist():
            is_own = model == number
            encoder = self.encoder(number)
            features[is_own] = encoder.features(first[is_own], second[is_own], goals[is_own])
        return features.masked_fill(is_empty[..., None], 0)

    def encoder(self, model: int = 0) -> PairEncoder:
        """Return a model's pair encoder; only if there is one."""
        stacks = [getattr(self, name) for name in ENCODER]
        return PairEncoder(*(stack[model] for stack in stacks))

    def slot_scores(self, relation: int, key: Tensor, table: Tensor, model: Tensor) -> Tensor:
        """Score the links (slot's entity, relation, key) of tables by the link rankers.

        Args:
            relation: relation id.
            key: ids, shape (B,), int64; E for no entity.
            table: entity ids in the slots, shape (B, A), int64; E for empty slots.
            model: which of the M stacked models to use, shape (B,), int64.

        Returns:
            shape (B, A), float32. Scores of empty slots, and of tables without a key, mean nothing.

        Raises:
            IndexError: for an entity id out of range, where no table of scores is stored.
        """
        if self._link_table(relation).numel():
            return self._from_table(relation, model, table, key[:, None])
        from wordcraft_kg.models.scorers.neighbours import link_loops

        keys = self.ids(key)
        tables = self.ids(table)
        shape = (*tables.shape, len(LINK_FEATURES[relation]))
        features = np.zeros(shape, dtype=np.float32)
        paths: dict[int, tuple[Any, ...]] = {}
        if relation == COMBINES_WITH:
            # Made before threads begin, and as plain tuples: machine code on the disk names the
            # types of its arguments.
            for number in model.unique().tolist():
                halves, pairs = self.link_rows(number).halves
                paths[number] = (tuple(halves), tuple(pairs))

        def write(number: int, rows: Ids) -> None:
            lists = self.lists(number)
            own_keys = keys[rows]
            own_tables = tables[rows]
            own_features = np.zeros((len(rows), *shape[1:]), dtype=np.float32)
            if relation == COMPONENT_OF:
                link_loops.component_features(lists, own_keys, own_tables, own_features)
            else:
                halves, pairs = paths[number]
                link_loops.combines_features(
                    lists,
                    halves,
                    pairs,
                    own_keys,
                    own_tables,
                    own_features,
                )
            features[rows] = own_features

        self._for_each_block(model, write)
        links = torch.from_numpy(features).to(key.device)
        # (B, A, F) to (F, B, A).
        by_feature = links.permute(2, 0, 1)
        return self._link_ranker(relation).of_models(by_feature, model)

    def _for_each_block(self, model: Tensor, write: Callable[[int, Ids], None]) -> None:
        """Call ``write`` with a model and some of its rows, until it has had all rows once.

        Rows do not depend on each other, and compiled loops run without Python's lock, so threads
        share the blocks of a large batch.

        Args:
            model: model of each row, shape (B,).
            write: computes and keeps what belongs to the rows.
        """
        models = model.cpu().numpy()
        blocks: list[tuple[int, Ids]] = []
        for number in np.unique(models).tolist():
            rows = np.flatnonzero(models == number)
            num_blocks = math.ceil(len(rows) / _BLOCK)
            for block in np.array_split(rows, num_blocks):
                blocks.append((number, block))
            # Made by this thread alone, once.
            self.lists(number)
        # Blocks of all models together: a batch of a cross-fitted scorer has few rows for each.
        most = self.workers or torch.get_num_threads()
        workers = min(most, len(models) // _ROWS)
        if workers <= 1:
            for number, rows in blocks:
                write(number, rows)
            return
        numbers, rows_of_blocks = zip(*blocks, strict=True)
        with ThreadPoolExecutor(workers) as pool:
            # A list takes all results, and so raises a thread's error.
            list(pool.map(write, numbers, rows_of_blocks))

    def _from_table(self, relation: int, model: Tensor, heads: Tensor, tails: Tensor) -> Tensor:
        """Return link scores of heads and tails, ids that broadcast to (B, N), as float32."""
        # Empty slots have no row; their pairs have no score either.
        last = self.num_entities - 1
        rows = heads.clamp(max=last)
        columns = tails.clamp(max=last)
        scores = self._link_table(relation)[model[:, None], rows, columns]
        return scores.float()

    def _link_ranker(self, relation: int) -> Ranker:
        """Return a relation's link rankers, of all models."""
        prefix = RELATIONS[relation]
        return Ranker(*(getattr(self, f"{prefix}_{name}") for name in RANKER))

    def _link_table(self, relation: int) -> Tensor:
        table: Tensor = getattr(self, f"{RELATIONS[relation]}_table")
        return table

    def link_rows(self, model: int = 0) -> LinkRows:
        """Return what computes the features of a model's links; made at the first call."""
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
            # Row = head: with candidates as heads, the entities are columns.
            by_entity = table[model].T if heads else table[model]
            scores = by_entity[entities]
            if candidates is not None:
                scores = scores.gather(1, candidates)
            return scores.float()
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
                some = self.ids(entities[block])
                others = None if candidates is None else self.ids(candidates[block])
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
        num_heads = len(heads.unique())
        num_tails = len(tails.unique())
        by_tail = num_tails < num_heads
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
            offsets = torch.minimum(places, last)
            links = order[starts[some, None] + offsets]
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

    def support_of(
        self,
        a: int,
        b: int,
        goal: int,
        model: int,
    ) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Return the recipes that may support ``a + b -> goal``, and their similarities.

        Args:
            a: id of an ingredient.
            b: id of the other ingredient.
            goal: id of the result.
            model: number of the model whose recipes are listed.

        Returns:
            recipes, ids (R, 3); similarity of their results to the goal, shape (R,); and of their
            ingredients to a and b in both orders, shape (R,) each.
        """
        from wordcraft_kg.models.scorers.neighbours.feature_loops import support_terms

        a, b, goal = self.ids(torch.tensor([a, b, goal])).tolist()
        lists = self.lists(model)
        numbers = lists.support[goal]
        terms = np.zeros((len(numbers), 2), dtype=np.float32)
        support_terms(lists, a, b, goal, terms)
        # -1 ends the list, so the terms of its recipes come first.
        numbers = numbers[numbers >= 0]
        # Chosen before they are stacked: a book may have hundreds of thousands of recipes.
        first = lists.first[numbers]
        second = lists.second[numbers]
        result = lists.result[numbers]
        recipes = np.stack([first, second, result], axis=1)
        straight, crossed = torch.from_numpy(terms[: len(numbers)]).unbind(1)
        like_goal = torch.from_numpy(lists.support_alike[goal, : len(numbers)].copy())
        return torch.from_numpy(recipes.astype(np.int64)), like_goal, straight, crossed

    def component_scores(self, entities: Tensor) -> Tensor:
        """Return componentOf scores with all results by the first model, shape (n, E)."""
        return self.link_scores(COMPONENT_OF, entities)

    def word_cosines(self, entity: int, others: Tensor) -> Tensor:
        """Return word cosines of an entity and n others, shape (n,)."""
        own = self.vectors[entity].float()
        return self.vectors[others].float() @ own

    def have_recipes(self, entity: int, others: Tensor) -> Tensor:
        """Return whether the first model has a recipe of an entity with each other, shape (n,)."""
        lists = self.lists()
        first = torch.from_numpy(lists.first)
        second = torch.from_numpy(lists.second)
        # The entity is the first ingredient of a recipe, or the second.
        after = second[first == entity]
        before = first[second == entity]
        return torch.isin(others, torch.cat([after, before]))

    def log_uses(self) -> Tensor:
        """Return log(1 + recipes of the first model that use an entity), shape (E,)."""
        uses = self.lists().num_uses[: self.num_entities]
        return torch.from_numpy(uses).float().log1p()

    def knows(self, recipes: Tensor, model: int) -> Tensor:
        """Return a mask of the recipes, ids (n, 3), in a model's training data, shape (n,)."""
        of_model = self.recipes[self.seen[model]]
        is_known = np.isin(self._recipe_keys(recipes), self._recipe_keys(of_model))
        return torch.from_numpy(is_known).to(recipes.device)

    def _recipe_keys(self, recipes: Tensor) -> Ids:
        """Return a number for each recipe, ids (n, 3), in which the ingredients' order is lost."""
        a, b, result = recipes.long().cpu().numpy().T
        return recipe_keys(a, b, result, num_entities=len(self.vectors))

    def ids(self, entities: Tensor) -> Ids:
        """Return ids for compiled loops, which check no bounds: -1 for E, the empty slot.

        Raises:
            IndexError: for an id that is not 0 .. E.
        """
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

        goals = self.ids(goal)
        tables = self.ids(table)
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

    @property
    def num_models(self) -> int:
        """Number of models M."""
        return len(self.bias)

    def constants(self) -> dict[str, Tensor]:
        """Return the stored tensors by name."""
        return {name: getattr(self, name) for name in self._names}

    @property
    def has_result_ranker(self) -> bool:
        """Whether there is an encoder with a ranker of results; that of other books has none."""
        return self.has_encoder and bool(self.results_second.any())

    def with_ranker(self, ranker: Ranker) -> Self:
        """Return a copy with a single ranker; only for a single model, M = 1."""
        weights = ranker.weights()
        rankers = {name: weights[name][None] for name in RANKER}
        return type(self)(self.constants() | rankers)

    def with_result_ranker(self, ranker: Ranker) -> Self:
        """Return a copy with a ranker of results; only for a single model with an encoder."""
        weights = ranker.weights()
        rankers = {f"results_{name}": weights[name][None] for name in RANKER}
        return type(self)(self.constants() | rankers)

    def forward(self, goal: Tensor, table: Tensor, model: Tensor) -> Tensor:
        """Score all slot pairs for the goal.

        Args:
            goal: ids, shape (B,), int64.
            table: entity ids in the slots, shape (B, A), int64; E for empty slots.
            model: which of the M stacked models to use, shape (B,), int64.

        Returns:
            shape (B, A, A), in nats, symmetric; -inf for pairs with an empty slot.

        Raises:
            IndexError: as :meth:`features`.
        """
        # A pair is scored once and looked up for both orders of its slots.
        features = self.features(goal, table, model)
        of_pairs = self.scores(features, model)
        num_slots = table.shape[1]
        square = square_of(num_slots, table.device)
        # (B, P) to (B, A · A) to (B, A, A).
        scores = of_pairs.index_select(1, square).view(*table.shape, num_slots)
        is_empty = table == self.num_entities
        has_empty = is_empty[:, :, None] | is_empty[:, None]
        return scores.masked_fill(has_empty, -torch.inf)

    def scores(self, features: Tensor, model: Tensor) -> Tensor:
        """Score P slot pairs, (B, P), in nats, from their :meth:`features`, (F, B, P)."""
        ranker = Ranker(self.first, self.first_bias, self.second, self.bias)
        return ranker.of_models(features, model)

    def feature(self, features: Tensor, name: str) -> Tensor:
        """Return a feature by name, shape (B, P), from :meth:`features`."""
        return features[FEATURES.index(name)]

    def supporting_recipes(
        self,
        a: int,
        b: int,
        goal: int,
        *,
        model: int = 0,
        limit: int = 5,
    ) -> list[Support]:
        """Return up to ``limit`` of a model's recipes that support ``a + b -> goal``.

        Recipes that make the goal itself come first, if their share is at least
        :data:`LEAST_SHARE`, then the others; both by share.

        Args:
            a: id of an ingredient.
            b: id of the other ingredient.
            goal: id of the result.
            model: number of the model.
            limit: maximum number of recipes.
        """
        supporting, like_goal, straight, crossed = self.support_of(a, b, goal, model)
        orders = torch.stack([straight, crossed])
        # Both orders count as evidence, as in the feature; a weight is the better order's alone.
        evidence = like_goal * orders.sum(0)
        weights = (like_goal * orders.amax(0)).clamp(max=1)
        # Without evidence all shares are 0, not NaN.
        least = torch.finfo(evidence.dtype).tiny
        shares = evidence / evidence.sum().clamp(min=least)
        strengths = evidence / evidence.max().clamp(min=least)
        rows = torch.sort(evidence, descending=True, stable=True).indices.tolist()
        is_other = ((supporting[:, 2] != goal) | (shares < LEAST_SHARE)).tolist()
        # A stable sort, so each part stays in the order of shares.
        rows.sort(key=lambda row: is_other[row])
        # Plain numbers at once: each number that is taken from a tensor costs more than a list.
        recipes = supporting.tolist()
        plain_weights = weights.tolist()
        plain_shares = shares.tolist()
        plain_strengths = strengths.tolist()
        size = self.num_entities
        best: list[Support] = []
        for row in rows:
            if len(best) == limit:
                break
            # The padding of short lists, and recipes of other books, have no label here.
            has_labels = max(recipes[row]) < size
            if plain_weights[row] > 0 and has_labels:
                one, other, result = recipes[row]
                figures = plain_weights[row], plain_shares[row], plain_strengths[row]
                best.append(Support((one, other, result), *figures))
        return best


def _of_one_model(ranker: Ranker) -> dict[str, Tensor]:
    """Return a ranker's weights by name, with a first axis for a single model."""
    return {name: weights[None] for name, weights in ranker.weights().items()}


def _renew(knowledge: nn.Module, _: object) -> None:
    """Check tensors that were loaded, and drop lists that were made from other recipes."""
    assert isinstance(knowledge, RecipeKnowledge)
    check_stored(knowledge.constants(), knowledge.num_entities)
    knowledge._lists = {}
    knowledge._link_rows = {}
