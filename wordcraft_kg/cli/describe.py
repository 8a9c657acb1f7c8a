"""``wordcraft-kg describe``."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from wordcraft_kg.base.wording import counted
from wordcraft_kg.cli.console import Output, aligned, names
from wordcraft_kg.cli.options import Book
from wordcraft_kg.cli.splits import split_rows

if TYPE_CHECKING:
    from wordcraft_kg.evaluation.graphs import EntityView
    from wordcraft_kg.graphs.audit import Audit
    from wordcraft_kg.graphs.recipes import Recipe

EXAMPLES = ("wordcraft-kg describe everyday", "wordcraft-kg describe graphs/everyday --entity bread")


def describe(graph: Book, *, entity: str | None = None, output: Output = Output()) -> None:
    """Audit a graph: ambiguity, reachability, layers, degrees, coverage, leakage; or show one entity.

    Args:
        graph: graph folder, recipe book or known book's name.
        entity: show this entity's recipes, uses and cheapest derivation instead.
    """
    from wordcraft_kg.graphs.audit import audit
    from wordcraft_kg.graphs.folder import open_graph

    opened = open_graph(graph)
    if entity is not None:
        from wordcraft_kg.evaluation.graphs import view_entity

        view = view_entity(opened.graph, entity)
        output.result(view, _entity_text(view))
    else:
        found = audit(opened.graph, opened.split)
        output.result(found, _audit_text(opened.graph.name, found))


def _entity_text(view: "EntityView") -> list[str]:
    def lines(title: str, recipes: "Sequence[Recipe]") -> list[str]:
        return [f"{title} ({len(recipes)})", *(f"  {recipe}" for recipe in recipes)]

    place = "base entity" if view.base else "cannot be made from the base"
    if view.layer is not None and not view.base:
        place = f"first made in round {view.layer}"
    text = [f"{view.entity}: {place}", *lines("recipes", view.recipes), *lines("uses", view.uses)]
    if view.derivation and view.derivation.steps:
        from wordcraft_kg.graphs.planner import derivation_tree

        text.append(f"cheapest derivation ({len(view.derivation.steps)})")
        text += [f"  {line}" for line in derivation_tree(view.entity, view.derivation.steps)]
    return text


def _audit_text(name: str, found: "Audit") -> list[str]:
    reach, degrees, ambiguity, labels = found.reachability, found.degrees, found.ambiguity, found.labels
    per = degrees.recipes_per_craftable
    rows = [
        ("graph", f"{name}, hash {found.hash[:12]}"),
        ("entities", f"{found.entities:,}, {degrees.craftable:,} craftable, {degrees.terminal:,} terminal"),
        (
            "recipes",
            f"{found.recipes:,} over {counted(found.pairs, 'pair')}, {degrees.self_pairs:,} with itself",
        ),
        ("per entity", f"{per.mean:.2f} recipes on average, median {per.median:.0f}, at most {per.max}"),
        (
            "ambiguity",
            ", ".join(
                f"{counted(pairs, 'pair')} with {counted(int(n), 'result')}"
                for n, pairs in ambiguity.pairs_by_number_of_results.items()
            ),
        ),
        ("base", names(found.base[:10], len(found.base))),
        ("reachable", f"{reach.reachable:,} of {found.entities:,}, in {counted(reach.rounds, 'round')}"),
        ("layers", " ".join(str(count) for count in reach.known_after_round) + " known after each round"),
        ("most used", ", ".join(f"{label} {count}" for label, count in degrees.most_used[:5])),
        ("most made", ", ".join(f"{label} {count}" for label, count in degrees.most_recipes[:5])),
    ]
    if reach.unreachable:
        rows.append(("unreachable", names(reach.unreachable_entities[:10], reach.unreachable)))
    if labels.alike:
        alike = " / ".join(", ".join(map(repr, group)) for group in labels.alike_labels[:3])
        groups = counted(labels.alike, "group")
        rows.append(("look alike", f"{groups} of labels, different only in case or blanks: {alike}"))
    rows += split_rows(found.split)
    return [*aligned(rows), *_leak_check(found)]


def _leak_check(found: "Audit") -> list[str]:
    if found.split.kind == "none":
        return []
    text = ["", f"{'leak check':<14}{'train':>9}{'test':>9}{'in train':>10}{'evaluated':>11}{'mirrored':>10}"]
    for relation, row in found.leakage.items():
        mirrored = f"{row.mirror_in_train:,}" if relation == "combinesWith" else "-"
        text.append(
            f"{relation:<14}{row.train:>9,}{row.from_test_recipes:>9,}{row.already_in_train:>10,}"
            f"{row.evaluated:>11,}{mirrored:>10}"
        )
    return text
