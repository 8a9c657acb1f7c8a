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
    """A known recipe that supports a scored recipe, as labels; weight and share as in ``Support``."""

    ingredient_a: str
    ingredient_b: str
    result: str
    weight: Share
    share: Share

    @classmethod
    def of(cls, supporting: Support, entities: Sequence[str]) -> "Witness":
        """Return ``supporting`` with labels in place of ids; ``entities`` are labels in id order."""
        a, b, result = (entities[entity] for entity in supporting.recipe)
        return cls(a, b, result, supporting.weight, supporting.share)

    @property
    def recipe(self) -> Recipe:
        """The supporting recipe without its weight."""
        return Recipe(self.ingredient_a, self.ingredient_b, self.result)


@runtime_checkable
class RecipeScores(TripleScorer, Protocol):
    """Interface of scorers that also score whole recipes; ``recipes``, ids (n, 3), are the training recipes."""

    recipes: Tensor

    def score_recipes(
        self, ingredients: EntityIds, others: EntityIds, results: EntityIds
    ) -> Tensor:
        """Score recipes, two ingredients in any order and a result; ids or labels broadcast."""
        ...

    def supporting_recipes(
        self, ingredient: str, other: str, result: str, limit: int = 5
    ) -> list[Witness]:
        """Return at most ``limit`` training recipes that support a recipe: those for ``result`` first."""
        ...


class RecipeScorer(StoredScorer):
    """A learned scorer for recipes and links: small networks (rankers) on recipe features.

    The networks learn from out-of-sample features. Recipe scores are in nats: the log-odds, up to a constant, that an
    ingredient pair makes the goal, given that some pair on the table does. Link scores come from the link ranker.

    Attributes:
        knowledge: feature arrays and the recipe ranker.
        recipes: shape (n, 3), training recipes.
        link_rankers: link ranker weights by relation, for entities outside the graph.
    """

    kind: ClassVar[str] = "recipes"
    knowledge: PairKnowledge

    def __init__(
        self, tensors: Mapping[str, Tensor], entities: Sequence[str], graph_hash: str, **kwargs: Any
    ):
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
        links = {
            f"{relation}.{name}": weights
            for relation, ranker in self.link_rankers.items()
            for name, weights in ranker.items()
        }
        return {**self.knowledge.constants(), **links, "recipes": self.recipes}

    def _score(self, heads: Tensor, relations: Tensor, tails: Tensor) -> Tensor:
        of_pairs, of_parts = self._link_tables()
        return torch.where(
            relations == COMBINES_WITH, of_pairs[heads, tails], of_parts[heads, tails]
        ).float()

    def table(self, relation: int | str) -> Tensor:  # noqa: D102 - inherited
        is_pair = int(self.relation_ids(relation)) == COMBINES_WITH
        of_pairs, of_parts = self._link_tables()
        return (of_pairs if is_pair else of_parts)[:-1, :-1].float()

    def _link_tables(self) -> tuple[Tensor, Tensor]:
        """Return the link ranker's scores of combinesWith and componentOf, (E + 1, E + 1) each."""
        assert isinstance(self.knowledge, RecipeKnowledge)
        return self.knowledge.pairs[0, ..., 1], self.knowledge.parts[0, ..., 1]

    def score_recipes(
        self, ingredients: EntityIds, others: EntityIds, results: EntityIds
    ) -> Tensor:
        """Score recipes, two ingredients in any order and a result; float32, in nats."""
        ids = torch.broadcast_tensors(
            *(self.entity_ids(part) for part in (ingredients, others, results))
        )
        a, b, result = (part.reshape(-1) for part in ids)
        scores = [
            self.knowledge(goal, torch.stack(pair, dim=1), torch.zeros_like(goal))[:, 0, 1]
            for goal, *pair in zip(result.split(_ROWS), a.split(_ROWS), b.split(_ROWS), strict=True)
        ]
        return torch.cat(scores).view(ids[0].shape)

    def supporting_recipes(
        self, ingredient: str, other: str, result: str, limit: int = 5
    ) -> list[Witness]:
        """Return at most ``limit`` train recipes that support a recipe, or itself: those for ``result`` first."""
        a, b, goal = self.entity_ids([ingredient, other, result]).tolist()
        supports = self.knowledge.supporting_recipes(a, b, goal, limit=limit)
        return [Witness.of(support, self.entities) for support in supports]

    @staticmethod
    def check(tensors: Mapping[str, Tensor], size: int) -> None:  # noqa: D102 - inherited
        hidden = tensors["first"].shape[-1] if tensors["first"].ndim else 0
        known = tuple(tensors["results"].shape[1:]) if tensors["results"].ndim == 3 else (1, 1)
        square = (size + 1, size + 1)
        columns = max(size + 1, tensors["words"].shape[-1] if tensors["words"].ndim else 0)
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
            if tensors[name].dtype.is_floating_point and not bool(
                torch.isfinite(tensors[name]).all()
            ):
                raise ValueError(f"{name} contains numbers that are not finite")
        for name, high in (
            ("supporting", columns - 1),
            ("recipes", size - 1),
            ("results", size),
            ("numbers", known[0] - 1),
        ):
            check_ids(name, tensors[name], high)
