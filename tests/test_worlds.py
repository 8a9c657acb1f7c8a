"""Worlds that benchmarks cut out of books, and results of play in them; people's pairs."""

import itertools
import json
import runpy
import sys
from importlib import import_module
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from helpers import refuses

from wordcraft_kg import SplitConfig, WordCraftConfig, World, make_split
from wordcraft_kg.base.statistics import student_interval
from wordcraft_kg.graphs import OpenedGraph, RecipeGraph, layers, open_book, open_graph

sys.path.append(str(Path(__file__).parents[1] / "benchmarks"))

worlds_of_books = import_module("cut_worlds")

SIZES = worlds_of_books.SIZES

cut_world = worlds_of_books.cut_world

separate_worlds = worlds_of_books.separate_worlds

shared_part = worlds_of_books.shared_part

script = import_module("discovery_worlds")

GOLDEN = ["cd27d5876a66", "d796fe9a5ee4"]
"""Begin of the hashes of the worlds 0 and 7 of ``everyday``."""


@pytest.fixture(scope="module")
def everyday():
    return open_book("everyday")


@pytest.mark.parametrize("seed", [0, 1, 24])
def test_a_world_has_all_recipes_among_its_entities_and_all_can_be_made(everyday, seed):
    world = cut_world(everyday, seed)
    entities = set(world.entities)
    assert SIZES[0] <= len(entities) <= SIZES[1]
    assert 4 <= len(world.base) <= 6
    inside = {recipe for recipe in everyday.recipes if entities.issuperset(recipe)}
    assert set(world.recipes) == inside
    assert (layers(RecipeGraph.from_book(world)) >= 0).all()
    assert {world.kinds[recipe] for recipe in world.recipes} <= set(everyday.kinds.values())


def test_worlds_differ_by_seed_and_depend_on_nothing_else(everyday):
    worlds = [cut_world(everyday, seed) for seed in (0, 7)]
    assert worlds[0].recipes != worlds[1].recipes
    assert worlds[0].sha256 != worlds[1].sha256
    assert cut_world(everyday, 7) == worlds[1]
    # Known figures refer to these worlds: the draws may never change.
    assert [RecipeGraph.from_book(world).hash[:12] for world in worlds] == GOLDEN


@pytest.mark.slow
def test_every_number_gives_a_world(everyday):
    for seed in range(400):
        assert len(cut_world(everyday, seed).entities) >= SIZES[0]


def test_where_no_drawn_base_reaches_enough_the_book_s_own_does(everyday, monkeypatch):
    monkeypatch.setattr(worlds_of_books, "_DRAWS", 0)
    assert cut_world(everyday, 0).base == everyday.base
    with refuses("sizes"):
        cut_world(open_book("kitchen"), 0)


def test_separate_worlds_share_at_most_a_fifth_of_their_recipes(everyday):
    every = separate_worlds(everyday, candidates=8)
    assert 1 < len(every) < 8
    shared = [
        shared_part(set(one.recipes), set(other.recipes))
        for one, other in itertools.combinations(every, 2)
    ]
    assert max(shared) <= 0.2
    few = separate_worlds(everyday, candidates=8, most=2)
    assert len(few) == 2
    assert {world.name for world in few} <= {world.name for world in every}


def test_an_area_is_a_mean_of_discoveries_and_worlds_are_the_clusters():
    assert script.curve_area(np.array([[4, 5, 5, 7]])).tolist() == [pytest.approx(5 / 3)]
    areas = np.array([[0.2, 0.4, 0.3, 0.5]])
    figures = script.estimate(areas)
    low, high = student_interval(areas[0])
    assert figures == pytest.approx({"mean": 0.35, "low": low, "high": high})
    assert script.estimate(np.ones((2, 3))) == {"mean": 1, "low": None, "high": None}


@pytest.mark.slow
def test_the_scripts_play_worlds_and_write_figures_and_graph_folders(
    tmp_path, monkeypatch, capsys, recipes_folder
):
    def run(module, *arguments):
        monkeypatch.setattr(sys, "argv", [module.__name__, *map(str, arguments)])
        module.main()

    quick = ("--candidates", 3, "--most", 2, "--runs", 1, "--attempts", 60, "--book", "kitchen")
    guided = ("--scorer", f"{recipes_folder},{recipes_folder}")
    run(script, "everyday", *quick, *guided, "--json", tmp_path / "figures.json")
    figures = json.loads((tmp_path / "figures.json").read_text())
    names = ["random-no-repeat", "nearest-words", "book-votes", "greedy", "recipe-learner"]
    assert list(figures["players"]) == names
    assert figures["players"]["greedy"]["area"]["mean"] == 1
    assert list(figures["recipe-learner minus"]) == names[:3]
    assert [len(figures[part]) for part in ("worlds", "overlaps")] == [2, 1]
    assert figures["worlds"][0]["recipes in everyday"] == 1
    printed = capsys.readouterr().out
    assert "pairs of worlds share" in printed
    assert "recipe-learner - book-votes" in printed
    name = figures["worlds"][0]["name"]
    run(worlds_of_books, "everyday", name.split("-")[1], tmp_path / "world")
    assert open_graph(tmp_path / "world").graph.hash == figures["worlds"][0]["hash"]
    with pytest.raises(SystemExit, match="`seed` -1"):
        run(worlds_of_books, "everyday", -1, tmp_path / "small")
    assert not (tmp_path / "small").exists()


SCRIPT = Path(__file__).parents[1] / "benchmarks" / "people_pairs.py"

pairs = SimpleNamespace(**runpy.run_path(str(SCRIPT)))


ABSENCE_PLAYER_SCRIPT = Path(__file__).parent.parent / "benchmarks" / "absence_player.py"


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["by-recipe", "by-goal"])
@pytest.mark.parametrize("seed", [0, 1])
def test_held_out_pairs_are_not_told_by_their_absence(kind, seed):
    """With a guard that kept them off the tables of their goal it made .8 with 8 distractors."""
    absence_player = runpy.run_path(str(ABSENCE_PLAYER_SCRIPT))["absence_player"]
    graph = open_graph("everyday").graph
    opened = OpenedGraph(graph, make_split(graph, SplitConfig(kind, seed=seed)), "everyday")
    for distractors in (8, 1):
        train = World(opened, WordCraftConfig(num_distractors=distractors))
        measured = absence_player(train, train.variant(part="test"), 700_000)
        assert measured["absence"] < measured["random pair"] + 0.03
