"""The result of building a graph, and the recipes of an entity."""

from pathlib import Path

from wordcraft_kg.base.errors import GraphError
from wordcraft_kg.base.records import Count, Record
from wordcraft_kg.graphs.audit import Audit, GraphCounts, SplitSummary
from wordcraft_kg.graphs.planner import Planner, layers
from wordcraft_kg.graphs.recipe_graph import RecipeGraph
from wordcraft_kg.graphs.recipes import Recipe


class BuiltGraph(GraphCounts, omit_defaults=True, kw_only=True):
    """The main counts of a new recipe graph, its triples and its split.

    Attributes:
        reachable: number of entities that can be made from the base, the base included.
        rounds: crafting rounds until no further entity can be made.
        split: size of the split's parts.
        out: the graph folder.
    """

    reachable: Count
    rounds: Count
    split: SplitSummary
    out: str


class CheapestDerivation(Record):
    """Recipes that make an entity from the base entities.

    Attributes:
        cost: number of combinations; an intermediate counts once for every use.
        steps: the recipes, in an order in which they can be crafted.
    """

    cost: Count
    steps: tuple[Recipe, ...]


class EntityView(Record, omit_defaults=True, kw_only=True):
    """An entity, the recipes that make it, and its uses.

    Attributes:
        entity: the label.
        base: whether the entity is a base entity.
        half_product: whether it is a half-product of a chain, no thing of the game.
        layer: crafting round that can first make the entity; None if it is unreachable.
        recipes: recipes that make the entity.
        uses: recipes that use the entity.
        derivation: the cheapest derivation; None if the entity is unreachable.
    """

    entity: str
    base: bool
    half_product: bool = False
    layer: Count | None
    recipes: tuple[Recipe, ...]
    uses: tuple[Recipe, ...]
    derivation: CheapestDerivation | None


def view_build(audit: Audit, folder: Path) -> BuiltGraph:
    """Return a new graph's main counts from its audit."""
    # Most fields stand in the audit under the same names.
    same = {
        name: getattr(audit, name) for name in BuiltGraph.__struct_fields__ if hasattr(audit, name)
    }
    reached = audit.reachability
    return BuiltGraph(**same, reachable=reached.reachable, rounds=reached.rounds, out=str(folder))


def view_entity(graph: RecipeGraph, label: str) -> EntityView:
    """Return an entity's recipes and the cheapest way to make it.

    Raises:
        UnknownEntityError: if the graph has no such label.
    """
    entity = graph.id_of(label)
    layer = int(layers(graph)[entity])
    try:
        cheapest = Planner(graph).derivation(entity)
        derivation = CheapestDerivation(cheapest.cost, tuple(cheapest.steps))
    except GraphError:
        # The base does not reach the entity, which is no error for a reader of its recipes.
        derivation = None
    return EntityView(
        entity=label,
        base=label in graph.base,
        half_product=bool(graph.is_half_product[entity]),
        layer=layer if layer >= 0 else None,
        recipes=tuple(graph.recipe_labels(graph.recipes[graph.recipes_of(entity)])),
        uses=tuple(graph.recipe_labels(graph.recipes[graph.uses_of(entity)])),
        derivation=derivation,
    )
