"""``wordcraft-kg describe``."""

from typing import Any

from wordcraft_kg.cli.console import Output, aligned, names
from wordcraft_kg.cli.splits import split_rows

EXAMPLES = ("wordcraft-kg describe everyday", "wordcraft-kg describe graphs/everyday --entity bread")


def describe(graph: str, *, entity: str | None = None, output: Output = Output()) -> None:
    """Audit a graph: ambiguity, reachability, layers, degrees, coverage, leakage; or show one entity.

    Args:
        graph: graph folder, recipe book or known book's name.
        entity: show this entity's recipes, uses and cheapest derivation instead.
    """
    from wordcraft_kg.graphs.audit import audit
    from wordcraft_kg.graphs.folder import open_graph

    opened = open_graph(graph)
    if entity is not None:
        values = _entity(opened.graph, entity)
        output.result(values, _entity_text(values))
    else:
        found = audit(opened.graph, opened.split)
        output.result(found, _audit_text(opened.graph.name, found))


def _entity(graph: Any, label: str) -> dict[str, Any]:
    from wordcraft_kg.errors import GraphError
    from wordcraft_kg.graphs.planner import Planner, layers

    entity = graph.id_of(label)
    depth = int(layers(graph)[entity])
    try:
        derivation = Planner(graph).derivation(entity)
    except GraphError:
        derivation = None
    return {
        "entity": label,
        "base": label in graph.base,
        "layer": depth if depth >= 0 else None,
        "recipes": [list(recipe) for recipe in graph.recipe_labels(graph.recipes[graph.recipes_of(entity)])],
        "uses": [list(recipe) for recipe in graph.recipe_labels(graph.recipes[graph.uses_of(entity)])],
        "derivation": derivation and {"cost": derivation.cost, "steps": [list(recipe) for recipe in derivation.steps]},
    }


def _entity_text(values: dict[str, Any]) -> list[str]:
    def lines(title: str, recipes: list[list[str]]) -> list[str]:
        return [f"{title} ({len(recipes)})", *(f"  {a} + {b} -> {result}" for a, b, result in recipes)]

    place = "base entity" if values["base"] else "cannot be made from the base"
    if values["layer"] is not None and not values["base"]:
        place = f"first made in round {values['layer']}"
    text = [f"{values['entity']}: {place}", *lines("recipes", values["recipes"]), *lines("uses", values["uses"])]
    if values["derivation"]:
        text += lines("cheapest derivation", values["derivation"]["steps"])
    return text


def _audit_text(name: str, found: dict[str, Any]) -> list[str]:
    reach, degrees, ambiguity = found["reachability"], found["degrees"], found["ambiguity"]
    per = degrees["recipes_per_craftable"]
    rows = [
        ("graph", f"{name}, hash {found['hash'][:12]}"),
        ("entities", f"{found['entities']:,}, {degrees['craftable']:,} craftable, {degrees['terminal']:,} terminal"),
        (
            "recipes",
            f"{found['recipes']:,} over {found['pairs']:,} pairs, {degrees['self_pairs']:,} of them self",
        ),
        ("per entity", f"{per['mean']:.2f} recipes on average, median {per['median']:.0f}, at most {per['max']}"),
        (
            "ambiguity",
            ", ".join(
                f"{pairs:,} pairs with {n} result{'s' * (n != '1')}"
                for n, pairs in ambiguity["pairs_by_number_of_results"].items()
            ),
        ),
        ("base", names(found["base"][:10], len(found["base"]))),
        ("reachable", f"{reach['reachable']:,} of {found['entities']:,}, in {reach['rounds']} rounds"),
        ("layers", " ".join(str(count) for count in reach["known_after_round"]) + " known after each round"),
        ("most used", ", ".join(f"{label} {count}" for label, count in degrees["most_used"][:5])),
        ("most made", ", ".join(f"{label} {count}" for label, count in degrees["most_recipes"][:5])),
    ]
    if reach["unreachable"]:
        rows.append(("unreachable", names(reach["unreachable_entities"][:10], reach["unreachable"])))
    if found["labels"]["alike"]:
        alike = " / ".join(", ".join(map(repr, labels)) for labels in found["labels"]["alike_labels"][:3])
        rows.append(("look alike", f"{found['labels']['alike']} groups differ in case or blanks only: {alike}"))
    rows += split_rows(found["split"])
    text = aligned(rows)
    if found["split"]["kind"] != "none":
        text += ["", f"{'leak check':<14}{'train':>9}{'test':>9}{'in train':>10}{'evaluated':>11}{'mirrored':>10}"]
        for relation, row in found["leakage"].items():
            mirrored = f"{row['mirror_in_train']:,}" if relation == "combinesWith" else "-"
            text.append(
                f"{relation:<14}{row['train']:>9,}{row['from_test_recipes']:>9,}{row['already_in_train']:>10,}"
                f"{row['evaluated']:>11,}{mirrored:>10}"
            )
    return text
