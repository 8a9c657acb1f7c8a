"""The interfaces through which environments, policies and reports use any scorer.

This module imports no torch, so commands can name the interfaces without the cost of that import.
What a score is: docs/explanation/recipe-scorer.md for recipes, docs/link-prediction.md for triples.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Protocol, runtime_checkable

from wordcraft_kg.base import GraphMismatchError, Record, Share
from wordcraft_kg.graphs import Recipe, RecipeGraph

if TYPE_CHECKING:
    import torch

    from wordcraft_kg.models.scorers.neighbours.knowledge import Support
    from wordcraft_kg.models.scorers.scorer import EntityIds, RelationIds


@runtime_checkable
class TripleScorer(Protocol):
    """Interface for scorers of triples in a recipe graph: higher is more plausible, on any scale.

    Attributes:
        graph_hash: the recipe graph's content hash.
        entities: the graph's labels in id order.
    """

    graph_hash: str
    entities: tuple[str, ...]

    def score(
        self,
        heads: "EntityIds",
        relations: "RelationIds",
        tails: "EntityIds",
    ) -> "torch.Tensor":
        """Score triples by ids or labels.

        Args:
            heads: one entity, a sequence, or an array or tensor of ids of any shape.
            relations: one relation, or a tensor of ids.
            tails: as ``heads``; the three arguments broadcast against each other.

        Returns:
            float32 scores with the broadcast shape, on the scorer's device.
        """
        ...

    def table(self, relation: "int | str") -> "torch.Tensor":
        """Return scores for all pairs in a relation: (E, E), float32, row = head, column = tail."""
        ...


@runtime_checkable
class FactoredScorer(TripleScorer, Protocol):
    """Interface for scorers whose pair scores are a product of two matrices, without a table.

    Attributes:
        graph_hash: the recipe graph's content hash.
        entities: the graph's labels in id order.
    """

    def factors(self, relation: "int | str") -> "tuple[torch.Tensor, torch.Tensor]":
        """Return float32 matrices ``left`` and ``right``, (E, m).

        A pair scores ``left[head] · right[tail]``.
        """
        ...


class Witness(Record):
    """A known recipe that supports a scored recipe, by labels.

    Attributes:
        ingredient_a: label of the first ingredient.
        ingredient_b: label of the second ingredient.
        result: label of the result.
        weight: similarity of the recipes, 1 for equality, as in ``Support``.
        share: share of the evidence among all supporting recipes, as in ``Support``.
        strength: evidence relative to the strongest supporting recipe, which has 1.
    """

    ingredient_a: str
    ingredient_b: str
    result: str
    weight: Share
    share: Share
    strength: Share

    @classmethod
    def of(cls, supporting: "Support", entities: Sequence[str]) -> "Witness":
        """Return ``supporting`` with labels in place of ids; ``entities`` are in id order."""
        a, b, result = (entities[entity] for entity in supporting.recipe)
        return cls(a, b, result, supporting.weight, supporting.share, supporting.strength)

    @property
    def recipe(self) -> Recipe:
        """The supporting recipe without its weight."""
        return Recipe.of(self.ingredient_a, self.ingredient_b, self.result)


def check_scorer(scorer: TripleScorer, graph: RecipeGraph) -> None:
    """Check that a scorer belongs to a graph, with its entities; the error names both graphs.

    Raises:
        GraphMismatchError: if it does not.
    """
    if scorer.graph_hash != graph.hash:
        raise GraphMismatchError(
            f"{getattr(scorer, 'name', 'the scorer')} was trained on graph "
            f"{scorer.graph_hash[:12]} ({len(scorer.entities)} entities) but '{graph.name}' is "
            f"{graph.hash[:12]} ({graph.num_entities}). Train on this graph, or use the training "
            "graph."
        )
    # A scorer of a user, or a forged folder, may claim the hash and have other labels: each score
    # would be one of other entities.
    if tuple(scorer.entities) != graph.entities:
        raise GraphMismatchError(
            f"the entities of {getattr(scorer, 'name', 'the scorer')} are not those of "
            f"'{graph.name}', or in another order, although the graph hash is equal. Use the "
            "graph's labels, ordered by id."
        )
