"""Suggested recipes: what is proposed, how probable, in which order; and the table to tick."""

import math
from dataclasses import replace

import numpy as np
import pytest

from wordcraft_kg.base.errors import ConfigError, UnknownEntityError
from wordcraft_kg.evaluation.likely_recipes import RecipeFinder
from wordcraft_kg.evaluation.suggestions import (
    MOST_OF_ITEM,
    PAGE,
    Wish,
    can_suggest,
    open_suggesting,
    suggest,
    ticked,
    varied,
)
from wordcraft_kg.graphs import Recipe, layers, read_book


@pytest.fixture(scope="module")
def model(recipes_folder):
    return open_suggesting(recipes_folder)


@pytest.fixture(scope="module")
def graph(model):
    return model.opened.graph


@pytest.fixture(scope="module")
def finder(model, graph):
    return RecipeFinder.of(model.scorer, graph.recipes)


WISHES = [
    Wish(),
    Wish(item="egg"),
    Wish(goal="bread"),
    Wish(pair=("egg", "flour")),
    Wish(table=("water", "fire", "egg")),
]


@pytest.mark.parametrize("wish", WISHES, ids=["book", "item", "goal", "pair", "table"])
def test_suggestions_are_wanted_new_and_never_their_own_ingredient(model, graph, wish):
    found = suggest(model, wish, 30)
    assert found.suggestions
    book = set(graph.recipe_labels())
    recipes = [each.recipe for each in found.suggestions]
    assert not book.intersection(recipes)
    assert len(set(recipes)) == len(recipes)
    assert not any(recipe.is_self_result for recipe in recipes)
    for each in found.suggestions:
        assert wish.goal in (None, each.recipe.result)
        assert wish.item is None or wish.item in each.recipe.ingredients
        assert not wish.pair or each.recipe.ingredients == tuple(sorted(wish.pair))
        assert 0 < each.probability < 1
        assert (each.steps is None) == (not wish.table)


def test_a_probability_is_that_of_the_pair_times_that_of_the_result(finder, model):
    """The loop: each candidate of a pair, its score at the temperature."""
    pairs = finder.pairs_like_known()[:40]
    likely = finder.likely(pairs)
    folds = model.scorer
    temperature = folds.probabilities.temperature
    by_pair = {}
    for row, probability in zip(likely.rows.tolist(), likely.probabilities, strict=True):
        by_pair.setdefault(tuple(row[:2]), {})[row[2]] = probability
    known = set(map(tuple, finder.book.tolist()))
    assert by_pair
    for (a, b), shown in by_pair.items():
        combines = float(folds.probability(a, "combinesWith", b))
        weights = {
            result: math.exp(float(folds.whole.score_recipes(a, b, result)) / temperature)
            for result in shown
        }
        assert not any((a, b, result) in known for result in shown)
        # All candidates but known ones and the pair itself are listed, so the shares sum to one.
        for result, weight in weights.items():
            expected = combines * weight / sum(weights.values())
            assert shown[result] == pytest.approx(expected, rel=1e-3)
    assert list(likely.probabilities) == sorted(likely.probabilities, reverse=True)


def test_a_known_pair_makes_more_as_often_as_known_pairs_do(finder):
    pairs, counts = np.unique(finder.book[:, :2], axis=0, return_counts=True)
    assert finder.again == pytest.approx(np.mean(counts > 1))
    assert finder.likely(pairs[:3]).combines == pytest.approx(finder.again)


def test_pairs_come_from_known_ones_by_a_similar_ingredient(finder):
    """The loop: each neighbour of each ingredient, with the partner it replaces nothing of."""
    totals = {}
    book = {tuple(row) for row in finder.book[:, :2].tolist()}
    first, second, _ = finder.learned
    for a, b in [*zip(first, second, strict=True), *zip(second, first, strict=True)]:
        for place, neighbour in enumerate(finder.lists.used.ids[a]):
            if neighbour >= 0:
                pair = tuple(sorted((int(neighbour), int(b))))
                if pair not in book:
                    alike = float(finder.lists.used.alike[a, place])
                    totals[pair] = totals.get(pair, 0) + alike
    expected = sorted((value for value in totals.values() if value > 0), reverse=True)
    found = [totals[tuple(pair)] for pair in finder.pairs_like_known().tolist()]
    assert found == pytest.approx(expected[: len(found)], rel=1e-5)
    with_item = finder.pairs_with(3)
    assert (with_item == 3).any(axis=1).all()
    assert not book.intersection(map(tuple, with_item.tolist()))


def test_no_item_fills_a_page_but_one_that_the_reader_named():
    rows = [(0, partner, 100 + partner) for partner in range(1, 60)] + [(70, 71, 72)]
    places = varied(rows, 40)
    first_page = places[: MOST_OF_ITEM + 1]
    # The last recipe has room on the first page, whose items are few.
    assert first_page == [0, 1, 2, 59]
    assert sorted(places) == sorted(set(places))
    assert len(places) == 40
    named = varied(rows, PAGE, {0})
    assert named == list(range(PAGE))


def test_listed_entities_lead_to_others_by_known_recipes_in_the_fewest_steps(model, graph):
    table = ("water", "fire", "egg")
    found = suggest(model, Wish(table=table), 500)
    steps = layers(graph, table)
    assert {graph.id_of(each.recipe.result): each.steps for each in found.made} == {
        entity: step for entity, step in enumerate(steps.tolist()) if step > 0
    }
    assert [each.steps for each in found.made] == sorted(each.steps for each in found.made)
    for each in (*found.made, *found.suggestions):
        before = max(steps[graph.id_of(label)] for label in each.recipe.ingredients)
        assert each.steps == before + 1
    assert suggest(model, Wish(table=table), 2).num_made == len(found.made)


@pytest.mark.parametrize(
    ("wish", "fault"),
    [
        (Wish(item="eg"), "Did you mean 'egg'"),
        (Wish(table=("water", "nothing")), "no entity 'nothing'"),
        (Wish(item=""), "no entity ''"),
    ],
)
def test_a_wish_with_an_unknown_entity_is_refused_with_the_nearest_labels(model, wish, fault):
    with pytest.raises(UnknownEntityError, match=fault):
        suggest(model, wish)


def test_a_wish_is_a_single_one_and_its_pair_has_two_ingredients():
    with pytest.raises(ConfigError, match="expected two ingredients"):
        Wish(pair=("egg", "flour", "milk"))
    with pytest.raises(ConfigError, match="goal and item together"):
        Wish(goal="bread", item="egg")


def test_models_without_probabilities_are_refused(model):
    """As those of all recipes, which have no folds."""
    full = replace(model, scorer=model.scorer.whole)
    assert can_suggest(model)
    assert not can_suggest(full)
    with pytest.raises(ConfigError, match="has no probabilities"):
        suggest(full, Wish())


# --- the command, and the table to tick -----------------------------------------------------------


def test_a_table_of_suggestions_is_a_book_and_its_ticks_lengthen_a_copy(
    run, recipes_folder, graph, tmp_path
):
    table, longer = tmp_path / "found.csv", tmp_path / "longer.csv"
    told = run("suggest", recipes_folder, "--with-item", "egg", "--top", 6, "--out", table)
    assert told.code == 0
    recipes = read_book(table).recipes
    assert len(recipes) == 6
    accept = ("suggest", recipes_folder, "--accept", table, "--out", longer)
    assert "has no tick" in run(*accept).err
    lines = table.read_text().splitlines()
    # Spreadsheets write semicolons in some countries, and a mark at the start.
    lines[1] += "x"
    lines[3] += "Yes"
    text = "\n".join(line.replace(",", ";") for line in lines)
    table.write_text("\ufeff" + text, encoding="utf-8")
    assert run(*accept).code == 0
    book = read_book(longer)
    accepted = {Recipe.of(*lines[row].split(",")[:3]) for row in (1, 3)}
    assert set(book.recipes) == accepted | set(graph.recipe_labels())
    assert book.base == tuple(sorted(graph.base))
    assert "exists, and is not replaced" in run(*accept).err
    assert "exists, and is not replaced" in run(*accept[:2], "--out", table).err
    assert "no folder" in run(*accept[:2], "--out", table.parent / "no" / "table.csv").err
    assert "of a model of sets" in run(*accept[:2], "--any-parts").err


HEADER = "ingredient_a,ingredient_b,result,accept\n"


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("ingredient_a,ingredient_b,result,tick\negg,fire,ash,x\n", "expected a column 'accept'"),
        (HEADER + "egg,zork,ash,x\n", "'zork' is no entity"),
        (HEADER + "flour,water,dough,x\n", "already"),
        ("one,two,three\n", "expected a column|no recipe"),
        # Each tick is a recipe of the longer book, or the table is refused.
        (HEADER + "egg,fire,ash,x\negg,fire,fire,x\n", "with an ingredient as the result"),
        (HEADER + "egg,fire,ash,x\negg,,,x\n", "without ingredients or result"),
        (HEADER + "egg,fire,ash,x\nfire,egg,ash,x\n", "that repeat a recipe"),
    ],
)
def test_a_table_that_is_none_of_suggestions_is_refused_and_nothing_is_written(
    run, recipes_folder, tmp_path, text, fault
):
    table, longer = tmp_path / "found.csv", tmp_path / "longer.csv"
    table.write_text(text)
    refused = run("suggest", recipes_folder, "--accept", table, "--out", longer)
    assert refused.code == 1
    if "|" not in fault:
        assert fault in refused.err
    assert not longer.exists()


def test_a_ticked_recipe_of_a_single_ingredient_is_accepted(graph, put):
    """As from a page of a model of sets, none of which has three ingredients."""
    table = put(HEADER + "egg,fire,ash,x\negg,,shell,x\n", "found.csv")
    assert ticked(table, graph) == [Recipe.of("egg", "fire", "ash"), Recipe.of("egg", "shell")]


def test_the_command_tells_steps_and_the_reasons(run, recipes_folder):
    told = run("suggest", recipes_folder, "--from", "water,fire,egg", "--top", 3).out
    assert "known:" in told
    assert "likely, not in the book:" in told
    assert "step 1" in told
    pair = run("suggest", recipes_folder, "egg", "+", "stone", "--top", 1).out
    assert "egg + stone makes something that the book lacks: probability" in pair
    assert "because" in run("suggest", recipes_folder, "--top", 3).out
    assert "expected a pair" in run("suggest", recipes_folder, "egg + stone = egg").err
    assert "no query" in run("suggest", recipes_folder, "--accept", "x.csv").err
    assert "--from has no entity" in run("suggest", recipes_folder, "--from", "").err
