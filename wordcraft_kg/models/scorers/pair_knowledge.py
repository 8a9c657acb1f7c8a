"""The interface of recipe knowledge: features and scores of pairs on tables."""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import ClassVar, NamedTuple, Self

import torch
from torch import Tensor, nn

from wordcraft_kg.models.scorers.ranker import RANKER, Ranker

LEAST_SHARE = 0.01
"""Smallest evidence share of a supporting recipe that counts as a reason."""


class Support(NamedTuple):
    """A known recipe that supports another recipe, by ids, and its weight.

    The weight is the recipe similarity, 1 for equality: the product of entity similarities for both
    ingredients (in the better order) and the result. ``share`` is relative to the sum over all
    supporting recipes.
    """

    recipe: tuple[int, int, int]
    weight: float
    share: float


class PairKnowledge(nn.Module, ABC):
    """Knowledge of recipes that scores ingredient pairs on a table, for M models, such as folds'.

    A subclass computes features; a ranker for each model makes scores of them.

    Attributes:
        feature_names: names of the F features, in the order of the rankers' weights. Among them are
            ``known`` (the pair has known results), ``makes`` (it makes the goal) and the feature in
            :attr:`made_name`.
        made_name: name of the feature ``log(1 + recipes that make the goal)``.
        sampled_results: results to score on random tables of a fold, to calibrate probabilities.
        buffer_names: names of the stored tensors.
        num_entities: E, also the id of an empty slot.
        first: the rankers' weights, with H hidden units: shape (M, F, H).
        first_bias: shape (M, H).
        second: shape (M, H).
        bias: shape (M,).
    """

    feature_names: ClassVar[tuple[str, ...]]
    made_name: ClassVar[str]
    sampled_results: ClassVar[int]
    buffer_names: ClassVar[tuple[str, ...]]
    num_entities: int
    first: Tensor
    first_bias: Tensor
    second: Tensor
    bias: Tensor

    @classmethod
    @abstractmethod
    def of_constants(cls, constants: Mapping[str, Tensor], num_entities: int) -> Self:
        """Return the knowledge with the given :meth:`constants`."""

    @classmethod
    @abstractmethod
    def stacked(cls, models: "Sequence[PairKnowledge]") -> Self:
        """Combine several models' knowledge, with the same entities, along axis M."""

    @abstractmethod
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
            shape (F, B, P), float32, in the order of :attr:`feature_names`.
        """

    @abstractmethod
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

    @abstractmethod
    def knows(self, recipes: Tensor, model: int) -> Tensor:
        """Return a mask of the recipes, ids (n, 3), in a model's training data, shape (n,)."""

    @abstractmethod
    def component_scores(self, entities: Tensor) -> Tensor:
        """Return componentOf scores with all results by the first model, shape (n, E)."""

    @abstractmethod
    def word_cosines(self, entity: int, others: Tensor) -> Tensor:
        """Return word cosines of an entity and n others, shape (n,)."""

    @abstractmethod
    def have_recipes(self, entity: int, others: Tensor) -> Tensor:
        """Return whether the first model has a recipe of an entity with each other, shape (n,)."""

    @abstractmethod
    def log_uses(self) -> Tensor:
        """Return log(1 + recipes of the first model that use an entity), shape (E,)."""

    @property
    def num_models(self) -> int:
        """Number of models M."""
        return len(self.bias)

    def constants(self) -> dict[str, Tensor]:
        """Return the stored tensors by name."""
        return {name: getattr(self, name) for name in self.buffer_names}

    def with_ranker(self, ranker: Ranker) -> Self:
        """Return a copy with a single ranker; only for a single model, M = 1."""
        weights = ranker.weights()
        rankers = {name: weights[name][None] for name in RANKER}
        return self.of_constants(self.constants() | rankers, self.num_entities)

    def forward(self, goal: Tensor, table: Tensor, model: Tensor) -> Tensor:
        """Score all slot pairs for the goal.

        Args:
            goal: ids, shape (B,), int64.
            table: entity ids in the slots, shape (B, A), int64; E for empty slots.
            model: which of the M stacked models to use, shape (B,), int64.

        Returns:
            shape (B, A, A), in nats, symmetric; -inf for pairs with an empty slot.
        """
        # A pair is scored once and looked up for both orders of its slots.
        scores = self.scores(self.features(goal, table, model), model)
        scores = scores.index_select(1, _square(table.shape[1], table.device))
        is_empty = table == self.num_entities
        scores = scores.view(*table.shape, table.shape[1])
        has_empty = is_empty[:, :, None] | is_empty[:, None]
        return scores.masked_fill(has_empty, -torch.inf)

    def scores(self, features: Tensor, model: Tensor) -> Tensor:
        """Score P slot pairs, (B, P), in nats, from their :meth:`features`, (F, B, P)."""
        ranker = Ranker(self.first, self.first_bias, self.second, self.bias)
        return ranker.of_models(features, model)

    def feature(self, features: Tensor, name: str) -> Tensor:
        """Return a feature by name, shape (B, P), from :meth:`features`."""
        return features[self.feature_names.index(name)]

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
        rows = torch.sort(evidence, descending=True, stable=True).indices.tolist()
        is_other = ((supporting[:, 2] != goal) | (shares < LEAST_SHARE)).tolist()
        # A stable sort, so each part stays in the order of shares.
        rows.sort(key=lambda row: is_other[row])
        recipes = supporting.tolist()
        best = []
        for row in rows:
            one, other, result = recipes[row]
            # The padding of short lists, and recipes of other books, have no label here.
            has_labels = max(one, other, result) < self.num_entities
            if weights[row] > 0 and has_labels:
                weight = float(weights[row])
                share = float(shares[row])
                best.append(Support((one, other, result), weight, share))
        return best[:limit]


@lru_cache
def pairs_of(slots: int, device: torch.device) -> tuple[Tensor, Tensor]:
    """Return the first and second slot in each slot pair, shape (P,) each, with first <= second."""
    one, other = torch.triu_indices(slots, slots, device=device)
    return one, other


@lru_cache
def _square(slots: int, device: torch.device) -> Tensor:
    """Return the number of each slot pair in :func:`pairs_of`, in both orders, shape (A * A,)."""
    one, other = pairs_of(slots, device)
    every = torch.arange(len(one), device=device)
    number = torch.zeros(slots, slots, dtype=torch.int64, device=device)
    number[one, other] = every
    number[other, one] = every
    return number.view(-1)
