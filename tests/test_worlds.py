"""Worlds that benchmarks cut out of books, wrong recipes, and results of play in many worlds."""

import json
import sys
from hashlib import sha256
from importlib import import_module
from pathlib import Path

import pytest
from helpers import refuses

from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.base.statistics import student_interval
from wordcraft_kg.graphs import RecipeGraph, layers, open_book, open_graph

sys.path.append(str(Path(__file__).parents[1] / "benchmarks"))

worlds_of_books = import_module("cut_worlds")

SIZES = worlds_of_books.SIZES

WAYS = worlds_of_books.WAYS

cut_world = worlds_of_books.cut_world

with_wrong_recipes = worlds_of_books.with_wrong_recipes


script = import_module("discovery_worlds")

split_interval = import_module("split_intervals").split_interval


GOLDEN = ["9515e6c95ace", "cfb5e820a644"]
"""Begin of the hashes of the worlds 0 and 7 of ``everyday``."""


@pytest.fixture(scope="module")
def everyday():
    return open_book("everyday")


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize(
    "seed", [0, pytest.param(1, marks=pytest.mark.slow), pytest.param(2, marks=pytest.mark.slow)]
)
def test_a_world_has_all_recipes_among_its_entities_and_all_can_be_made(everyday, way, seed):
    world = cut_world(everyday, seed, way)
    entities = set(world.entities)
    assert SIZES[0] <= len(entities) <= SIZES[1]
    assert 4 <= len(world.base) <= 6
    inside = {recipe for recipe in everyday.recipes if entities.issuperset(recipe)}
    assert set(world.recipes) == inside
    assert (layers(RecipeGraph.from_book(world)) >= 0).all()
    assert {world.kinds[recipe] for recipe in world.recipes} <= set(everyday.kinds.values())
    if way != "base":
        assert world.base == everyday.base


def test_worlds_differ_by_seed_and_way_and_depend_on_nothing_else(everyday):
    worlds = {(seed, way): cut_world(everyday, seed, way) for seed in range(2) for way in WAYS}
    assert len({world.recipes for world in worlds.values()}) == len(worlds)
    assert len({world.sha256 for world in worlds.values()}) == len(worlds)
    for (seed, way), world in worlds.items():
        assert cut_world(everyday, seed, way) == world
    # The ways take turns with the seed.
    assert cut_world(everyday, 1).recipes == worlds[1, "topic"].recipes
    graphs_of_two = [RecipeGraph.from_book(cut_world(everyday, seed)).hash[:12] for seed in (0, 7)]
    # Known figures refer to these worlds: the draws may never change.
    assert graphs_of_two == GOLDEN


@pytest.mark.parametrize("percent", [1, 30, 100])
def test_wrong_recipes_exchange_results_and_keep_none_of_a_pair(percent):
    book = open_book("kitchen")
    wrong = with_wrong_recipes(book, percent)
    new = set(wrong.recipes) - set(book.recipes)
    assert len(wrong.recipes) == len(book.recipes)
    assert len(new) == pytest.approx(
        percent / 100 * len(book.recipes), abs=0.02 * len(book.recipes)
    )
    assert not any(recipe.is_self_result for recipe in new)
    assert wrong.entities == book.entities
    assert wrong.base == book.base
    # Each pair has as many recipes as before, and each entity is made as often.
    for column in (lambda recipe: recipe[:2], lambda recipe: recipe[2]):
        assert sorted(map(column, wrong.recipes)) == sorted(map(column, book.recipes))
    assert with_wrong_recipes(book, percent) == wrong != with_wrong_recipes(book, percent, 1)


def test_the_scripts_play_worlds_and_write_figures_and_graph_folders(tmp_path, monkeypatch, capsys):
    def run(module, *arguments):
        monkeypatch.setattr(sys, "argv", [module.__name__, *map(str, arguments)])
        module.main()

    quick = ("--worlds", 8, "--runs", 1, "--attempts", 12, "--book", "kitchen")
    run(script, "everyday", *quick, "--json", tmp_path / "figures.json")
    figures = json.loads((tmp_path / "figures.json").read_text())
    assert [world["name"] for world in figures["worlds"]] == ["world-8-everyday"]
    assert list(figures["players"]) == [*script.SCRIPTED, "book-votes"]
    assert "book-votes" in capsys.readouterr().out
    run(worlds_of_books, "everyday", 8, tmp_path / "world")
    assert open_graph(tmp_path / "world").graph.hash == figures["worlds"][0]["hash"]
    with pytest.raises(SystemExit, match="at least 200 entities in kitchen"):
        run(worlds_of_books, "kitchen", 8, tmp_path / "small")
    assert not (tmp_path / "small").exists()


def test_worlds_for_measuring_follow_from_the_committed_secret(tmp_path, monkeypatch):
    secret = tmp_path / "secret.txt"
    secret.write_text("a guess\n")
    with refuses("secret"):
        script.seeds(secret, range(3))
    monkeypatch.setattr(script, "SECRET_SHA256", sha256(b"a guess").hexdigest())
    drawn = script.seeds(secret, range(1, 7))
    assert drawn == script.seeds(secret, range(7))[1:]
    assert len(set(drawn)) == 6
    assert [seed % 3 for seed in drawn] == [1, 2, 0, 1, 2, 0]
    assert script.seeds(None, range(2, 4)) == [2, 3]


def test_the_mean_over_splits_is_never_surer_than_the_tasks_of_one_split():
    noise = 0.02
    low, high = split_interval([0.2200, 0.2205, 0.2195], [noise] * 3)
    assert (low, high) == pytest.approx((0.22 - 1.959964 * noise, 0.22 + 1.959964 * noise))
    student = student_interval([0.2200, 0.2205, 0.2195])
    assert student[1] - student[0] < 0.1 * (high - low)
    wide = [0.18, 0.22, 0.20]
    between = 4.302653**2 * (0.02**2 - 0.019**2) / 3 + 1.959964**2 * 0.019**2
    low, high = split_interval(wide, [0.019] * 3)
    student = 4.302653 * 0.02 / 3**0.5
    assert (0.2 - low, high - 0.2) == pytest.approx([max(between**0.5, student)] * 2)
    near = [0.195, 0.205, 0.20]
    between = 4.302653**2 * (0.005**2 - 0.004**2) / 3 + 1.959964**2 * 0.004**2
    assert between**0.5 < 4.302653 * 0.005 / 3**0.5, "Student's t is the wider one"
    assert split_interval(near, [0.004] * 3) == pytest.approx(student_interval(near))
    assert split_interval([0.4], [0.1]) == pytest.approx((0.4 - 0.1959964, 0.4 + 0.1959964))
    assert split_interval([-0.9, -0.9], [0.1, 0.1], within=(-1, 1))[0] == -1
    with pytest.raises(ConfigError, match="2 errors of 3 scores"):
        split_interval([0.1, 0.2, 0.3], [0.1, 0.1])
