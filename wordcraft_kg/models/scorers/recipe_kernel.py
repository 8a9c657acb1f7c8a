"""The recipe-to-recipe kernel: how plausible a recipe is by the known recipes that are like it."""

from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from wordcraft_kg.base.settings import whole
from wordcraft_kg.graphs.arrays import Ids
from wordcraft_kg.graphs.recipe_graph import RecipeGraph
from wordcraft_kg.models.scorers.limits import TABLE_LIMIT
from wordcraft_kg.models.scorers.similarity_rows import CELLS, SimilarityRows

NEIGHBOURS = 64
"""Known recipes that are asked about a result: those whose results are most like it. More change nothing."""


class SpeakingRecipe(NamedTuple):
    """A known recipe that speaks for another one.

    Attributes:
        recipe: its row among the recipes that the kernel was made from.
        weight: its share of the score; the shares of all recipes that were asked add up to it.
    """

    recipe: int
    weight: float


class RecipeKernel:
    """Scores recipes by ``G(a, b -> c) = Σ_r k(a, a_r) k(b, b_r) k(c, c_r)`` over known recipes r; nothing is trained.

    k is the square of the normalised similarity of entities, so a recipe that is known has a score of 1 or more. A pair
    has no order, so ``k(a, b_r) k(b, a_r)`` is added, but for recipes of one entity twice, which have one order only.
    Of each result only the :data:`NEIGHBOURS` known recipes with the results most like it are asked, its own first.

    Source: kernel density estimation with a product kernel (Nadaraya 1964 and Watson 1964 for its use as a regression);
    Basilico and Hofmann 2004 for products of kernels of the parts.
    """

    def __init__(
        self,
        graph: RecipeGraph,
        recipes: Ids,
        vectors: NDArray[np.floating] | None = None,
        *,
        neighbours: int = NEIGHBOURS,
    ):
        """Find the recipes to be asked about each entity.

        Args:
            graph: the graph of the ids.
            recipes: shape (n, 3), those that may be looked at, such as ``split.recipes("train")``.
            vectors: vectors of the entities' words, shape (E, D), zeros where there is none; None to do without.
            neighbours: how many recipes are asked.
        """
        whole("neighbours", neighbours, 1)
        self.graph_hash, self.entities = graph.hash, graph.entities
        self.recipes = torch.from_numpy(recipes.copy())
        self._similarity = SimilarityRows.of(recipes, graph.num_entities, vectors)
        fits = graph.num_entities**2 * 4 <= TABLE_LIMIT
        self._table = self._alike(torch.arange(graph.num_entities)) if fits else None
        self._asked = torch.empty(graph.num_entities, min(neighbours, len(recipes)), dtype=torch.int64)
        self._weights = torch.empty(self._asked.shape)
        if len(recipes):
            for ids in self._similarity.blocks():
                self._ask(ids)

    def score_recipes(self, a: Tensor | int, b: Tensor | int, c: Tensor | int) -> Tensor:
        """Return the scores of recipes of ids that broadcast against each other: float32, of the broadcast shape."""
        ids = torch.broadcast_tensors(*(torch.as_tensor(part, dtype=torch.int64) for part in (a, b, c)))
        flat = [part.reshape(-1) for part in ids]
        scores = torch.zeros(flat[0].shape)
        cells = max(self._asked.shape[1], 1) * 4 if self._table is not None else 2 * len(self.entities)
        for some in torch.arange(len(scores)).split(max(1, CELLS // cells)):
            scores[some] = self._terms(*(part[some] for part in flat)).sum(1)
        return scores.view(ids[0].shape)

    def speaking_for(self, a: int, b: int, c: int, limit: int = 5) -> list[SpeakingRecipe]:
        """Return the known recipes that speak most for ``a + b -> c``, at most ``limit``, largest weight first.

        Those that say nothing are left out, so there may be none.
        """
        (weights,) = self._terms(*(torch.tensor([part]) for part in (a, b, c)))
        order = torch.sort(weights, descending=True, stable=True).indices[:limit].tolist()
        return [SpeakingRecipe(int(self._asked[c, i]), float(weights[i])) for i in order if weights[i] > 0]

    def _terms(self, a: Tensor, b: Tensor, c: Tensor) -> Tensor:
        """Return what each of the recipes that are asked says, shape (N, neighbours)."""
        one, other, _ = self.recipes[self._asked[c]].unbind(-1)
        if self._table is None:
            known, place = torch.cat([a, b]).unique(return_inverse=True)
            alike, (a, b) = self._alike(known), place.view(2, -1)
        else:
            alike = self._table
        a, b = a[:, None], b[:, None]
        turned = (alike[a, other] * alike[b, one]).masked_fill(one == other, 0)
        return (alike[a, one] * alike[b, other] + turned) * self._weights[c]

    def _alike(self, ids: Tensor) -> Tensor:
        return self._similarity.normalised_rows(ids) ** 2

    def _ask(self, ids: Tensor) -> None:
        """Find the recipes to be asked about some entities: those of the results most like them, result by result."""
        alike = self._alike(ids) if self._table is None else self._table[ids]
        order = torch.argsort(self.recipes[:, 2], stable=True)
        results, amounts = self.recipes[:, 2].unique(return_counts=True)
        first = amounts.cumsum(0) - amounts
        limit = self._asked.shape[1]
        ranked = alike[:, results].masked_fill(results == ids[:, None], torch.inf)
        nearest = ranked.topk(min(limit, len(results)), dim=1).indices
        ends = amounts[nearest].cumsum(1)
        slots = torch.arange(limit).expand(len(ids), limit).contiguous()
        which = torch.searchsorted(ends, slots, right=True)
        result = nearest.gather(1, which)
        start = ends.gather(1, which) - amounts[result]
        self._asked[ids] = order[first[result] + slots - start]
        self._weights[ids] = alike.gather(1, results[result])
