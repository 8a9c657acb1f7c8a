"""The recipe scorer by neighbour lists, as a model folder stores it."""

from collections.abc import Mapping
from typing import ClassVar

import torch
from torch import Tensor

from wordcraft_kg.graphs.triples import COMBINES_WITH, RELATIONS
from wordcraft_kg.models.scorers.neighbours.knowledge import (
    BUFFERS,
    FEATURES,
    LINK_FEATURES,
    NeighbourKnowledge,
)
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

    Recipe scores are those of a ranker, as in :class:`RecipeScorer`. Link scores are those of the
    link rankers.

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
        """Return matrices whose products stand for scores where a table of them has no room.

        They are the kernel regression, one of the link ranker's features.

        Args:
            relation: relation id or label.

        Returns:
            ``left`` and ``right``, shape (E, m), float32: a pair scores their product.
        """
        lists = self.knowledge.lists()
        is_pair = int(self.relation_ids(relation)) == COMBINES_WITH
        left = torch.from_numpy(lists.pair_left if is_pair else lists.left)
        right = torch.from_numpy(lists.right)
        return left.to(self.device), right.to(self.device)

    def _score(self, heads: Tensor, relations: Tensor, tails: Tensor) -> Tensor:
        heads, relations, tails = torch.broadcast_tensors(heads, relations, tails)
        scores = torch.zeros(heads.shape, device=self.device)
        for relation in relations.unique().tolist():
            is_own = relations == relation
            own_heads = heads[is_own]
            own_tails = tails[is_own]
            known_heads, row = own_heads.unique(return_inverse=True)
            known_tails, column = own_tails.unique(return_inverse=True)
            # Whole rows are scored, so the side with fewer entities is cheaper.
            if relation == COMBINES_WITH or len(known_heads) <= len(known_tails):
                of_rows = self.knowledge.link_scores(relation, known_heads)
                scores[is_own] = of_rows[row, own_tails]
            else:
                of_columns = self.knowledge.link_scores(relation, known_tails, heads=True)
                scores[is_own] = of_columns[column, own_heads]
        return scores

    def table(self, relation: int | str) -> Tensor:  # noqa: D102 - inherited
        every = torch.arange(len(self.entities), device=self.device)
        return self.knowledge.link_scores(int(self.relation_ids(relation)), every)

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
        for number, relation in enumerate(RELATIONS):
            first = tensors[f"{relation}_first"]
            width = first.shape[-1] if first.ndim else 0
            shapes |= {
                f"{relation}_first": (1, len(LINK_FEATURES[number]), width),
                f"{relation}_first_bias": (1, width),
                f"{relation}_second": (1, width),
                f"{relation}_bias": (1,),
            }
        assert {*shapes} == {*BUFFERS}
        check_shapes(tensors, shapes, _DTYPES)
        check_ids("recipes", tensors["recipes"], size - 1)
        # -1 ends a list.
        check_ids("near_words", tensors["near_words"] + 1, size)
