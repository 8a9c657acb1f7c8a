"""The recipe scorer by neighbour lists, as a model folder stores it."""

from collections.abc import Mapping
from typing import ClassVar

import torch
from torch import Tensor

from wordcraft_kg.graphs.triples import COMBINES_WITH
from wordcraft_kg.models.scorers.factors import product_scores
from wordcraft_kg.models.scorers.neighbours.knowledge import BUFFERS, FEATURES, NeighbourKnowledge
from wordcraft_kg.models.scorers.pair_knowledge import PairKnowledge
from wordcraft_kg.models.scorers.recipes import RecipeScorer
from wordcraft_kg.models.scorers.scorer import check_ids, check_shapes

_DTYPES = {
    "vectors": torch.half,
    "near_words": torch.int32,
    "recipes": torch.int32,
    "seen": torch.bool,
}
"""Stored tensor types, where not float32."""


class NeighbourRecipeScorer(RecipeScorer):
    """A recipe scorer for books of any size: features come from neighbour lists, not from tables.

    Recipe scores are those of a ranker, as in :class:`RecipeScorer`. Link scores are a kernel
    regression at low rank, see :mod:`~wordcraft_kg.models.scorers.neighbours.regression`.

    Attributes:
        kind: ``recipes-by-neighbours``, the scorer kind in ``vocabulary.json``.
        shared: tensors that the models of all folds have in common, stored once.
        knowledge: recipes, words and the ranker.
    """

    kind: ClassVar[str] = "recipes-by-neighbours"
    shared: ClassVar[tuple[str, ...]] = ("vectors", "near_words")
    knowledge: NeighbourKnowledge

    @staticmethod
    def knowledge_of(tensors: Mapping[str, Tensor]) -> PairKnowledge:  # noqa: D102 - inherited
        return NeighbourKnowledge(tensors)

    def tensors(self) -> dict[str, Tensor]:  # noqa: D102 - inherited
        return self.knowledge.constants()

    def factors(self, relation: int | str) -> tuple[Tensor, Tensor]:
        """Return float32 matrices ``left`` and ``right``, (E, m): a pair scores their product."""
        lists = self.knowledge.lists()
        is_pair = int(self.relation_ids(relation)) == COMBINES_WITH
        left = torch.from_numpy(lists.pair_left if is_pair else lists.left)
        right = torch.from_numpy(lists.right)
        return left.to(self.device), right.to(self.device)

    def _score(self, heads: Tensor, relations: Tensor, tails: Tensor) -> Tensor:
        # A query for a single relation, the usual case, needs one product instead of two.
        relation = relations.unique()
        if len(relation) == 1:
            return product_scores(*self.factors(int(relation)), heads, relations, tails)
        scores = [
            product_scores(*self.factors(relation), heads, relations, tails)
            for relation in range(2)
        ]
        is_pair = relations == COMBINES_WITH
        return torch.where(is_pair, scores[COMBINES_WITH], scores[1 - COMBINES_WITH])

    def table(self, relation: int | str) -> Tensor:  # noqa: D102 - inherited
        left, right = self.factors(relation)
        return left @ right.T

    @staticmethod
    def check(tensors: Mapping[str, Tensor], size: int) -> None:  # noqa: D102 - inherited
        hidden = tensors["first"].shape[-1] if tensors["first"].ndim else 0
        number = len(tensors["recipes"])
        shapes: dict[str, tuple[int, ...]] = {
            "vectors": (size, tensors["vectors"].shape[-1]),
            "near_words": (size, tensors["near_words"].shape[-1]),
            "recipes": (number, 3),
            "seen": (1, number),
            "first": (1, len(FEATURES), hidden),
            "first_bias": (1, hidden),
            "second": (1, hidden),
            "bias": (1,),
        }
        assert {*shapes} == {*BUFFERS}
        check_shapes(tensors, shapes, _DTYPES)
        check_ids("recipes", tensors["recipes"], size - 1)
        # -1 ends a list.
        check_ids("near_words", tensors["near_words"] + 1, size)
