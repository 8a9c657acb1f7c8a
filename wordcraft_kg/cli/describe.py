"""``wordcraft-kg describe``."""

import logging
from collections.abc import Iterator
from typing import TYPE_CHECKING

from wordcraft_kg.base.wording import counted
from wordcraft_kg.cli.console import Output, lines_of, names
from wordcraft_kg.cli.options import Graph

if TYPE_CHECKING:
    from wordcraft_kg.evaluation.graphs import EntityView
    from wordcraft_kg.graphs.audit import Audit, SplitSummary

EXAMPLES = (
    "wordcraft-kg describe everyday",
    "wordcraft-kg describe graphs/everyday --entity bread",
)


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
        warn_of_base(audited)
        output.result(
            audited,
            [f"graph {opened.graph.name}", *lines_of(audited), *note_of_shares(audited.split)],
        )


def warn_of_base(audited: "Audit") -> None:
    """Log a warning about an inferred base, and another about entities that cannot be made from the base."""
    logger, base = logging.getLogger(__name__), names(audited.base, len(audited.base))
    if audited.base_is_inferred:
        entities = counted(len(audited.base), "entity", "entities")
        logger.warning(
            "no base is named, so the base is the %s without a recipe: %s. Name the base in the book (# base: a, b) or "
            "with build-graph --base.",
            entities,
            base,
        )
    unreachable = audited.reachability.unreachable
    if unreachable:
        which = names(audited.reachability.unreachable_entities, unreachable)
        number = f"{unreachable:,} of {audited.entities:,}"
        logger.warning("%s entities cannot be made from the base (%s): %s", number, base, which)


def note_of_shares(split: "SplitSummary") -> Iterator[str]:
    """Yield a line if recipes were moved to train, so that the split has other shares than the settings."""
    moved, recipes = (
        split.moved_for_coverage,
        (split.train_recipes, split.valid_recipes, split.test_recipes),
    )
    wanted = split.train_ratio, split.valid_ratio, 1 - split.train_ratio - split.valid_ratio
    actual = (number / sum(recipes) for number in recipes)
    shares = [
        "/".join(f"{share:.0%}" for share in row if share >= 0.005) for row in (wanted, actual)
    ]
    if moved and shares[0] != shares[1]:
        reason = f"{moved:,} recipes were moved to train so that every entity has a train recipe"
        yield f"note: split {shares[1]} instead of {shares[0]}: {reason}; --split by-recipe-plain moves no recipe"


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
