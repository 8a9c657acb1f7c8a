"""``wordcraft-kg describe``."""

from collections.abc import Iterator
from typing import TYPE_CHECKING

from wordcraft_kg.cli.console import Output, lines_of
from wordcraft_kg.cli.options import Graph

if TYPE_CHECKING:
    from wordcraft_kg.evaluation.graphs import EntityView

EXAMPLES = ("wordcraft-kg describe everyday", "wordcraft-kg describe graphs/everyday --entity bread")


def describe(graph: Graph, *, entity: str | None = None, output: Output = Output()) -> None:
    """Audit a graph: ambiguity, reachability, layers, degrees, coverage and leakage; or show an entity.

    Args:
        entity: show this entity's recipes, uses and cheapest derivation instead.
    """
    from wordcraft_kg.evaluation.graphs import view_entity
    from wordcraft_kg.graphs.audit import audit
    from wordcraft_kg.graphs.folder import open_graph

    opened = open_graph(graph)
    if entity is not None:
        view = view_entity(opened.graph, entity)
        output.result(view, _entity_text(view))
    else:
        audited = audit(opened.graph, opened.split)
        output.result(audited, [f"graph {opened.graph.name}", *lines_of(audited)])


def _entity_text(view: "EntityView") -> Iterator[str]:
    place = "base entity" if view.base else "cannot be made from the base"
    if view.layer is not None and not view.base:
        place = f"first made in round {view.layer}"
    yield f"{view.entity}: {place}"
    for title, recipes in (("recipes", view.recipes), ("uses", view.uses)):
        yield f"{title} ({len(recipes)})"
        yield from (f"  {recipe}" for recipe in recipes)
    if view.derivation and view.derivation.steps:
        from wordcraft_kg.graphs.planner import derivation_tree

        yield f"cheapest derivation ({len(view.derivation.steps)})"
        yield from (f"  {line}" for line in derivation_tree(view.entity, view.derivation.steps))
