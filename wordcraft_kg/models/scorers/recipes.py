"""Recipe-level scores: how plausible it is that a pair makes a result, and which train recipes say so."""

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, Protocol, runtime_checkable

import torch
from torch import Tensor

from wordcraft_kg.base.records import Record, Share
from wordcraft_kg.base.tensors import with_prefix
from wordcraft_kg.graphs.recipes import Recipe
from wordcraft_kg.graphs.triples import COMBINES_WITH, RELATIONS
from wordcraft_kg.models.scorers.pair_features import BUFFERS, EVIDENCE, FEATURES, RANKER, RecipeKnowledge, Speaking
from wordcraft_kg.models.scorers.protocol import TripleScorer
from wordcraft_kg.models.scorers.scorer import EntityIds, StoredScorer, check_ids, check_shapes

ROWS = 4_096
"""Recipes scored at a time."""
DTYPES = {
    **dict.fromkeys(("parts", "pairs", "alike", "words"), torch.half),
    **dict.fromkeys(("numbers", "results", "recipes"), torch.int32),
    "speaking": torch.int16,
}
"""Types of the stored tensors that are not float32."""


class Witness(Record):
    """A recipe that supports another one, see :class:`~wordcraft_kg.models.scorers.pair_features.Speaking`."""

    ingredient_a: str
    ingredient_b: str
    result: str
    weight: Share
    share: Share

    @classmethod
    def of(cls, speaking: Speaking, entities: Sequence[str]) -> "Witness":
        """Give the ids their labels."""
        a, b, result = (entities[entity] for entity in speaking.recipe)
        return cls(a, b, result, speaking.weight, speaking.share)

    @property
    def recipe(self) -> Recipe:
        """The recipe, as a value of its own."""
        return Recipe(self.ingredient_a, self.ingredient_b, self.result)


@runtime_checkable
class RecipeScores(TripleScorer, Protocol):
    """A scorer that scores recipes, too; ``recipes``, shape (n, 3), are those of its training."""

    recipes: Tensor

    def score_recipes(self, ingredients: EntityIds, others: EntityIds, results: EntityIds) -> Tensor:
        """Return how plausible it is that each pair makes a result; ids broadcast, the order of a pair is no matter."""
        ...

    def speaking_for(self, ingredient: str, other: str, result: str, limit: int = 5) -> list[Witness]:
        """Return the recipes that speak for a recipe, those that say most first."""
        ...


class RecipeScorer(StoredScorer):
    """The learned scorer of recipes and links: rankers on features of recipes that were held out of the features.

    A score of a recipe is in nats: the log-odds, up to a constant, that among the pairs on a table it is this one that
    makes the goal. Scores of links are those of the link ranker.

    Attributes:
        knowledge: tables and rankers.
        recipes: shape (n, 3), the recipes of its training.
        link_rankers: weights of the link rankers by relation, which score entities that are not in the graph.
    """

    kind: ClassVar[str] = "recipes"

    def __init__(self, tensors: Mapping[str, Tensor], entities: Sequence[str], graph_hash: str, **kwargs: Any):
        """Take the tensors that :meth:`tensors` returns.

        Raises:
            KeyError: if one is missing.
            ValueError: if one has another shape or type than the entities ask for.
        """
        super().__init__(entities, graph_hash, **kwargs)
        self.check(tensors, len(self.entities))
        self.knowledge = RecipeKnowledge(tensors).to(self.device).requires_grad_(False)
        self.recipes = tensors["recipes"]
        self.link_rankers = {relation: with_prefix(tensors, f"{relation}.") for relation in RELATIONS}

    def tensors(self) -> dict[str, Tensor]:
        """Return the tensors that it can be made from again."""
        links = {
            f"{of}.{name}": weights for of, ranker in self.link_rankers.items() for name, weights in ranker.items()
        }
        return {**self.knowledge.constants(), **links, "recipes": self.recipes}

    def _score(self, heads: Tensor, relations: Tensor, tails: Tensor) -> Tensor:
        of_pairs, of_parts = (self.knowledge.pairs[0, ..., 1], self.knowledge.parts[0, ..., 1])
        return torch.where(relations == COMBINES_WITH, of_pairs[heads, tails], of_parts[heads, tails]).float()

    def table(self, relation: int | str) -> Tensor:  # noqa: D102 - inherited
        is_pair = int(self.relation_ids(relation)) == COMBINES_WITH
        return (self.knowledge.pairs if is_pair else self.knowledge.parts)[0, :-1, :-1, 1].float()

    def score_recipes(self, ingredients: EntityIds, others: EntityIds, results: EntityIds) -> Tensor:
        """Score recipes given by ids or labels: one, a sequence, or a tensor of ids of any shape, which broadcast.

        Returns:
            float32, of the broadcast shape, nats.

        Raises:
            UnknownEntityError: for a label or id that the scorer does not know.
        """
        ids = torch.broadcast_tensors(*(self.entity_ids(part) for part in (ingredients, others, results)))
        a, b, result = (part.reshape(-1) for part in ids)
        found = [
            self.knowledge(goal, torch.stack(pair, dim=1), torch.zeros_like(goal))[:, 0, 1]
            for goal, *pair in zip(result.split(ROWS), a.split(ROWS), b.split(ROWS), strict=True)
        ]
        return torch.cat(found).view(ids[0].shape)

    def speaking_for(self, ingredient: str, other: str, result: str, limit: int = 5) -> list[Witness]:
        """Return at most ``limit`` recipes that support a recipe of labels, largest share of the evidence first.

        These are train recipes, and the recipe itself if it is one. Evidence is one of the features of a score, see
        :data:`~wordcraft_kg.models.scorers.pair_features.FEATURES`.

        Raises:
            UnknownEntityError: for a label that the scorer does not know.
        """
        a, b, goal = self.entity_ids([ingredient, other, result]).tolist()
        found = self.knowledge.speaking_for(a, b, goal, limit=limit)
        return [Witness.of(speaking, self.entities) for speaking in found]

    @staticmethod
    def check(tensors: Mapping[str, Tensor], size: int) -> None:  # noqa: D102 - inherited
        hidden = tensors["first"].shape[-1] if tensors["first"].ndim else 0
        known = tuple(tensors["results"].shape[1:]) if tensors["results"].ndim == 3 else (1, 1)
        square = (size + 1, size + 1)
        shapes: dict[str, tuple[int, ...]] = {
            "parts": (1, *square, 2),
            "pairs": (1, *square, 2),
            "numbers": (1, *square),
            "results": (1, *known),
            "alike": (1, *square),
            "words": square,
            "counts": (1, size + 1, 2),
            "speaking": (1, size + 1, EVIDENCE, 3),
            "first": (1, len(FEATURES), hidden),
            "first_bias": (1, hidden),
            "second": (1, hidden),
            "bias": (1,),
            "recipes": (len(tensors["recipes"]), 3),
        }
        assert {*shapes} == {*BUFFERS, "recipes"}
        for relation in RELATIONS:
            links, width = tensors[f"{relation}.first"].shape
            ranker = {"first": (links, width), "first_bias": (width,), "second": (width,), "bias": ()}
            shapes |= {f"{relation}.{name}": ranker[name] for name in RANKER}
        check_shapes(tensors, shapes, DTYPES)
        for name in shapes:
            if tensors[name].dtype.is_floating_point and not bool(torch.isfinite(tensors[name]).all()):
                raise ValueError(f"{name} holds numbers that are not finite")
        for name, high in (("speaking", size), ("recipes", size - 1), ("results", size), ("numbers", known[0] - 1)):
            check_ids(name, tensors[name], high)
