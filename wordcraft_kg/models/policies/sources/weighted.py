"""w of a list of recipes with weights: whether a slot is part of a listed pair that makes the goal."""

from collections.abc import Mapping
from typing import Protocol, Self, runtime_checkable

import torch
from torch import Tensor

from wordcraft_kg.base.tensors import lazily_zero
from wordcraft_kg.models.policies.sources import W
from wordcraft_kg.models.policies.sources.source import ScoreView, Source, check_constants
from wordcraft_kg.models.scorers.protocol import TripleScorer


@runtime_checkable
class WeightedRecipes(TripleScorer, Protocol):
    """A scorer whose scores of recipes are the weights of a list, such as the opinions of a language model."""

    def weighted_recipes(self) -> tuple[Tensor, Tensor]:
        """Return recipes, shape (n, 3), int64, in ascending order of their keys, and weights, shape (n,), above 0."""
        ...


class BestWeighted(Source):
    """``w_i = S(e_i, e_s -> e_g)``; while nothing is held, ``w_i = max_j S(e_i, e_j -> e_g)`` over the table.

    S is the weight of the recipe in the list, 0 if it is not there. The list rests on no recipe of the graph, so there
    is nothing to keep from a task.

    Attributes:
        keys: buffer, shape (n + 1,), see :func:`recipe_keys`.
        weights: buffer, shape (n + 1,).
    """

    label = W

    keys: Tensor
    weights: Tensor

    def __init__(self, num_entities: int, keys: Tensor, weights: Tensor):
        """Take keys and weights; the last ones stand for no recipe."""
        super().__init__(num_entities)
        self.register_buffer("keys", keys)
        self.register_buffer("weights", weights)

    @classmethod
    def of_scorer(cls, scorer: TripleScorer, view: ScoreView) -> "BestWeighted":  # noqa: D102 - inherited
        assert isinstance(scorer, WeightedRecipes)
        recipes, weights = scorer.weighted_recipes()
        size = len(scorer.entities)
        return cls(size, with_end(recipe_keys(recipes.cpu(), size)), torch.cat([weights.cpu(), torch.zeros(1)]))

    @classmethod
    def restored(cls, num_entities: int, constants: Mapping[str, Tensor]) -> Self:  # noqa: D102 - inherited
        check_constants(constants, {"keys": "n int64", "weights": "n float32"})
        return cls(num_entities, lazily_zero(constants["keys"]), lazily_zero(constants["weights"]))

    def forward(self, goal: Tensor, selection: Tensor, table: Tensor, task: Tensor | None = None) -> Tensor:  # noqa: D102 - inherited
        with_held = self._scores(table, selection[:, None], goal[:, None])
        of_pairs = self._scores(table[:, :, None], table[:, None, :], goal[:, None, None]).amax(-1)
        return torch.where((selection == self.num_entities)[:, None], of_pairs, with_held)

    def _scores(self, one: Tensor, other: Tensor, result: Tensor) -> Tensor:
        recipes = torch.stack(torch.broadcast_tensors(one, other, result), dim=-1)
        return weights_of(recipes, self.keys, self.weights, self.num_entities)


def recipe_keys(recipes: Tensor, size: int) -> Tensor:
    """Return a key for each recipe, shape (..., 3) -> (...), that does not depend on the order of the pair.

    Ids are 0 .. E, where E stands for nothing; no recipe of entities has the key of one with nothing in it.
    """
    one, other, result = recipes.unbind(-1)
    return (torch.minimum(one, other) * (size + 1) + torch.maximum(one, other)) * (size + 1) + result


def weights_of(recipes: Tensor, keys: Tensor, weights: Tensor, size: int) -> Tensor:
    """Return the weight of each recipe, shape (..., 3) -> (...); 0 for one that is not listed.

    Args:
        recipes: ids, as in :func:`recipe_keys`.
        keys: shape (n + 1,), of the listed recipes, ascending; the last one stands for none, see :func:`with_end`.
        weights: shape (n + 1,); the last one is 0.
        size: number of entities.
    """
    asked = recipe_keys(recipes, size).contiguous()
    found = torch.searchsorted(keys, asked)
    return torch.where(keys[found] == asked, weights[found], 0.0)


def with_end(keys: Tensor) -> Tensor:
    """Return keys with one more that is larger than any, so that a search always ends at one."""
    return torch.cat([keys, keys.new_full((1,), torch.iinfo(torch.int64).max)])
