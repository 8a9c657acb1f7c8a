"""Recipe knowledge by neighbour lists: scores of pairs and links, and what supports them."""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from wordcraft_kg.base.tensors import torch_threads
from wordcraft_kg.graphs import COMBINES_WITH, COMPONENT_OF, RELATIONS, Ids
from wordcraft_kg.models.scorers.neighbours.blocks import of_blocks
from wordcraft_kg.models.scorers.neighbours.candidate_loops import intermediates
from wordcraft_kg.models.scorers.neighbours.links import CELLS, links_by_key
from wordcraft_kg.models.scorers.neighbours.lists import Lists
from wordcraft_kg.models.scorers.neighbours.pair_features import (
    FEATURES,
    OF_ENCODER,
    pair_features,
    pairs_of,
    with_link_scores,
)
from wordcraft_kg.models.scorers.neighbours.similar import alike_of
from wordcraft_kg.models.scorers.neighbours.storage import StoredKnowledge

LEAST_SHARE = 0.01
"""Smallest evidence share of a supporting recipe that counts as a reason."""
_ROWS = 64
"""Fewest tables for a thread: starting it takes as long as a few tables."""
_BLOCK = 32
"""Most tables that a thread takes at once: few, so that all threads end at about the same time."""
_HEADS = 128
"""Heads whose links to all results are scored together: their rows stay in the fast cache."""


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


class RecipeKnowledge(StoredKnowledge):
    """Scores of pairs for a goal and of links, by the rankers of M models.

    Attributes:
        workers: most threads that compute features, whose number never changes a bit; None for as
            many as torch uses.
    """

    workers: int | None = None

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
        features = self.features(goal, table, model)
        pair_scores = self.ranker().of_models(features, model)
        num_slots = table.shape[1]
        scores = pair_scores.new_empty(*table.shape, num_slots)
        # A pair is scored once, for both orders of its slots.
        first, second = pairs_of(num_slots, table.device)
        scores[:, first, second] = pair_scores
        scores[:, second, first] = pair_scores
        is_empty = table == self.num_entities
        has_empty = is_empty[:, :, None] | is_empty[:, None]
        return scores.masked_fill(has_empty, -torch.inf)

    def feature(self, features: Tensor, name: str) -> Tensor:
        """Return a feature by name, shape (B, P), from :meth:`features`."""
        return features[..., FEATURES.index(name)]

    def kinds(self, features: Tensor) -> Tensor:
        """Return whether a train recipe makes the goal (0 or 1), (B, P), from :meth:`features`."""
        return (self.feature(features, "goal_made") > 0).long()

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
            shape (B, P, F), float32, in the order of :data:`~.pair_features.FEATURES`, then those
            of :data:`~.pair_features.OF_ENCODER` if there is an encoder.

        Raises:
            IndexError: for an entity id out of range.
        """
        first, second = pairs or pairs_of(table.shape[1], table.device)
        slot_pairs = first.cpu().numpy(), second.cpu().numpy()
        goals = self.ids(goal)
        tables = self.ids(table)
        links = self._by_model(
            model,
            (goals, tables),
            lambda lists, *keys: links_by_key(lists, COMPONENT_OF, *keys).numpy(),
        )
        features = self._by_model(
            model,
            (goals, tables, links),
            lambda lists, *rows: pair_features(lists, slot_pairs, *rows),
        )
        a = table.index_select(1, first)
        b = table.index_select(1, second)
        combines = None
        if self._link_table(COMPONENT_OF).numel():
            component = self._from_table(COMPONENT_OF, model, table, goal[:, None])
            combines = self._from_table(COMBINES_WITH, model, a, b)
        else:
            link_rows = torch.from_numpy(links).to(goal.device)
            component = self.ranker(f"{RELATIONS[COMPONENT_OF]}_").of_models(link_rows, model)
        result = torch.from_numpy(features).to(goal.device)
        with_link_scores(result, component, combines, (first, second))
        if not self.has_encoder:
            return result
        return torch.cat([result, self._encoded(goal, a, b, model)], dim=-1)

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
        is_empty = (a == size) | (b == size) | (goal == size)[:, None]
        # Any entity will do in an empty place.
        last = size - 1
        ids = (a.clamp(max=last), b.clamp(max=last), goal.clamp(max=last))
        features = torch.zeros(*a.shape, len(OF_ENCODER), device=goal.device)
        for number in model.unique().tolist():
            is_own = model == number
            features[is_own] = self.encoder(number).features(
                *(entity_ids[is_own] for entity_ids in ids)
            )
        return features.masked_fill(is_empty[..., None], 0)

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
        ranker = self.ranker(f"{RELATIONS[relation]}_")
        scores = torch.empty(table.shape, device=key.device)
        step = max(1, CELLS // max(1, table.shape[1]))
        for start in range(0, len(key), step):
            block = slice(start, start + step)
            links = self._by_model(
                model[block],
                (self.ids(key[block]), self.ids(table[block])),
                lambda lists, *keys: links_by_key(lists, relation, *keys).numpy(),
            )
            features = torch.from_numpy(links).to(key.device)
            scores[block] = ranker.of_models(features, model[block])
        return scores

    def link_scores(self, relation: int, heads: Tensor, tails: Tensor) -> Tensor:
        """Score the links of all heads with all tails, by the first model.

        Args:
            relation: relation id.
            heads: ids of shape (H,).
            tails: ids of shape (N,).

        Returns:
            shape (H, N), float32.
        """
        if self._link_table(relation).numel():
            return self._from_table(relation, torch.zeros_like(heads), heads[:, None], tails)
        # Few and small products: further threads would mostly wait.
        with torch_threads(1):
            if relation == COMBINES_WITH:
                return self._scores_by_key(relation, heads, tails)
            # All heads of a block share what depends on a result.
            blocks = heads.split(_HEADS)
            return torch.cat([self._scores_by_key(relation, tails, block).T for block in blocks])

    def _scores_by_key(self, relation: int, keys: Tensor, entities: Tensor) -> Tensor:
        """Return :meth:`slot_scores` of all keys (B,) with all entities (A,)."""
        table = entities.expand(len(keys), -1)
        return self.slot_scores(relation, keys, table, torch.zeros_like(keys))

    def _by_model(
        self,
        model: Tensor,
        inputs: tuple[NDArray[Any], ...],
        compute: Callable[..., NDArray[Any]],
    ) -> NDArray[Any]:
        """Return the features of rows, each by its model's lists.

        Rows do not depend on each other, and compiled loops run without Python's lock, so threads
        share the blocks of a large batch.

        Args:
            model: model of each row, shape (B,).
            inputs: arrays with a row for each of B rows.
            compute: returns the features of a block of rows, from lists and the block's inputs.
        """
        models = model.cpu().numpy()
        max_workers = self.workers or torch.get_num_threads()
        workers = max(min(max_workers, len(models) // _ROWS), 1)
        blocks: list[tuple[int, Ids]] = []
        for number in np.unique(models).tolist():
            # Made by this thread alone, once.
            self.lists(number)
            (places,) = np.nonzero(models == number)
            num_blocks = math.ceil(len(places) / _BLOCK) if workers > 1 else 1
            blocks += [(number, block) for block in np.array_split(places, num_blocks)]

        def block_features(block: tuple[int, Ids]) -> NDArray[Any]:
            number, places = block
            return compute(self.lists(number), *(array[places] for array in inputs))

        if not blocks:
            return compute(self.lists(), *inputs)
        # Blocks of all models together: a cross-fitted scorer's batch has few rows for each.
        parts = list(of_blocks(block_features, blocks, workers))
        if len(parts) == 1:
            return parts[0]
        together = np.concatenate(parts)
        features = np.empty_like(together)
        features[np.concatenate([places for _, places in blocks])] = together
        return features

    def _link_table(self, relation: int) -> Tensor:
        return self.get_buffer(f"{RELATIONS[relation]}_table")

    def _from_table(self, relation: int, model: Tensor, heads: Tensor, tails: Tensor) -> Tensor:
        """Return link scores of heads and tails, ids that broadcast to (B, N), as float32."""
        # Empty slots have no row; their pairs have no score either.
        last = self.num_entities - 1
        scores = self._link_table(relation)[
            model[:, None],
            heads.clamp(max=last),
            tails.clamp(max=last),
        ]
        return scores.float()

    def word_cosines(self, entity: int, others: Tensor) -> Tensor:
        """Return word cosines of an entity and n others, shape (n,)."""
        return self.vectors[others].float() @ self.vectors[entity].float()

    def have_recipes(self, entity: int, others: Tensor) -> Tensor:
        """Return whether the first model has a recipe of an entity with each other, shape (n,)."""
        lists = self.lists()
        # The entity is the first ingredient of a recipe, or the second.
        partners = [lists.second[lists.first == entity], lists.first[lists.second == entity]]
        return torch.isin(others, torch.from_numpy(np.concatenate(partners)))

    def log_uses(self) -> Tensor:
        """Return log(1 + recipes of the first model that use an entity), shape (E,)."""
        return torch.from_numpy(self.lists().num_uses[: self.num_entities]).float().log1p()

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

        def candidates(lists: Lists, goals: Ids, tables: Ids) -> NDArray[np.int32]:
            proposed = np.full((len(goals), width), -1, dtype=np.int32)
            intermediates(lists, goals, tables, attempts - 2, near, proposed)
            return proposed

        proposed = self._by_model(model, (self.ids(goal), self.ids(table)), candidates)
        ids = torch.from_numpy(proposed).long().to(goal.device)
        # Entities of other books cannot be made.
        is_own = (ids >= 0) & (ids < self.num_entities)
        return ids.masked_fill(~is_own, self.num_entities)

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
        :data:`LEAST_SHARE`, then the others; both by share. Recipes of other books have no labels
        here, and are left out.

        Args:
            a: id of an ingredient.
            b: id of the other ingredient.
            goal: id of the result.
            model: number of the model.
            limit: maximum number of recipes.
        """
        a, b, goal = self.ids(torch.tensor([a, b, goal])).tolist()
        lists = self.lists(model)
        # -1 ends the list.
        numbers = lists.support[goal][lists.support[goal] >= 0]
        columns = (lists.first[numbers], lists.second[numbers], lists.result[numbers])
        # By entity of the pair, ingredient of the recipe, and recipe.
        kernels = np.empty((2, 2, len(numbers)), dtype=np.float32)
        structure = np.zeros(len(lists.norms), dtype=np.float32)
        cosines = np.empty(len(numbers), dtype=np.float32)
        for side, part in np.ndindex(2, 2):
            alike_of(lists, (a, b)[side], columns[part], structure, kernels[side, part], cosines)
        squares = kernels**2
        straight = squares[0, 0] * squares[1, 1]
        crossed = squares[0, 1] * squares[1, 0]
        like_goal = lists.support_alike[goal, : len(numbers)]
        # Both orders count as evidence, as in the feature; a weight is the better order's alone.
        evidence = like_goal * (straight + crossed)
        weights = np.minimum(like_goal * np.maximum(straight, crossed), 1)
        # Without evidence all shares are 0, not NaN.
        smallest = np.finfo(np.float32).tiny
        shares = evidence / max(evidence.sum(), smallest)
        strengths = evidence / max(evidence.max(initial=0), smallest)
        recipes = np.stack(columns, axis=1)
        is_other = (recipes[:, 2] != goal) | (shares < LEAST_SHARE)
        # The last key counts first; ties stay in the order of the list.
        by_share = np.lexsort((-evidence, is_other))
        is_reason = (weights > 0) & (recipes.max(axis=1, initial=0) < self.num_entities)
        rows = by_share[is_reason[by_share]][:limit]
        figures = np.stack([weights, shares, strengths], axis=1)
        supports = []
        for row in rows.tolist():
            first, second, result = recipes[row].tolist()
            supports.append(Support((first, second, result), *figures[row].tolist()))
        return supports
