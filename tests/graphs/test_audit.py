from collections import Counter
from dataclasses import replace

import graph_oracles as oracles
import pytest
from graph_strategies import configs, splittable_graphs
from hypothesis import given
from test_splits import HELD_OUT_KINDS, drawn

from wordcraft_kg.base.records import as_values
from wordcraft_kg.graphs import RecipeBook, RecipeGraph, SplitConfig, audit, make_split
from wordcraft_kg.graphs.audit import SHOWN, one_ingredient_away


def audited(graph):
    return as_values(audit(graph, make_split(graph, SplitConfig("none"))))


def test_the_audit_counts_and_names_everything():
    rows = [
        *[("a", "a", "b"), ("a", "b", "c"), ("a", "b", "d"), ("b", "b", "D"), ("c", "d", "e")],
        *[("lost", "c", "found"), ("found", "a", "lost")],
    ]
    book = RecipeBook.of("book", rows, base=["a"], listed=["idle"], keep_self_results=True)
    values = audited(RecipeGraph.from_book(book))
    assert (values["entities"], values["recipes"], values["pairs"], values["base"]) == (
        9,
        7,
        6,
        ["a"],
    )
    assert values["triples"] == {"combinesWith": 10, "componentOf": 12, "total": 22}
    assert values["ambiguity"] == {
        "pairs_by_number_of_results": {"1": 5, "2": 1},
        "pairs_with_several_results": 1,
        "examples": [{"pair": ["a", "b"], "results": ["c", "d"]}],
    }
    assert values["reachability"] == {
        **{"reachable": 6, "rounds": 3, "known_after_round": [1, 2, 5, 6]},
        **{"unreachable": 3, "unreachable_entities": ["found", "idle", "lost"]},
    }
    degrees = values["degrees"]
    assert (degrees["craftable"], degrees["terminal"], degrees["idle"], degrees["self_pairs"]) == (
        7,
        2,
        1,
        2,
    )
    assert degrees["recipes_per_craftable"] == {"mean": 1.0, "median": 1.0, "max": 1}
    assert degrees["most_used"][:2] == [["a", 4], ["b", 3]]
    assert values["labels"] == {"alike": 1, "alike_labels": [["D", "d"]]}


def test_lists_of_the_audit_are_cut_but_counts_are_complete():
    rows = [("a", "b", f"made {i}") for i in range(50)] + [
        ("lost", f"lost {i}", "end") for i in range(50)
    ]
    reachability = audited(RecipeGraph.from_recipes(rows, base=["a", "b"]))["reachability"]
    assert (reachability["unreachable"], len(reachability["unreachable_entities"])) == (52, SHOWN)
    empty = audited(RecipeGraph(["a"], [], []))
    counts = (
        empty["recipes"],
        empty["pairs"],
        empty["triples"]["total"],
        empty["reachability"]["rounds"],
    )
    assert counts == (0, 0, 0, 0)


@pytest.mark.parametrize("kind", HELD_OUT_KINDS)
@given(graph=splittable_graphs(), config=configs("by-recipe"))
def test_nearness_to_train_equals_counts_over_labels(kind, graph, config):
    split = drawn(graph, replace(config, kind=kind))
    train, test = (graph.recipe_labels(split.recipes(part)) for part in ("train", "test"))
    made = {result for *_, result in train}
    sizes = as_values(audit(graph, split))["split"]
    assert sizes["test_goals"] == len({result for *_, result in test})
    assert sizes["test_goals_in_train"] == len({result for *_, result in test} & made)
    near = [
        any(r.result == known.result and {*r[:2]} & {*known[:2]} for known in train) for r in test
    ]
    assert sizes["one_ingredient_away"] == sum(near)
    assert one_ingredient_away(split).tolist() == near
    if kind in ("by-slot", "by-goal"):
        assert not any(near)


@pytest.mark.parametrize("kind", HELD_OUT_KINDS)
@given(graph=splittable_graphs(), config=configs("by-recipe"))
def test_leakage_counts_equal_sets_of_triples(kind, graph, config):
    split = drawn(graph, replace(config, kind=kind))
    of = {
        part: oracles.triples(graph.recipe_labels(split.recipes(part)))
        for part in ("train", "valid", "test")
    }
    evaluated = of["test"] - of["train"] - of["valid"]
    result = as_values(audit(graph, split))
    assert result["split"]["evaluated_triples"] == len(evaluated)
    assert result["split"]["leaked_triples"] == len(of["test"]) - len(evaluated)
    for relation, row in result["leakage"].items():
        train, test, left = (
            Counter(r for _, r, _ in part)[relation]
            for part in (of["train"], of["test"], evaluated)
        )
        mirrored = sum(r == relation and (t, r, h) in of["train"] for h, r, t in evaluated)
        counts = {
            "train": train,
            "from_test_recipes": test,
            "already_in_train": test - left,
            "evaluated": left,
        }
        assert row == counts | {"mirror_in_train": mirrored}
    assert result["leakage"]["combinesWith"]["mirror_in_train"] == 0
