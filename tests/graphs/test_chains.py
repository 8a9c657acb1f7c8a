"""Recipes of other arities: chains of half-products, which no task has as goal."""

import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from wordcraft_kg.base.errors import RecipeFileError
from wordcraft_kg.graphs import (
    Recipe,
    RecipeBook,
    RecipeGraph,
    SplitConfig,
    audit,
    make_split,
    open_graph,
    read_book,
    write_book,
    write_graph_folder,
)
from wordcraft_kg.graphs.audit import view_entity
from wordcraft_kg.graphs.book_check import check_book
from wordcraft_kg.graphs.chains import HALF, chain, is_half_product, unchained
from wordcraft_kg.graphs.export import EXPORTERS, export_graph
from wordcraft_kg.graphs.task_search import make_tasks

LABELS = st.sampled_from(["a", "b", "c", "d", "e", "f g", "h-i"])


@given(
    rows=st.lists(
        st.tuples(st.lists(LABELS, min_size=2, max_size=6, unique=True), st.just("made")),
        max_size=8,
    )
)
def test_chains_are_undone_exactly_in_any_order(rows):
    recipes = sorted({recipe for parts, made in rows for recipe in chain(parts, made)})
    assert set(unchained(reversed(recipes))) == {
        (tuple(sorted(parts)), made) for parts, made in rows
    }
    assert all(chain(parts[::-1], made) == chain(parts, made) for parts, made in rows)


@pytest.fixture
def book_file(tmp_path):
    """A file with recipes of one to four ingredients, counts and several outputs."""
    recipes = [
        {"ingredients": [{"item": "wood", "amount": 1}], "products": ["plank"]},
        {"ingredients": [{"item": "plank"}, {"item": "coal"}], "products": ["torch", "smoke"]},
        {"ingredients": ["plank", "coal", "rope"], "products": ["trap"]},
        {"ingredients": ["rope", "coal", "plank", "torch"], "products": ["lamp"]},
        {"ingredients": ["wood", "wood", "wood"], "products": ["block"]},
        {"ingredients": ["lamp", "torch", "coal"], "products": ["lamp"]},
        *({"ingredients": ["rope", f"x{i}"], "products": [f"y{i % 3}"]} for i in range(12)),
    ]
    path = tmp_path / "book.json"
    path.write_text(json.dumps({"recipes": recipes}))
    return path


@pytest.fixture
def chained(book_file):
    return read_book(book_file, ingredients="chain")


def test_a_chain_is_announced_with_arities_counts_and_outputs(chained):
    reading = chained.reading
    assert reading.arities == {"1": 1, "2": 14, "3": 3, "4": 1}
    assert (reading.several_outputs, reading.counts_dropped) == (1, 2)
    assert "rows by number of ingredients: 1 of 1, 14 of 2, 3 of 3, 1 of 4" in reading.line()
    assert reading.rows == 19
    assert reading.left_out == {"with an ingredient as the result": 1}
    assert Recipe.of("wood", "wood", "plank") in chained.recipes
    assert Recipe.of("wood", "wood", "block") in chained.recipes
    halves = [label for label in chained.entities if is_half_product(label)]
    assert halves == ["coal + plank + rope" + HALF, "coal + plank" + HALF]


@pytest.mark.parametrize("labels", [["a + b", "c", "d"], ["a", "b", f"x{HALF}"]])
def test_labels_that_would_hide_a_half_product_are_refused(tmp_path, labels):
    rows = [{"ingredients": labels, "name": "r"}, {"ingredients": ["a", "b + c", "d"], "name": "r"}]
    path = tmp_path / "book.json"
    path.write_text(json.dumps(rows))
    with pytest.raises(RecipeFileError, match=r"half-product|several things"):
        read_book(path, ingredients="chain")


def test_half_products_are_no_goals_no_starts_and_in_no_figure(chained, tmp_path):
    graph = RecipeGraph.from_book(chained)
    halves = set(np.flatnonzero(graph.is_half_product).tolist())
    assert len(halves) == 2
    for depth in (1, 2, 3):
        tasks = make_tasks(graph, depth)
        assert halves.isdisjoint(tasks.goals.tolist())
        assert halves.isdisjoint(tasks.starts.ravel().tolist())
    goals = {task.goal for task in make_tasks(graph, 2)}
    assert "trap" in goals  # three ingredients take two attempts
    split = make_split(graph, SplitConfig("by-recipe-plain", train_ratio=0.5))
    evaluated = split.held_out("test")
    assert halves.isdisjoint(evaluated[:, [0, 2]].ravel().tolist())
    record = audit(graph, split)
    whole = unchained(graph.recipe_labels())
    assert (record.entities, record.half_products) == (graph.num_entities - 2, 2)
    assert record.recipes == len(whole) == 18
    sizes = record.split
    assert sizes.train_recipes + sizes.valid_recipes + sizes.test_recipes == 18
    assert sum(record.ambiguity.pairs_by_number_of_results.values()) == record.pairs
    assert not any(HALF in label for label, _ in record.degrees.most_used)
    assert view_entity(graph, "coal + plank" + HALF).half_product
    path = tmp_path / "chained.csv"
    write_book(chained, path)
    figures = check_book(path).figures
    assert (figures.entities, figures.recipes) == (record.entities, 18)


def test_figures_list_things_only():
    rows = [*chain(["coal", "plank", "rope"], "lamp"), *chain(["coal", "plank", "wax"], "candle")]
    graph = RecipeGraph.from_book(RecipeBook.of("lights", rows))
    audited = audit(graph, make_split(graph, SplitConfig("none")))
    listed = [label for label, _ in (*audited.degrees.most_used, *audited.degrees.most_recipes)]
    assert len(listed) == 2 * audited.entities
    assert not any(map(is_half_product, listed))


@pytest.mark.parametrize("format", ["csv", "json"])
def test_a_chain_survives_folders_and_exports(chained, tmp_path, format):
    graph = RecipeGraph.from_book(chained)
    split = make_split(graph, SplitConfig("by-recipe-plain", train_ratio=0.5))
    write_graph_folder(tmp_path / "graph", chained, split)
    opened = open_graph(tmp_path / "graph")
    assert opened.graph.reading == chained.reading
    assert opened.graph.num_half_products == 2
    assert format in EXPORTERS
    export_graph(opened, format, tmp_path / f"out.{format}")
    again = RecipeGraph.from_book(read_book(tmp_path / f"out.{format}"))
    assert again == graph
    assert sorted(unchained(again.recipe_labels())) == sorted(unchained(graph.recipe_labels()))
