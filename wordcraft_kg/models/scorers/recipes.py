"""Scores for whole recipes, and the train recipes that support a score."""

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, Protocol, runtime_checkable

import torch
from torch import Tensor

from wordcraft_kg.base.records import Record, Share
from wordcraft_kg.base.tensors import with_prefix
from wordcraft_kg.graphs.recipes import Recipe
from wordcraft_kg.graphs.triples import COMBINES_WITH, RELATIONS
from wordcraft_kg.models.scorers.pair_features import (
    BUFFERS,
    EVIDENCE,
    FEATURES,
    RecipeKnowledge,
)
from wordcraft_kg.models.scorers.pair_knowledge import PairKnowledge, Support
from wordcraft_kg.models.scorers.protocol import TripleScorer
from wordcraft_kg.models.scorers.ranker import RANKER
from wordcraft_kg.models.scorers.scorer import EntityIds, StoredScorer, check_ids, check_shapes

_ROWS = 4_096
"""Recipes scored at once."""
_DTYPES = {
    **dict.fromkeys(("parts", "pairs", "alike", "words"), torch.half),
    **dict.fromkeys(("numbers", "results", "recipes"), torch.int32),
    "supporting": torch.int16,
}
"""Stored tensor types, where not float32."""


class Witness(Record):
    """A known recipe that supports a scored recipe, by labels.

    Attributes:
        ingredient_a: label of the first ingredient.
        ingredient_b: label of the second ingredient.
        result: label of the result.
        weight: similarity of the recipes, 1 for equality, as in ``Support``.
        share: share of the evidence among all supporting recipes, as in ``Support``.
    """

    ingredient_a: str
    ingredient_b: str
    result: str
    weight: Share
    share: Share

    @classmethod
    def of(cls, supporting: Support, entities: Sequence[str]) -> "Witness":
        """Return ``supporting`` with labels in place of ids; ``entities`` are in id order."""
        a, b, result = (entities[entity] for entity in supporting.recipe)
        return cls(a, b, result, supporting.weight, supporting.share)

    @property
    def recipe(self) -> Recipe:
        """The supporting recipe without its weight."""
        return Recipe(self.ingredient_a, self.ingredient_b, self.result)


@runtime_checkable
class RecipeScores(TripleScorer, Protocol):
    """Interface of scorers that also score whole recipes.

    Attributes:
        recipes: training recipes, ids (n, 3).
    """

    recipes: Tensor

    def score_recipes(
        self,
        ingredients: EntityIds,
        others: EntityIds,
        results: EntityIds,
    ) -> Tensor:
        """Score recipes.

        Args:
            ingredients: one entity, a sequence, or an array or tensor of ids of any shape.
            others: the second ingredients; their order does not count.
            results: as ``ingredients``; the three arguments broadcast against each other.

        Returns:
            the broadcast shape.
        """
        ...

    def supporting_recipes(
        self,
        ingredient: str,
        other: str,
        result: str,
        limit: int = 5,
    ) -> list[Witness]:
        """Return training recipes that support a recipe: those for ``result`` first.

        Args:
            ingredient: label of an ingredient.
            other: label of the other ingredient.
            result: label of the result.
            limit: maximum number of recipes.
        """
        ...


class RecipeScorer(StoredScorer):
    """A learned scorer for recipes and links: small networks (rankers) on recipe features.

    The networks learn from out-of-sample features. Recipe scores are in nats: the log-odds, up to a
    constant, that an ingredient pair makes the goal, given that some pair on the table does. Link
    scores come from the link ranker.

    Attributes:
        kind: ``recipes``, the scorer kind in ``vocabulary.json``.
        knowledge: feature arrays and the recipe ranker.
        recipes: shape (n, 3), training recipes.
        link_rankers: link ranker weights by relation, for entities outside the graph.
    """

    kind: ClassVar[str] = "recipes"
    knowledge: PairKnowledge

    def __init__(
        self,
        tensors: Mapping[str, Tensor],
        entities: Sequence[str],
        graph_hash: str,
        **kwargs: Any,
    ):
        """Take over the stored tensors.

        Args:
            tensors: tensors by name, see :meth:`check`.
            entities: labels in id order.
            graph_hash: content hash of the recipe graph that the ids belong to.
            kwargs: ``device`` and ``name``, as in ``Scorer``.

        Raises:
            KeyError: if a tensor is missing.
            ValueError: if a tensor has another shape or type, or holds an id or number out of
                range.
        """
        super().__init__(entities, graph_hash, **kwargs)
        self.check(tensors, len(self.entities))
        self.knowledge = self.knowledge_of(tensors).to(self.device).requires_grad_(False)
        self.recipes = tensors["recipes"]
        self.link_rankers = {
            relation: with_prefix(tensors, f"{relation}.") for relation in RELATIONS
        }

    @staticmethod
    def knowledge_of(tensors: Mapping[str, Tensor]) -> PairKnowledge:
        """Return the knowledge in checked tensors."""
        return RecipeKnowledge(tensors)

    def tensors(self) -> dict[str, Tensor]:
        """Return the tensors, by name, from which :meth:`restored` makes the scorer."""
        links = {}
        for relation, ranker in self.link_rankers.items():
            for name, weights in ranker.items():
                links[f"{relation}.{name}"] = weights
        return {**self.knowledge.constants(), **links, "recipes": self.recipes}

    def _score(self, heads: Tensor, relations: Tensor, tails: Tensor) -> Tensor:
        of_pairs, of_parts = self._link_tables()
        is_pair = relations == COMBINES_WITH
        return torch.where(is_pair, of_pairs[heads, tails], of_parts[heads, tails]).float()

    def table(self, relation: int | str) -> Tensor:  # noqa: D102 - inherited
        is_pair = int(self.relation_ids(relation)) == COMBINES_WITH
        of_pairs, of_parts = self._link_tables()
        table = of_pairs if is_pair else of_parts
        # Without the empty slot, which is the last row and column.
        return table[:-1, :-1].float()

    def _link_tables(self) -> tuple[Tensor, Tensor]:
        """Return the link ranker's scores of combinesWith and componentOf, (E + 1, E + 1) each."""
        # A scorer by neighbour lists has no tables, and overrides each method that needs them.
        assert isinstance(self.knowledge, RecipeKnowledge)
        pairs = self.knowledge.pairs[0]
        parts = self.knowledge.parts[0]
        # The last axis holds the scores of the recipe kernel and of the link ranker.
        return pairs[..., 1], parts[..., 1]

    def score_recipes(
        self,
        ingredients: EntityIds,
        others: EntityIds,
        results: EntityIds,
    ) -> Tensor:
        """Score recipes.

        Args:
            ingredients: one entity, a sequence, or an array or tensor of ids of any shape.
            others: the second ingredients; their order does not count.
            results: as ``ingredients``; the three arguments broadcast against each other.

        Returns:
            float32, the broadcast shape, in nats.

        Raises:
            UnknownEntityError: for a label or id that the scorer does not know.
        """
        ids = torch.broadcast_tensors(
            self.entity_ids(ingredients),
            self.entity_ids(others),
            self.entity_ids(results),
        )
        a, b, result = (part.reshape(-1) for part in ids)
        blocks = zip(result.split(_ROWS), a.split(_ROWS), b.split(_ROWS), strict=True)
        scores = []
        for goal, one, other in blocks:
            # A recipe is scored as a table of two slots, whose only pair is slot 0 with slot 1.
            table = torch.stack([one, other], dim=1)
            main_model = torch.zeros_like(goal)
            scores.append(self.knowledge(goal, table, main_model)[:, 0, 1])
        return torch.cat(scores).view(ids[0].shape)

    def supporting_recipes(
        self,
        ingredient: str,
        other: str,
        result: str,
        limit: int = 5,
    ) -> list[Witness]:
        """Return training recipes that support a recipe: those for ``result`` first.

        The recipe itself is among them if the model was trained on it.

        Args:
            ingredient: label of an ingredient.
            other: label of the other ingredient.
            result: label of the result.
            limit: maximum number of recipes.

        Raises:
            UnknownEntityError: for a label that the scorer does not know.
        """
        a, b, goal = self.entity_ids([ingredient, other, result]).tolist()
        supports = self.knowledge.supporting_recipes(a, b, goal, limit=limit)
        return [Witness.of(support, self.entities) for support in supports]

    @staticmethod
    def check(tensors: Mapping[str, Tensor], size: int) -> None:  # noqa: D102 - inherited
        # Sizes that only the tensors know. A tensor with a wrong number of axes must not end in an
        # IndexError here: it gets some size, and is refused by its shape below.
        first = tensors["first"]
        results = tensors["results"]
        words = tensors["words"]
        hidden = first.shape[-1] if first.ndim else 0
        known = tuple(results.shape[1:]) if results.ndim == 3 else (1, 1)
        word_columns = words.shape[-1] if words.ndim else 0
        columns = max(size + 1, word_columns)
        square = (size + 1, size + 1)
        shapes: dict[str, tuple[int, ...]] = {
            "parts": (1, *square, 2),
            "pairs": (1, *square, 2),
            "numbers": (1, *square),
            "results": (1, *known),
            "alike": (1, size + 1, columns),
            "words": (size + 1, columns),
            "counts": (1, size + 1, 2),
            "supporting": (1, size + 1, EVIDENCE, 3),
            "first": (1, len(FEATURES), hidden),
            "first_bias": (1, hidden),
            "second": (1, hidden),
            "bias": (1,),
            "recipes": (len(tensors["recipes"]), 3),
        }
        assert {*shapes} == {*BUFFERS, "recipes"}
        for relation in RELATIONS:
            links, width = tensors[f"{relation}.first"].shape
            ranker = {
                "first": (links, width),
                "first_bias": (width,),
                "second": (width,),
                "bias": (),
            }
            shapes |= {f"{relation}.{name}": ranker[name] for name in RANKER}
        check_shapes(tensors, shapes, _DTYPES)
        for name in shapes:
            tensor = tensors[name]
            if tensor.dtype.is_floating_point and not bool(torch.isfinite(tensor).all()):
                raise ValueError(f"{name} contains numbers that are not finite")
        # Ids index without checks later. Results and supporting recipes may hold the empty slot;
        # supporting recipes also hold entities of other books.
        check_ids("supporting", tensors["supporting"], columns - 1)
        check_ids("recipes", tensors["recipes"], size - 1)
        check_ids("results", results, size)
        check_ids("numbers", tensors["numbers"], known[0] - 1)
