"""``wordcraft-kg describe``."""

import logging
from collections.abc import Iterable, Iterator, Sequence
from typing import TYPE_CHECKING

from wordcraft_kg.base.wording import counted, quoted
from wordcraft_kg.cli.console import Output, lines_of, names
from wordcraft_kg.cli.options import Graph

if TYPE_CHECKING:
    from wordcraft_kg.graphs.audit import Audit, BuiltGraph, EntityView, SplitSummary

EXAMPLES = (
    "wordcraft-kg describe everyday",
    "wordcraft-kg describe graphs/everyday --entity bread",
)


def describe(graph: Graph, *, entity: str | None = None, output: Output = Output()) -> None:
    """Audit a graph: ambiguity, reachability, layers, degrees, coverage, leaks; or show an entity.

    Args:
        entity: show this entity's recipes, uses and cheapest derivation instead.
    """
    from wordcraft_kg.graphs.audit import audit, view_entity
    from wordcraft_kg.graphs.folder import open_graph

    opened = open_graph(graph)
    if entity is not None:
        view = view_entity(opened.graph, entity)
        output.result(view, _entity_text(view))
    else:
        audited = audit(opened.graph, opened.split)
        warn_of_base(audited)
        warn_of_cases(opened.graph.entities)
        warn_of_missing(opened.graph.entities)
        title = f"graph {opened.graph.name}"
        output.result(audited, [title, *lines_of_graph(audited), *note_of_shares(audited.split)])


def lines_of_graph(view: "Audit | BuiltGraph") -> Iterator[str]:
    """Yield a graph's figures as text, after a line about how its file was read."""
    import msgspec

    if view.reading is not None:
        yield view.reading.line()
    yield from lines_of(msgspec.structs.replace(view, reading=None))


def warn_of_base(audited: "Audit") -> None:
    """Log warnings about an inferred base, and about entities that cannot be made from the base."""
    logger = logging.getLogger(__name__)
    base = names([*map(quoted, audited.base)], len(audited.base))
    # Everything else is counted from the base, so a wrong guess spoils all numbers.
    if not audited.base:
        logger.warning(
            "no entity lacks a recipe, so no base can be inferred and nothing can be made. Name "
            "the base in the book (# base: a, b) or with build-graph --base."
        )
        return
    if audited.base_is_inferred:
        entities = counted(len(audited.base), "entity", "entities")
        logger.warning(
            "no base is named, so the base is the %s without a recipe: %s. Name the base in the "
            "book (# base: a, b) or "
            "with build-graph --base.",
            entities,
            base,
        )
    unreachable = audited.reachability.unreachable
    if unreachable:
        labels = [*map(quoted, audited.reachability.unreachable_entities)]
        which = names(labels, unreachable)
        number = f"{unreachable:,} of {audited.entities:,}"
        logger.warning("%s entities cannot be made from the base (%s): %s", number, base, which)


def warn_of_cases(labels: Sequence[str]) -> None:
    """Log a warning about labels that differ only in case, width or variation selectors.

    A chat bot lists results as Lava and ingredients as lava: then half of the recipes are out of
    reach, and nothing else names the cause.
    """
    from wordcraft_kg.graphs.recipes import case_variants

    variants = case_variants(labels)
    if not variants:
        return
    shown = names([" and ".join(map(quoted, group)) for group in variants], len(variants))
    logging.getLogger(__name__).warning(
        "%s only in case: %s. If they are the same thing, read the book with --case fold.",
        "2 labels differ" if len(variants) == 1 else f"{len(variants):,} groups of labels differ",
        shown,
    )


def warn_of_missing(labels: Sequence[str]) -> None:
    """Log a warning about labels that often stand for nothing, such as NA, and are entities."""
    from wordcraft_kg.graphs.label_notes import note_of_missing

    for note in note_of_missing(labels):
        logging.getLogger(__name__).warning(
            "%s; leave such rows out where they mean a missing value or no result.", note
        )


def note_of_shares(split: "SplitSummary") -> Iterator[str]:
    """Yield a line if recipes were moved to train, so that the split has other shares than set."""
    moved = split.moved_for_coverage
    recipes = (split.train_recipes, split.valid_recipes, split.test_recipes)
    test_ratio = 1 - split.train_ratio - split.valid_ratio
    wanted = _percentages((split.train_ratio, split.valid_ratio, test_ratio))
    actual = _percentages([number / sum(recipes) for number in recipes])
    # In percent, a few moved recipes in a large book change nothing.
    if moved and wanted != actual:
        reason = f"{moved:,} recipes were moved to train so that every entity has a train recipe"
        yield (
            f"note: split {actual} instead of {wanted}: {reason}; "
            "--split by-recipe-plain moves no recipe"
        )


def _percentages(shares: Iterable[float]) -> str:
    # What rounds to 0 % is left out, such as a part that a split does not have.
    return "/".join(f"{share:.0%}" for share in shares if share >= 0.005)


def _entity_text(view: "EntityView") -> Iterator[str]:
    place = "base entity" if view.base else "cannot be made from the base"
    if view.half_product:
        place = "half-product of a chain, no thing of the game"
    elif view.layer is not None and not view.base:
        place = f"first made in round {view.layer}"
    yield f"{view.entity}: {place}"
    # Recipes that make the entity, then recipes that use it.
    for title, recipes in (("recipes", view.recipes), ("uses", view.uses)):
        yield f"{title} ({len(recipes)})"
        yield from (f"  {recipe}" for recipe in recipes)
    if view.derivation and view.derivation.steps:
        from wordcraft_kg.graphs.planner import derivation_tree

        yield f"cheapest derivation ({len(view.derivation.steps)})"
        yield from (f"  {line}" for line in derivation_tree(view.entity, view.derivation.steps))
