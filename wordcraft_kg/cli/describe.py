"""``wordcraft-kg describe``."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from wordcraft_kg.base.wording import counted
from wordcraft_kg.cli.console import Output, aligned, names
from wordcraft_kg.cli.options import Graph

if TYPE_CHECKING:
    from wordcraft_kg.evaluation.graphs import EntityView
    from wordcraft_kg.graphs.audit import Audit, SplitSummary
    from wordcraft_kg.graphs.recipes import Recipe

EXAMPLES = ("wordcraft-kg describe everyday", "wordcraft-kg describe graphs/everyday --entity bread")


def describe(graph: Graph, *, entity: str | None = None, output: Output = Output()) -> None:
    """Audit a graph: ambiguity, reachability, layers, degrees, coverage, leakage; or show one entity.

    Args:
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
    several = (
        f"{counted(pairs, 'pair')} with {counted(int(results), 'result')}"
        for results, pairs in ambiguity.pairs_by_number_of_results.items()
    )
    rows = [
        ("graph", f"{name}, hash {found.hash[:12]}"),
        ("entities", f"{found.entities:,}, {degrees.craftable:,} craftable, {degrees.terminal:,} terminal"),
        ("recipes", f"{found.recipes:,} over {counted(found.pairs, 'pair')}, {degrees.self_pairs:,} with itself"),
        ("per entity", f"{per.mean:.2f} recipes on average, median {per.median:.0f}, at most {per.max}"),
        ("ambiguity", ", ".join(several)),
        ("base", names(found.base, len(found.base))),
        ("reachable", f"{reach.reachable:,} of {found.entities:,}, in {counted(reach.rounds, 'round')}"),
        ("layers", " ".join(map(str, reach.known_after_round)) + " known after each round"),
        ("most used", ", ".join(f"{label} {count}" for label, count in degrees.most_used[:5])),
        ("most made", ", ".join(f"{label} {count}" for label, count in degrees.most_recipes[:5])),
    ]
    if reach.unreachable:
        rows.append(("unreachable", names(reach.unreachable_entities, reach.unreachable)))
    if labels.alike:
        alike = " / ".join(", ".join(map(repr, group)) for group in labels.alike_labels[:3])
        groups = counted(labels.alike, "group")
        rows.append(("look alike", f"{groups} of labels, different only in case or blanks: {alike}"))
    text = aligned(rows + split_rows(found.split))
    if found.split.kind == "none":
        return text
    leaks: list[tuple[str, ...]] = [("leak check", "train", "test", "in train", "evaluated", "mirrored")]
    for relation, row in found.leakage.items():
        counts = (row.train, row.from_test_recipes, row.already_in_train, row.evaluated)
        mirrored = f"{row.mirror_in_train:,}" if relation == "combinesWith" else "-"
        leaks.append((relation, *(f"{count:,}" for count in counts), mirrored))
    return [*text, "", *aligned(leaks, numbers=True)]


def split_rows(split: "SplitSummary") -> list[tuple[str, str]]:
    """Describe a split in a few lines."""
    if split.kind == "none":
        return [("split", "none: every recipe is in train")]
    ratios = (split.train_ratio, split.valid_ratio, 1 - split.train_ratio - split.valid_ratio)
    shares = "/".join(f"{share:.0%}" for share in ratios if share)
    valid = f", {split.valid_recipes:,} validation" if split.valid_recipes else ""
    sizes = f"{split.train_recipes:,} train{valid}, {counted(split.test_recipes, 'test recipe')}"
    goals, test = (max(number, 1) for number in (split.test_goals, split.test_recipes))
    known = f"{split.test_goals_in_train / goals:.0%} of {counted(split.test_goals, 'test goal')} made in train"
    share = f"{split.one_ingredient_away / test:.0%} of the test recipes"
    rows = [
        ("split", f"{split.kind} {shares}, seed {split.seed}: {sizes}"),
        ("unseen", f"{counted(split.unseen_triples, 'triple')}; leaked and left out: {split.leaked_triples:,}"),
        ("near train", f"{known}; {share} share an ingredient and the result with a train recipe"),
    ]
    if split.moved_for_coverage:
        rows.append(("moved", f"{counted(split.moved_for_coverage, 'recipe')} to train, to cover every entity"))
    if split.uncovered:
        who = counted(split.uncovered, "entity is", "entities are")
        listed = names(split.uncovered_entities, split.uncovered, 5)
        rows.append(("uncovered", f"{who} in no train recipe: {listed}"))
    else:
        rows.append(("covered", "every entity is in a train recipe"))
    if split.pairs_on_both_sides:
        who = counted(split.pairs_on_both_sides, "pair has", "pairs have")
        rows.append(("both sides", f"{who} results in more than one part"))
    return rows
