"""The interface through which environments, policies and reports use any scorer."""

from typing import TYPE_CHECKING, Protocol, runtime_checkable

from wordcraft_kg.base.errors import GraphMismatchError
from wordcraft_kg.graphs.recipe_graph import RecipeGraph

if TYPE_CHECKING:
    import torch

    from wordcraft_kg.models.scorers.scorer import EntityIds, RelationIds


@runtime_checkable
class TripleScorer(Protocol):
    """Interface for scorers, which score triples in a recipe graph; higher means more plausible, on any scale.

    ``graph_hash`` is the recipe graph's content hash; ``entities`` are its labels in id order.
    """

    graph_hash: str
    entities: tuple[str, ...]

    def score(
        self, heads: "EntityIds", relations: "RelationIds", tails: "EntityIds"
    ) -> "torch.Tensor":
        """Score triples by ids or labels, which broadcast. Returns float32 on the scorer's device."""
        ...

    def table(self, relation: "int | str") -> "torch.Tensor":
        """Return the scores for all pairs in a relation: shape (E, E), float32, row = head, column = tail."""
        ...


@runtime_checkable
class FactoredScorer(TripleScorer, Protocol):
    """Interface for scorers that compute all pair scores as a product of two matrices, without a table."""

    def factors(self, relation: "int | str") -> "tuple[torch.Tensor, torch.Tensor]":
        """Return ``left`` and ``right``, shape (E, m), float32: a pair scores ``left[head] · right[tail]``."""
        ...


def check_scorer(scorer: TripleScorer, graph: RecipeGraph) -> None:
    """Raise GraphMismatchError if a scorer was made for a different graph."""
    if scorer.graph_hash != graph.hash:
        raise GraphMismatchError(
            f"{getattr(scorer, 'name', 'the scorer')} was trained on graph {scorer.graph_hash[:12]} "
            f"({len(scorer.entities)} entities) but '{graph.name}' is {graph.hash[:12]} ({graph.num_entities}). "
            "Train on this graph, or use the training graph."
        )
