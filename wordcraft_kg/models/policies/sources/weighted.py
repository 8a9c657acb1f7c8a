"""The source w from a weighted recipe list, such as a language model's recipes."""

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
    """Interface for scorers with a weighted recipe list, such as a language model's recipes."""

    def weighted_recipes(self) -> tuple[Tensor, Tensor]:
        """Return recipes, ids (n, 3), ascending by :func:`recipe_keys`, and positive weights, shape (n,)."""
        ...


class BestWeighted(Source):
    """Slot scores w from a list of weighted recipes: ``w_i = S(e_i, e_s -> e_g)``, the weight of the slot's recipe.

    Slot i, selection s and goal g form a recipe; S is 0 for unlisted recipes. Without selection,
    ``w_i = max_j S(e_i, e_j -> e_g)``, with j over the table. The list uses no graph recipe, so nothing can leak.

    Attributes:
        keys: buffer, shape (n + 1,), see :func:`recipe_keys`; the last key equals no recipe's key.
        weights: buffer, shape (n + 1,), by key; the last weight is 0.
    """

    label = W

    keys: Tensor
    weights: Tensor

    def __init__(self, num_entities: int, keys: Tensor, weights: Tensor):
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
        with_selection = self._scores(table, selection[:, None], goal[:, None])
        of_pairs = self._scores(table[:, :, None], table[:, None, :], goal[:, None, None]).amax(-1)
        return torch.where((selection == self.num_entities)[:, None], of_pairs, with_selection)

    def _scores(self, one: Tensor, other: Tensor, result: Tensor) -> Tensor:
        recipes = torch.stack(torch.broadcast_tensors(one, other, result), dim=-1)
        return weights_of(recipes, self.keys, self.weights, self.num_entities)


def recipe_keys(recipes: Tensor, size: int) -> Tensor:
    """Return a number for each recipe, equal for both ingredient orders: shape (..., 3) -> (...).

    Ids are 0 .. E, where E = ``size`` is an empty slot; keys with E differ from all keys for entities.
    """
    one, other, result = recipes.unbind(-1)
    return (torch.minimum(one, other) * (size + 1) + torch.maximum(one, other)) * (size + 1) + result


def weights_of(recipes: Tensor, keys: Tensor, weights: Tensor, size: int) -> Tensor:
    """Return the weight of each recipe, ids (..., 3) -> (...); 0 for unlisted recipes.

    ``keys``, ascending, and ``weights``, shape (n + 1,), end with :func:`with_end`'s key and 0; ``size`` is E.
    """
    wanted = recipe_keys(recipes, size).contiguous()
    rows = torch.searchsorted(keys, wanted)
    return torch.where(keys[rows] == wanted, weights[rows], 0.0)


def with_end(keys: Tensor) -> Tensor:
    """Append a key larger than all recipe keys, so that each search finds an index."""
    return torch.cat([keys, keys.new_full((1,), torch.iinfo(torch.int64).max)])
