"""Scorer for weighted recipes from a language model or another source outside the graph."""

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import numpy as np
import torch
from torch import Tensor

from wordcraft_kg.graphs.arrays import Ids
from wordcraft_kg.graphs.triples import COMBINES_WITH, COMPONENT_OF, recipe_triples
from wordcraft_kg.models.policies.sources.weighted import recipe_keys, weights_of, with_end
from wordcraft_kg.models.scorers.recipes import Witness
from wordcraft_kg.models.scorers.scorer import EntityIds, StoredScorer, check_ids, check_shapes

_MOST_ENTITIES = 2_000_000
"""Limit at which three ids fit into a key of 64 bits."""


class ElicitedScorer(StoredScorer):
    """A scorer with a weight per elicited recipe: scores other recipes 0, and links by their best recipe.

    Links::

        score(a, combinesWith, b) = max over c of score(a, b -> c)
        score(x, componentOf, c) = max over b of score(x, b -> c)

    Attributes:
        elicited: recipe ids, shape (n, 3), int32: unique pairs, smaller id first, and results, in ascending order.
        weights: shape (n,), float32, above 0.
        recipes: training recipes: empty, shape (0, 3).
    """

    kind: ClassVar[str] = "elicited"

    def __init__(self, tensors: Mapping[str, Tensor], entities: Sequence[str], graph_hash: str, **kwargs: Any):
        """Take the sorted tensors ``elicited`` and ``weights``; :meth:`of` accepts recipes in any order.

        Raises:
            KeyError: if a tensor is missing.
            ValueError: if a tensor has a wrong shape, type or value.
        """
        super().__init__(entities, graph_hash, **kwargs)
        self.check(tensors, len(self.entities))
        self.elicited, self.weights = tensors["elicited"], tensors["weights"]
        self.recipes = torch.empty(0, 3, dtype=torch.int64)
        rows = self.elicited.to(self.device, torch.int64)
        self._keys = with_end(recipe_keys(rows, len(self.entities)))
        self._weights = torch.cat([self.weights, self.weights.new_zeros(1)]).to(self.device)
        self._links = self._strongest_links()

    @classmethod
    def of(
        cls, elicited: Ids, weights: Sequence[float], entities: Sequence[str], graph_hash: str, **kwargs: Any
    ) -> "ElicitedScorer":
        """Create a scorer from recipe ids, shape (n, 3), with weights above 0; duplicates keep the largest weight.

        Example:
            >>> scorer = ElicitedScorer.of([[1, 0, 2]], [1.0], ["earth", "water", "mud"], "hash of the graph")
            >>> scorer.score_recipes("earth", "water", ["mud", "earth"]).tolist()
            [1.0, 0.0]
        """
        rows = np.array(elicited, dtype=np.int64).reshape(-1, 3)
        rows[:, :2].sort(axis=1)
        rows, group = np.unique(rows, axis=0, return_inverse=True)
        strongest = np.zeros(len(rows), dtype=np.float32)
        np.maximum.at(strongest, group.reshape(-1), np.asarray(weights, dtype=np.float32))
        tensors = {"elicited": torch.from_numpy(rows.astype(np.int32)), "weights": torch.from_numpy(strongest)}
        return cls(tensors, entities, graph_hash, **kwargs)

    def tensors(self) -> dict[str, Tensor]:
        """Return the tensors that the constructor takes, by name."""
        return {"elicited": self.elicited, "weights": self.weights}

    def weighted_recipes(self) -> tuple[Tensor, Tensor]:
        """Return the elicited recipes, shape (n, 3), int64, in ascending order, and the weights, shape (n,)."""
        return self.elicited.long(), self.weights

    @property
    def observed(self) -> Ids:
        """Triples of all elicited recipes, shape (T, 3), in ascending order."""
        return recipe_triples(self.elicited.numpy().astype(np.int64))

    def score_recipes(self, ingredients: EntityIds, others: EntityIds, results: EntityIds) -> Tensor:
        """Return each recipe's weight, float32, or 0 if not elicited; labels or ids broadcast as in NumPy.

        Raises:
            UnknownEntityError: for an unknown label or id.
        """
        ids = torch.broadcast_tensors(*(self.entity_ids(part) for part in (ingredients, others, results)))
        return weights_of(torch.stack(ids, dim=-1), self._keys, self._weights, len(self.entities))

    def supporting_recipes(self, ingredient: str, other: str, result: str, limit: int = 5) -> list[Witness]:
        """Return an empty list: an elicited recipe is not supported by training recipes."""
        self.entity_ids([ingredient, other, result])
        return []

    def _strongest_links(self) -> tuple[Tensor, Tensor]:
        size = len(self.entities)
        a, b, c = self.elicited.numpy().astype(np.int64).T
        keys = np.concatenate(
            [
                *((COMBINES_WITH * size + head) * size + tail for head, tail in ((a, b), (b, a))),
                *((COMPONENT_OF * size + head) * size + c for head in (a, b)),
            ]
        )
        links, group = np.unique(keys, return_inverse=True)
        strongest = np.zeros(len(links), dtype=np.float32)
        np.maximum.at(strongest, group.reshape(-1), np.tile(self.weights.numpy(), 4))
        weights = torch.from_numpy(np.append(strongest, np.float32(0)))
        return with_end(torch.from_numpy(links)).to(self.device), weights.to(self.device)

    def _score(self, heads: Tensor, relations: Tensor, tails: Tensor) -> Tensor:
        size, (known, weights) = len(self.entities), self._links
        keys = ((relations * size + heads) * size + tails).contiguous()
        rows = torch.searchsorted(known, keys)
        return torch.where(known[rows] == keys, weights[rows], 0.0)

    def table(self, relation: int | str) -> Tensor:  # noqa: D102 - inherited
        size, (known, weights) = len(self.entities), self._links
        cells = known - self.relation_ids(relation) * size**2
        is_cell = (cells >= 0) & (cells < size**2)
        table = torch.zeros(size, size, device=self.device)
        table.view(-1)[cells[is_cell]] = weights[is_cell]
        return table

    @staticmethod
    def check(tensors: Mapping[str, Tensor], size: int) -> None:  # noqa: D102 - inherited
        elicited, weights = tensors["elicited"], tensors["weights"]
        count = len(elicited) if elicited.ndim else 0
        check_shapes(tensors, {"elicited": (count, 3), "weights": (count,)}, {"elicited": torch.int32})
        if size > _MOST_ENTITIES:
            raise ValueError(f"there are {size:,} entities; expected at most {_MOST_ENTITIES:,}")
        if not len(elicited):
            return
        check_ids("elicited", elicited, size - 1)
        keys = recipe_keys(elicited.long(), size)
        if bool((elicited[:, 0] > elicited[:, 1]).any()) or not bool((keys[1:] > keys[:-1]).all()):
            raise ValueError("elicited recipes are unsorted or duplicated")
        if not bool((torch.isfinite(weights) & (weights > 0)).all()):
            raise ValueError("weights must be above 0")
