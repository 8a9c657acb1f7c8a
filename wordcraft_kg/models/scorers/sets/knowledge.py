"""Train recipes as knowledge of sets: parts that recipes lose, votes, candidates and features."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from numpy.typing import NDArray

from wordcraft_kg.graphs.arrays import Ids
from wordcraft_kg.graphs.recipes import MOST_INGREDIENTS
from wordcraft_kg.models.scorers.sets.loops import (
    NO_SHARE,
    NUM_KERNELS,
    WIDTHS,
    SetLists,
    keys_of_sets,
    num_features,
    search,
    vote,
    write_features,
    write_shares,
)

NO_INGREDIENT = -1
_LOST_FROM = 0.05
"""Share of recipes with a part whose goal lacks it, from which recipes lose the part."""
_SHARED_FROM = 1.5
"""Mean number of ingredients that bring a part, from which a set shares it."""
_BEAM = 40
_TOP = 8
_TOP_OF_ALL = 16
"""Ingredients that are tried for a part; in a model without parts, for each step."""
_NEAR_SETS = 15
"""Sets of the nearest goals that join the candidates."""
_KEPT = 30
"""Candidates that the committee orders."""
_FLOOR = 1e-3
_PRIOR = 0.3
_SUM, _NETWORK_SUM, _SET_VOTE, _SIZE = 0, 6, 10, 23
"""Columns of features, for the order before the committee's."""
Vector = NDArray[np.float32]
Flags = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Goal:
    """What similar train recipes tell of a goal.

    Attributes:
        keys: its key parts, shape (K,).
        is_allowed: shape (N,), which ingredients bring no part that the goal lacks.
        shares: log shares of ingredients by key part, shape (4, K, N).
        votes: shape (3, N).
        set_votes: shape (3, S).
        similarity: shape (3, G), to each known goal.
        log_sizes: log share of each number of ingredients, shape (8,).
        missing: a key part that no train recipe brings, or -1.
        amounts: its parts, shape (P,).
    """

    keys: Ids
    is_allowed: Flags
    shares: Vector
    votes: Vector
    set_votes: Vector
    similarity: Vector
    log_sizes: Vector
    missing: int
    amounts: Vector


class SetKnowledge:
    """All that a model knows of train recipes.

    Attributes:
        recipes: shape (R, 9), entities (ingredients, padding -1, goal).
        goal_ids: entities that recipes make, shape (G,).
        ingredient_ids: entities that recipes use, shape (N,), ascending.
        amounts: parts of all entities, shape (E, P).
        words: unit vectors of all entities, shape (E, D); D = 0 without words.
        has_parts: whether parts tell entities apart.
        lost: share of train recipes with each part whose goal lacks it, shape (P,).
        unmet: share of goals with each part that no ingredient brings, shape (P,).
        shared: mean number of ingredients that bring each part, shape (P,).
        lists: the recipes as arrays for loops.
    """

    def __init__(self, recipes: Ids, amounts: Vector, words: Vector):
        """Count parts and recipes.

        Args:
            recipes: shape (R, 9), entities (ingredients, padding -1, goal).
            amounts: shape (E, P).
            words: shape (E, D).
        """
        self.recipes = recipes
        self.amounts = amounts
        self.words = words
        self.has_parts = amounts.shape[1] > 1
        used = np.unique(recipes[:, :-1])
        self.ingredient_ids = used[used >= 0]
        self.goal_ids, recipe_goals = np.unique(recipes[:, -1], return_inverse=True)
        self.number_of = np.full(len(amounts), NO_INGREDIENT, dtype=np.int64)
        self.number_of[self.ingredient_ids] = np.arange(len(self.ingredient_ids))
        members = self.numbers(recipes[:, :-1])
        sets, recipe_sets = np.unique(members, axis=0, return_inverse=True)
        is_in = np.zeros((len(recipes), len(self.ingredient_ids)), dtype=np.float32)
        rows, columns = np.nonzero(members >= 0)
        is_in[rows, members[rows, columns]] = 1
        has_part = amounts[self.ingredient_ids] > 0
        self._count_parts(is_in @ has_part, amounts[recipes[:, -1]] > 0)
        is_key = self.is_kept & (self.shared <= _SHARED_FROM)
        if not self.has_parts:
            is_key[:] = True
        self.lists = self._lists(recipe_goals, sets, recipe_sets.ravel(), is_in, is_key)
        self.set_sizes = np.sum(sets >= 0, axis=1)

    def _count_parts(self, brought: Vector, is_in_goal: Flags) -> None:
        """Learn what recipes lose, share and leave unmet.

        Args:
            brought: number of ingredients with each part in each recipe, shape (R, P).
            is_in_goal: shape (R, P).
        """
        is_brought = brought > 0
        recipes_with = np.maximum(is_brought.sum(0), 1)
        self.lost = (is_brought & ~is_in_goal).sum(0) / recipes_with
        self.unmet = (is_in_goal & ~is_brought).sum(0) / np.maximum(is_in_goal.sum(0), 1)
        self.shared = brought.sum(0) / recipes_with

    def _lists(
        self, recipe_goals: Ids, sets: Ids, recipe_sets: Ids, is_in: Vector, is_key: Flags
    ) -> SetLists:
        goal_amounts = self.amounts[self.goal_ids]
        rows, goal_parts = np.nonzero(goal_amounts)
        size = len(self.ingredient_ids)
        has_part = self.amounts[self.ingredient_ids] > 0
        keys = np.empty(len(sets), dtype=np.int64)
        keys_of_sets(sets, keys)
        order = np.argsort(keys, kind="stable")
        together = np.triu(is_in.T @ is_in, 1)
        first, second = np.nonzero(together)
        return SetLists(
            goal_starts=np.searchsorted(rows, np.arange(len(goal_amounts) + 1)),
            goal_parts=goal_parts,
            goal_amounts=goal_amounts[rows, goal_parts],
            recipe_goals=recipe_goals,
            recipe_sets=recipe_sets,
            sets=np.ascontiguousarray(sets),
            set_counts=np.bincount(recipe_sets, minlength=len(sets)).astype(np.float32),
            set_keys=keys[order],
            set_order=order,
            counts=is_in.sum(0),
            pair_keys=first * size + second,
            pair_counts=together[first, second],
            has_part=has_part,
            is_key=is_key,
            style=self.style(has_part, is_key),
        )

    @staticmethod
    def style(has_part: Flags, is_key: Flags) -> Vector:
        """Return the kind of ingredients: lost and shared parts, a single part, several keys.

        Args:
            has_part: shape (n, P).
            is_key: shape (P,).

        Returns:
            shape (n, K).
        """
        of_kind = [
            has_part[:, ~is_key],
            has_part.sum(1, keepdims=True) == 1,
            has_part[:, is_key].sum(1, keepdims=True) > 1,
        ]
        return np.concatenate(of_kind, axis=1).astype(np.float32)

    @property
    def num_features(self) -> int:
        """Number of features of a set."""
        return num_features(self.lists.style.shape[1])

    def numbers(self, entities: Ids) -> Ids:
        """Return sets by numbers of ingredients, ascending, -1 behind the last.

        Args:
            entities: shape (n, 8), entities that train recipes use, -1 behind the last.
        """
        numbers = np.where(entities >= 0, self.number_of[entities], NO_INGREDIENT)
        # Behind all others: the largest number.
        numbers[entities < 0] = np.iinfo(np.int64).max
        numbers.sort(axis=1)
        numbers[numbers == np.iinfo(np.int64).max] = NO_INGREDIENT
        return numbers

    def inputs(self, amounts: Vector, words: Vector) -> torch.Tensor:
        """Return what the network sees of goals, shape (n, 2 P + D)."""
        columns = [np.sqrt(amounts), amounts > 0, words]
        return torch.from_numpy(np.concatenate(columns, axis=1)).float()

    @cached_property
    def _goal_words(self) -> Vector:
        return self.words[self.goal_ids]

    def allowed(self, amounts: Vector) -> Flags:
        """Return which ingredients bring no part that goals lack, but lost ones, shape (n, N).

        Args:
            amounts: shape (n, P).
        """
        is_lacking = (amounts <= 0) & self.is_kept
        has_part = self.lists.has_part.astype(np.float32)
        return (is_lacking.astype(np.float32) @ has_part.T) == 0

    @property
    def is_kept(self) -> Flags:
        """Whether recipes keep a part, shape (P,)."""
        return self.lost <= _LOST_FROM

    def nearest_ingredients(self, entities: Ids) -> tuple[Vector, Ids]:
        """Return the known ingredients that stand for entities which no train recipe uses.

        Args:
            entities: shape (n,).

        Returns:
            similarity, shape (n,), above 0, and numbers of ingredients, shape (n,).
        """
        known = self.amounts[self.ingredient_ids]
        asked = self.amounts[entities]
        common = (asked > 0).astype(np.float32) @ (known > 0).T.astype(np.float32)
        sizes = (asked > 0).sum(1)[:, None] + (known > 0).sum(1)
        overlap = np.minimum(asked[:, None], known[None]).sum(2)
        kinds = 1 - common / np.maximum(sizes - common, 1)
        if self.words.shape[1]:
            kinds += 1 - self.words[entities] @ self.words[self.ingredient_ids].T
        width, width_of_amounts = WIDTHS[1]
        similarity = np.exp(-kinds / width - (1 - overlap) / width_of_amounts)
        # An ingredient that stands for itself has all its shares.
        numbers = similarity.argmax(1)
        return similarity.max(1, initial=_FLOOR**3).astype(np.float32), numbers

    def log_lift(self, first: Ids, second: Ids) -> Vector:
        """Return how much more often entities occur together than by chance, in nats.

        Args:
            first: ids, shape (n,).
            second: ids, shape (n,).
        """
        numbers = np.sort([self.number_of[first], self.number_of[second]], axis=0)
        lists = self.lists
        keys = numbers[0] * len(lists.counts) + numbers[1]
        places = np.searchsorted(lists.pair_keys, keys).clip(max=max(len(lists.pair_keys) - 1, 0))
        is_pair = np.zeros(len(keys), dtype=bool)
        together = np.zeros(len(keys), dtype=np.float32)
        if len(lists.pair_keys):
            is_pair = (lists.pair_keys[places] == keys) & (numbers[0] >= 0)
            together[is_pair] = lists.pair_counts[places[is_pair]]
        expected = lists.counts[numbers].prod(0) / len(self.recipes) * (numbers[0] >= 0)
        return np.log((together + _PRIOR) / (expected + _PRIOR)).astype(np.float32)

    def goal(
        self,
        amounts: Vector,
        words: Vector,
        log_network: Vector,
        *,
        entity: int = NO_INGREDIENT,
        has_coverage: bool = True,
    ) -> Goal:
        """Ask train recipes about a goal.

        Args:
            amounts: its parts, shape (P,).
            words: its unit vector, shape (D,).
            log_network: scores of ingredients by the network, shape (N,).
            entity: the goal's id, which is no ingredient of itself; -1 for a new one.
            has_coverage: whether ingredients may bring no part that the goal lacks.
        """
        lists = self.lists
        cosines = np.ones(len(self.goal_ids), dtype=np.float32)
        if words.size:
            cosines = self._goal_words @ words
        similarity = np.empty((NUM_KERNELS, len(self.goal_ids)), dtype=np.float32)
        set_votes = np.zeros((NUM_KERNELS, len(lists.sets)), dtype=np.float32)
        votes = np.zeros((NUM_KERNELS, len(self.ingredient_ids)), dtype=np.float32)
        vote(lists, amounts, cosines, similarity, set_votes, votes)
        is_allowed = np.ones(votes.shape[1], dtype=bool)
        if has_coverage:
            is_allowed = self.allowed(amounts[None])[0]
        if entity >= 0 and self.number_of[entity] >= 0:
            is_allowed[self.number_of[entity]] = False
        parts = np.flatnonzero(amounts > 0)
        keys = parts[lists.is_key[parts]]
        keys = keys if len(keys) else parts
        shares = np.full((NUM_KERNELS + 1, len(keys), votes.shape[1]), NO_SHARE, dtype=np.float32)
        missing = write_shares(lists, keys, is_allowed, votes, log_network, shares)
        sizes = np.bincount(self.set_sizes, set_votes[1], MOST_INGREDIENTS + 1)[1:]
        log_sizes = np.log(sizes / max(sizes.sum(), _FLOOR**3) + _FLOOR).astype(np.float32)
        return Goal(
            keys, is_allowed, shares, votes, set_votes, similarity, log_sizes, int(missing), amounts
        )

    def candidates(self, goal: Goal, *, has_coverage: bool = True) -> tuple[Ids, Vector]:
        """Return likely sets for a goal, by numbers of ingredients, and their features.

        Args:
            goal: from :meth:`goal`.
            has_coverage: whether sets must bring all key parts.

        Returns:
            sets, shape (n, 8), and features, shape (n, F); n = 0 if nothing is allowed.
        """
        sets = np.full((_BEAM, MOST_INGREDIENTS), NO_INGREDIENT, dtype=np.int64)
        num_sets = 0
        if goal.missing < 0 and len(goal.keys):
            log_sizes = goal.log_sizes[: 0 if self.has_parts else None]
            top = _TOP if self.has_parts else _TOP_OF_ALL
            num_sets = search(self.lists, goal.keys, goal.shares, log_sizes, top, sets)
        near = np.argsort(-goal.set_votes[0], kind="stable")[:_NEAR_SETS]
        known = self.lists.sets[near]
        is_in = known >= 0
        fits = np.all(goal.is_allowed[known] | ~is_in, axis=1)
        if has_coverage:
            brings = (self.lists.has_part[known][..., goal.keys] & is_in[..., None]).any(1)
            fits &= np.all(brings, axis=1)
        sets = np.unique(np.concatenate([sets[:num_sets], known[fits]]), axis=0)
        features = self.features(goal, sets)
        before = features[:, _SUM] + features[:, _NETWORK_SUM] + 2 * features[:, _SET_VOTE]
        if not self.has_parts:
            before += features[:, _SIZE]
        kept = np.argsort(-before, kind="stable")[:_KEPT]
        return sets[kept], features[kept]

    def sets_by_frequency(self, goal: Goal) -> Ids:
        """Return sets of the ingredients that most often bring each key part, best first.

        Args:
            goal: from :meth:`goal`.

        Returns:
            shape (n, 8), numbers of ingredients.
        """
        sets = np.full((_BEAM, MOST_INGREDIENTS), NO_INGREDIENT, dtype=np.int64)
        if goal.missing >= 0 or not len(goal.keys):
            return sets[:0]
        votes = np.tile(self.lists.counts, (NUM_KERNELS, 1))
        shares = np.full_like(goal.shares, NO_SHARE)
        log_counts = np.log(self.lists.counts)
        write_shares(self.lists, goal.keys, goal.is_allowed, votes, log_counts, shares)
        log_sizes = goal.log_sizes[: 0 if self.has_parts else None]
        return sets[: search(self.lists, goal.keys, shares, log_sizes, _TOP, sets)]

    def features(
        self,
        goal: Goal,
        sets: Ids,
        styles: Vector | None = None,
        shares: Vector | None = None,
        proxies: Ids | None = None,
    ) -> Vector:
        """Return the features of sets for a goal, shape (n, F).

        Args:
            goal: from :meth:`goal`.
            sets: shape (n, 8), numbers of ingredients; those of unknown ones from N on.
            styles: kinds of all ingredients, unknown ones included.
            shares: log shares, unknown ones included.
            proxies: known ingredient that stands for each.
        """
        lists = self.lists
        features = np.empty((len(sets), self.num_features), dtype=np.float32)
        write_features(
            lists,
            np.ascontiguousarray(sets),
            lists.style if styles is None else styles,
            goal.shares if shares is None else shares,
            goal.votes,
            goal.set_votes,
            goal.similarity,
            goal.log_sizes,
            np.arange(len(lists.counts)) if proxies is None else proxies,
            features,
        )
        return features
