"""Train recipes as knowledge of sets: parts that recipes lose, votes, candidates and features."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.sparse import csr_matrix

from wordcraft_kg.graphs import MOST_INGREDIENTS, Ids
from wordcraft_kg.models.scorers.sets.loops import (
    NO_SHARE,
    NUM_KERNELS,
    WIDTHS,
    SetLists,
    balance,
    search,
    vote,
)

NO_INGREDIENT = -1
_BEHIND = np.iinfo(np.int64).max
MOST_KINDS = 8_192
"""Most different ingredients of a model, whose pairs are a table."""
_LOST_FROM = 0.05
"""Share of recipes with a part whose goal lacks it, from which recipes lose the part."""
_SHARED_FROM = 1.5
"""Mean number of ingredients that bring a part, from which a set shares it."""
_RARELY_AGAIN = 1e-3
"""Least share of recipes in which one ingredient more brings a part."""
_BEAM = 60
_TOP = 8
_TOP_OF_ALL = 16
"""Ingredients that are tried for a part; in a model without parts, for each step."""
_NEAR_SETS = 15
"""Sets of the nearest goals that join the candidates."""
_KEPT = 30
"""Candidates that the committee orders."""
_SMALL_VOTE = 1e-3
"""Share of the mean vote that each ingredient of a part gets."""
_SMALLEST = 1e-9
_FLOOR = 1e-3
"""Share of a number of ingredients that no similar recipe has."""
_PRIOR = 0.3
"""Added to counts of ingredients that occur together."""
_WEIGHT_OF_SET = 50.0
_FIRST, _SECOND = np.triu_indices(MOST_INGREDIENTS, 1)
_SUM, _NETWORK_SUM, _SET_VOTE, _SIZE = 0, 6, 10, 23
"""Columns of features, for the order before the committee's."""
_FEATURES_BEFORE_KINDS = 30
_NEAR_RECIPES = 60
"""Recipes of the nearest goals that may agree with a set."""
_DISAGREEING = 0.1
"""Weight of such a recipe for each of its ingredients that the set lacks."""
Vector = NDArray[np.float32]
Flags = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class GoalEvidence:
    """What similar train recipes tell of a goal.

    Attributes:
        keys: its key parts, shape (K,).
        spares: its parts that recipes lose, shape (L,), which an ingredient without key parts may
            bring.
        is_allowed: shape (N,), which ingredients bring no part that the goal lacks.
        shares: log shares of ingredients by key part and spare, shape (4, K + L, N).
        votes: shape (3, N).
        set_votes: shape (3, S).
        similarity: shape (3, G), to each known goal.
        log_sizes: log share of each number of ingredients, shape (8,).
        missing: a key part that no train recipe brings, or -1.
        amounts: its parts, shape (P,).
    """

    keys: Ids
    spares: Ids
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
        is_kept: whether recipes keep a part, shape (P,).
        unmet: share of goals with each part that no ingredient brings, shape (P,).
        shared: mean number of ingredients that bring each part, shape (P,).
        is_key: whether a part is a key part, shape (P,).
        style_parts: whether a part is in the kind of an ingredient, shape (P,).
        counts: number of recipes of each ingredient, shape (N,).
        lift: how much more often ingredients occur together than by chance, nats, shape (N, N).
        lists: the recipes as arrays for loops.
        styles: kind of each ingredient, shape (N, K).
        set_counts: number of recipes of each set in the lists, shape (S,).
    """

    def __init__(
        self, recipes: Ids, amounts: Vector, words: Vector, style_parts: Flags | None = None
    ):
        """Count parts and recipes.

        Args:
            recipes: shape (R, 9), entities (ingredients, padding -1, goal).
            amounts: shape (E, P).
            words: shape (E, D).
            style_parts: parts in the kinds of ingredients, shape (P,), so that some of the recipes
                give features of the same number as all; None for all but the key parts.
        """
        self.recipes = recipes
        self.amounts = amounts
        self.words = words
        self.has_parts = amounts.shape[1] > 1
        member_ids = np.unique(recipes[:, :-1])
        self.ingredient_ids = member_ids[member_ids >= 0]
        self.goal_ids, recipe_goals = np.unique(recipes[:, -1], return_inverse=True)
        self._goal_words = words[self.goal_ids]
        self.number_of = np.full(len(amounts), NO_INGREDIENT, dtype=np.int64)
        self.number_of[self.ingredient_ids] = np.arange(len(self.ingredient_ids))
        members = self.numbers(recipes[:, :-1])
        sets, recipe_sets = np.unique(members, axis=0, return_inverse=True)
        rows, columns = np.nonzero(members >= 0)
        shape = (len(recipes), len(self.ingredient_ids))
        ones = np.ones(len(rows), dtype=np.float32)
        is_in = csr_matrix((ones, (rows, members[rows, columns])), shape)
        # An ingredient that is needed twice is in the set once.
        is_in.data[:] = 1
        has_part = amounts[self.ingredient_ids] > 0
        is_in_goal = amounts[recipes[:, -1]] > 0
        # A goal without parts tells nothing of what recipes lose.
        is_told = is_in_goal.any(1)
        brought = (is_in @ has_part.astype(np.float32))[is_told]
        told_parts = is_in_goal[is_told]
        is_brought = brought > 0
        recipes_with = np.maximum(is_brought.sum(0), 1)
        self.lost = (is_brought & ~told_parts).sum(0) / recipes_with
        self.is_kept = self.lost <= _LOST_FROM
        self.unmet = (told_parts & ~is_brought).sum(0) / np.maximum(told_parts.sum(0), 1)
        self.shared = brought.sum(0) / recipes_with
        self.is_key = self.is_kept & (self.shared <= _SHARED_FROM) | (not self.has_parts)
        # Ingredients such as carbon for a carbide: no key part, but a part that other goals lose.
        self._is_spare: Flags = ~np.any(has_part[:, self.is_key], axis=1)
        has_spare = (is_in @ (has_part * self._is_spare[:, None]).astype(np.float32)) > 0
        kept_spares = (has_spare & is_in_goal).sum(0) / np.maximum(is_in_goal.sum(0), 1)
        shares_again = np.where(self.is_key, self.shared - 1, kept_spares)
        self._log_again = np.log(np.clip(shares_again, _RARELY_AGAIN, 1)).astype(np.float32)
        self.style_parts = ~self.is_key if style_parts is None else style_parts
        # The kind of an ingredient: lost and shared parts, a single part, several key parts.
        kinds = [
            has_part[:, self.style_parts],
            has_part.sum(1, keepdims=True) == 1,
            has_part[:, self.is_key].sum(1, keepdims=True) > 1,
        ]
        self.styles = np.concatenate(kinds, axis=1).astype(np.float32)
        self.counts: Vector = np.asarray(is_in.sum(0)).ravel()
        together = (is_in.T @ is_in).toarray()
        np.fill_diagonal(together, 0)
        by_chance = np.outer(self.counts, self.counts) / len(recipes)
        self.lift = np.log((together + _PRIOR) / (by_chance + _PRIOR))
        self._numbers_of_sets = {row.tobytes(): number for number, row in enumerate(sets)}
        self.set_counts = np.bincount(recipe_sets.ravel())
        self._set_sizes = np.sum(sets >= 0, axis=1)
        goal_amounts = amounts[self.goal_ids]
        goals, goal_parts = np.nonzero(goal_amounts)
        self.lists = SetLists(
            goal_starts=np.searchsorted(goals, np.arange(len(goal_amounts) + 1)),
            goal_parts=goal_parts,
            goal_amounts=goal_amounts[goals, goal_parts],
            recipe_goals=recipe_goals,
            recipe_sets=recipe_sets.ravel(),
            sets=np.ascontiguousarray(sets),
            has_part=has_part,
        )

    @property
    def num_features(self) -> int:
        """Number of features of a set."""
        return _FEATURES_BEFORE_KINDS + 2 * self.styles.shape[1]

    def numbers(self, entities: Ids, number_of: Ids | None = None) -> Ids:
        """Return sets by numbers of ingredients, ascending, -1 behind the last.

        Args:
            entities: shape (n, 8), entities that train recipes use, -1 for none.
            number_of: numbers of all entities, shape (E,), if others stand for some.
        """
        number_of = self.number_of if number_of is None else number_of
        # Behind all others: the largest number.
        numbers = np.where(entities >= 0, number_of[entities], _BEHIND)
        numbers.sort(axis=1)
        return np.where(numbers == _BEHIND, NO_INGREDIENT, numbers)

    def inputs(self, goals: Ids) -> torch.Tensor:
        """Return what the network sees of goals, ids (n,): shape (n, 2 P + D)."""
        amounts = self.amounts[goals]
        columns = [np.sqrt(amounts), amounts > 0, self.words[goals]]
        return torch.from_numpy(np.concatenate(columns, axis=1)).float()

    def allowed(self, amounts: Vector) -> Flags:
        """Return which ingredients bring no part that goals lack, but lost ones, shape (n, N).

        Args:
            amounts: shape (n, P).
        """
        is_lacking = (amounts <= 0) & self.is_kept
        has_part = self.lists.has_part.astype(np.float32)
        return (is_lacking.astype(np.float32) @ has_part.T) == 0

    def nearest_ingredients(self, entities: Ids) -> tuple[Vector, Ids]:
        """Return the known ingredients that stand for entities which no train recipe uses.

        Args:
            entities: shape (n,).

        Returns:
            similarity, shape (n,), above 0, and numbers of ingredients, shape (n,).
        """
        ingredient_amounts = self.amounts[self.ingredient_ids]
        entity_amounts = self.amounts[entities]
        common = (entity_amounts > 0).astype(np.float32) @ (ingredient_amounts > 0).T.astype(
            np.float32
        )
        sizes = (entity_amounts > 0).sum(1)[:, None] + (ingredient_amounts > 0).sum(1)
        overlap = np.minimum(entity_amounts[:, None], ingredient_amounts[None]).sum(2)
        kinds = 1 - common / np.maximum(sizes - common, 1)
        if self.words.shape[1]:
            kinds += 1 - self.words[entities] @ self.words[self.ingredient_ids].T
        width, width_of_amounts = WIDTHS[1]
        similarity = np.exp(-kinds / width - (1 - overlap) / width_of_amounts)
        # An ingredient that stands for itself has all its shares.
        numbers = similarity.argmax(1)
        return similarity.max(1, initial=_FLOOR**3).astype(np.float32), numbers

    def goal(
        self,
        entity: int,
        log_network: Vector,
        *,
        has_coverage: bool = True,
    ) -> GoalEvidence:
        """Ask train recipes about a goal.

        Args:
            entity: its id.
            log_network: scores of ingredients by the network, shape (N,).
            has_coverage: whether ingredients may bring no part that the goal lacks.
        """
        amounts = self.amounts[entity]
        cosines = np.ones(len(self.goal_ids), dtype=np.float32)
        if self.words.size:
            cosines = self._goal_words @ self.words[entity]
        similarity = np.empty((NUM_KERNELS, len(self.goal_ids)), dtype=np.float32)
        set_votes = np.zeros((NUM_KERNELS, len(self.lists.sets)), dtype=np.float32)
        votes = np.zeros((NUM_KERNELS, len(self.ingredient_ids)), dtype=np.float32)
        vote(self.lists, amounts, cosines, similarity, set_votes, votes)
        is_allowed = np.ones(votes.shape[1], dtype=bool)
        if has_coverage:
            is_allowed = self.allowed(amounts[None])[0]
        if self.number_of[entity] >= 0:
            # A goal is no ingredient of itself.
            is_allowed[self.number_of[entity]] = False
        parts = np.flatnonzero(amounts > 0)
        keys = parts[self.is_key[parts]]
        keys = keys if len(keys) else parts
        spares = parts[~self.is_kept[parts] & self.is_key[keys].all()]
        shares, missing = self._shares(keys, is_allowed, votes, log_network)
        spare_shares, _ = self._shares(spares, is_allowed & self._is_spare, votes, log_network)
        shares = np.concatenate([shares, spare_shares], axis=1)
        sizes = np.bincount(self._set_sizes, set_votes[1], MOST_INGREDIENTS + 1)[1:]
        log_sizes = np.log(sizes / max(sizes.sum(), _FLOOR**3) + _FLOOR).astype(np.float32)
        return GoalEvidence(
            keys,
            spares,
            is_allowed,
            shares,
            votes,
            set_votes,
            similarity,
            log_sizes,
            missing,
            amounts,
        )

    def candidates(
        self,
        goal: GoalEvidence,
        *,
        has_coverage: bool = True,
        is_allowed: Callable[[Ids], bool] = lambda row: True,
    ) -> tuple[Ids, Vector]:
        """Return likely sets for a goal, by numbers of ingredients, and their features.

        Args:
            goal: from :meth:`goal`.
            has_coverage: whether sets must bring all key parts.
            is_allowed: whether a set, shape (8,), is a candidate.

        Returns:
            sets, shape (n, 8), and features, shape (n, F); n = 0 if nothing is allowed.
        """
        top = _TOP if self.has_parts else _TOP_OF_ALL
        parts = np.append(goal.keys, goal.spares)
        searched_sets = self._searched(goal, parts, goal.shares, top)
        near = np.argsort(-goal.set_votes[0], kind="stable")[:_NEAR_SETS]
        near_sets = self.lists.sets[near]
        is_in = near_sets >= 0
        fits = np.all(goal.is_allowed[near_sets] | ~is_in, axis=1)
        if has_coverage:
            brings = (self.lists.has_part[near_sets][..., goal.keys] & is_in[..., None]).any(1)
            fits &= np.all(brings, axis=1)
        sets = np.unique(np.concatenate([searched_sets, near_sets[fits]]), axis=0)
        sets = sets[np.array([is_allowed(row) for row in sets], dtype=bool)]
        if not len(sets):
            return sets, np.empty((0, self.num_features), dtype=np.float32)
        features = self.features(goal, sets)
        before = features[:, _SUM] + features[:, _NETWORK_SUM] + 2 * features[:, _SET_VOTE]
        if not self.has_parts:
            before += features[:, _SIZE]
        best = np.argsort(-before, kind="stable")[:_KEPT]
        return sets[best], features[best]

    def sets_by_frequency(self, goal: GoalEvidence) -> Ids:
        """Return sets of the ingredients that most often bring each key part, best first.

        Args:
            goal: from :meth:`goal`.

        Returns:
            shape (n, 8), numbers of ingredients.
        """
        votes = np.tile(self.counts, (NUM_KERNELS, 1))
        shares, _ = self._shares(goal.keys, goal.is_allowed, votes, np.log(self.counts))
        return self._searched(goal, goal.keys, shares, _TOP)

    def _searched(self, goal: GoalEvidence, parts: Ids, shares: Vector, top: int) -> Ids:
        """Return the best sets that cover all key parts of a goal, by numbers of ingredients.

        Args:
            goal: from :meth:`goal`.
            parts: its key parts, and parts that recipes lose.
            shares: log shares of ingredients for these parts, shape (4, parts, N).
            top: most ingredients that are tried for a part.

        Returns:
            shape (n, 8); n = 0 if no train recipe brings a key part.
        """
        sets = np.full((_BEAM, MOST_INGREDIENTS), NO_INGREDIENT, dtype=np.int64)
        if goal.missing >= 0 or not len(goal.keys):
            return sets[:0]
        log_sizes = goal.log_sizes[: 0 if self.has_parts else None]
        log_again = self._log_again[parts]
        return sets[: search(self.lists, goal.keys, shares, log_again, log_sizes, top, sets)]

    def _shares(
        self, keys: Ids, is_allowed: Flags, votes: Vector, log_network: Vector
    ) -> tuple[Vector, int]:
        """Return log shares of ingredients for each key part, by three kernels and the network.

        Args:
            keys: key parts of the goal.
            is_allowed: shape (N,).
            votes: shape (3, N).
            log_network: shape (N,).

        Returns:
            shape (4, keys, N), and the first key part that no ingredient brings, or -1.
        """
        shape = (NUM_KERNELS + 1, len(keys), len(self.counts))
        shares = np.full(shape, NO_SHARE, dtype=np.float32)
        missing = -1
        # From the last to the first, which stays.
        for place in range(len(keys))[::-1]:
            options = np.flatnonzero(is_allowed & self.lists.has_part[:, keys[place]])
            if not len(options):
                missing = int(keys[place])
                continue
            weights = votes[:, options].astype(np.float64)
            weights += _SMALL_VOTE * weights.mean(1, keepdims=True)
            weights += _SMALLEST * (self.counts[options] + 0.1)
            shares[:-1, place, options] = np.log(weights / weights.sum(1, keepdims=True))
            scores = log_network[options]
            shares[-1, place, options] = scores - np.logaddexp.reduce(scores)
        return shares, missing

    def features(self, goal: GoalEvidence, sets: Ids) -> Vector:
        """Return the features of sets for a goal, shape (n, F).

        Args:
            goal: from :meth:`goal`.
            sets: shape (n, 8), numbers of ingredients.
        """
        is_in = sets >= 0
        sizes = is_in.sum(1)
        # Shape (4, keys and spares, n, 8), and over these, (4, n, 8).
        member_shares = np.where(is_in, goal.shares[:, :, sets], -np.inf)
        best_shares = member_shares.max(1, initial=NO_SHARE)
        sums = np.where(is_in, best_shares, 0).sum(2)
        minima = np.where(is_in, best_shares, np.inf).min(2)
        key_sums = member_shares[:, : len(goal.keys)].max(3).sum(1)
        numbers = [self._numbers_of_sets.get(row.tobytes(), -1) for row in sets]
        is_known = np.array(numbers) >= 0
        set_shares = goal.set_votes[:, numbers] / np.maximum(goal.set_votes.sum(1), 1e-12)[:, None]
        counts = np.where(is_known, self.set_counts[numbers], 0)
        is_pair = is_in[:, _SECOND]
        lifts = np.where(is_pair, self.lift[sets[:, _FIRST], sets[:, _SECOND]], 0)
        smallest_lift = np.where(is_pair, lifts, np.inf).min(1)
        log_counts = np.where(is_in, np.log(self.counts[sets] + 1), 0)
        style = np.where(is_in[..., None], self.styles[sets], 0).sum(1) / sizes[:, None]
        near_style = goal.votes[1] @ self.styles / max(goal.votes[1].sum(), _SMALLEST)
        distance = style - near_style
        columns = [
            *np.stack([sums, minima], axis=1).reshape(-1, len(sets)),
            *key_sums[[0, -1]],
            *np.log1p(_WEIGHT_OF_SET * np.where(is_known, set_shares, 0)),
            np.log1p(counts),
            sizes - len(goal.keys),
            sizes,
            np.full(len(sets), len(goal.keys)),
            lifts.sum(1) / np.maximum(is_pair.sum(1), 1),
            np.where(np.isinf(smallest_lift), 0, smallest_lift),
            log_counts.sum(1) / sizes,
            np.where(is_in, log_counts, np.inf).min(1),
            np.full(len(sets), goal.similarity[0].max()),
            np.full(len(sets), np.log(goal.set_votes[0].sum() + _SMALLEST)),
            goal.log_sizes[sizes - 1],
            np.abs(distance).sum(1),
            *self._balances(goal, sets).T,
            *self._agreements(goal, sets).T,
            *distance.T,
            *style.T,
        ]
        return np.stack(columns, axis=1).astype(np.float32)

    def _balances(self, goal: GoalEvidence, sets: Ids) -> Vector:
        """Return what is missing or too much when amounts of ingredients add up to the goal.

        Args:
            goal: from :meth:`goal`.
            sets: shape (n, 8), numbers of ingredients.

        Returns:
            shape (n, 3), for key parts, shared parts and lost parts.
        """
        members = self.amounts[self.ingredient_ids[sets]] * (sets >= 0)[..., None]
        is_here = (goal.amounts > 0) | (members > 0).any((0, 1))
        kinds = np.where(self.is_key, 0, np.where(self.is_kept, 1, 2))[is_here]
        result = np.empty((len(members), 3), dtype=np.float32)
        balance(np.ascontiguousarray(members[..., is_here]), kinds, goal.amounts[is_here], result)
        return result

    def _agreements(self, goal: GoalEvidence, sets: Ids) -> Vector:
        """Return the log share of similar recipes that agree with sets, by two kernels.

        A recipe counts less for each of its ingredients that the goal allows and the set lacks.

        Args:
            goal: from :meth:`goal`.
            sets: shape (n, 8), numbers of ingredients.

        Returns:
            shape (n, 2).
        """
        similarity = goal.similarity[:, self.lists.recipe_goals]
        num_near = min(_NEAR_RECIPES, similarity.shape[1])
        near = np.argpartition(-similarity[1], num_near - 1)[:num_near]
        uses = self._flags(self.lists.sets[self.lists.recipe_sets[near]]) * goal.is_allowed
        num_lacking = uses.sum(1) - self._flags(sets) @ uses.T
        weights = similarity[:2, near] * uses.any(1)
        total = np.maximum(weights.sum(1), _SMALLEST)
        return np.log(_DISAGREEING**num_lacking @ weights.T / total + _FLOOR)

    def _flags(self, sets: Ids) -> Vector:
        """Return which ingredients sets have, shape (n, N), 1 or 0."""
        # Behind the last ingredient: the place of the padding.
        flags = np.zeros((len(sets), len(self.counts) + 1), dtype=np.float32)
        np.put_along_axis(flags, sets, 1, axis=1)
        return flags[:, :-1]
