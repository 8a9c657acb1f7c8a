"""Worlds that benchmarks cut out of books, wrong recipes, and results of play in many worlds."""

import json
import runpy
import sys
from hashlib import sha256
from importlib import import_module
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from helpers import refuses

from wordcraft_kg import SplitConfig, WordCraftConfig, World, make_split
from wordcraft_kg.agents.discovery import make_discoverers, play_runs
from wordcraft_kg.base.errors import ArtefactError, LeakError
from wordcraft_kg.evaluation.discovery import ORACLES
from wordcraft_kg.graphs import OpenedGraph, RecipeGraph, layers, open_book, open_graph

sys.path.append(str(Path(__file__).parents[1] / "benchmarks"))

worlds_of_books = import_module("cut_worlds")

SIZES = worlds_of_books.SIZES

WAYS = worlds_of_books.WAYS

cut_world = worlds_of_books.cut_world

with_wrong_recipes = worlds_of_books.with_wrong_recipes

results = import_module("world_results")

PlayedWorld = results.PlayedWorld

script = import_module("discovery_worlds")

ATTEMPTS = 25

SMALL = (20, 40)

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


def play(graph, players=("random-no-repeat", *ORACLES), seed=0, attempts=ATTEMPTS):
    return play_runs(graph, make_discoverers(players, graph), attempts, 3, seed)


@pytest.fixture(scope="module")
def worlds():
    """Four small worlds; of the first player there is a second fit."""
    book = open_book("kitchen")
    played = []
    for seed in range(4):
        graph = RecipeGraph.from_book(cut_world(book, seed, sizes=(20, 40)))
        fits = [play(graph), play(graph, ["random-no-repeat"], seed=1)]
        played.append(PlayedWorld(graph, fits, {"random-no-repeat": seed}))
    return played


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


SCRIPT = Path(__file__).parents[1] / "benchmarks" / "people_pairs.py"

pairs = SimpleNamespace(**runpy.run_path(str(SCRIPT)))


class Fixed:
    """A scorer with given scores by pair and result."""

    def __init__(self, scores, recipes=()):
        self.values, self.recipes = scores, torch.tensor(recipes, dtype=torch.int32).reshape(-1, 3)

    def score_recipes(self, a, b, results):
        return torch.tensor([self.values[int(a), int(b)][int(result)] for result in results])


@pytest.fixture
def graph_of_people_pairs():
    return RecipeGraph.from_recipes(
        [("a", "b", "c"), ("a", "b", "d"), ("b", "c", "d"), ("a", "a", "b")]
    )


@pytest.fixture
def judgements(tmp_path, graph_of_people_pairs):
    questions = [
        (["b", "a"], "7", "d", ["d", "e", "a", "b"]),
        (["a", "b"], "2", "b", ["a", "b", "c", "nowhere"]),
        (["c", "b"], "5", "a", ["a", "b", "c", "nowhere"]),
        (["a", "d"], "5", "c", ["a", "b", "c", "nowhere"]),
        (["a", "nowhere"], "1", "c", ["a", "b", "c", "d"]),
    ]
    names = ("currentcombinationstring", "linkanswers", "elementanswers", "elementoptionsshuffeld")
    person = dict(zip(names, zip(*questions, strict=True), strict=True))
    path = tmp_path / "judgements.json"
    path.write_text(json.dumps({"1": person}))
    return pairs.read_judgements(path, graph_of_people_pairs)


def test_a_scorer_that_knows_a_judged_pair_is_refused(graph_of_people_pairs, judgements):
    """A scorer that knows a judged pair is refused and its recipes are listed."""
    expected = [("a", "b", "c"), ("a", "b", "d"), ("b", "c", "d")]
    assert pairs.judged_recipes(judgements, graph_of_people_pairs) == expected
    leaky = Fixed({}, [[1, 0, 3], [0, 0, 1]])
    with pytest.raises(LeakError, match="1 rated pairs"):
        pairs.answers_of_scorer(judgements, graph_of_people_pairs, "leaky", leaky)
    with pytest.raises(LeakError, match="without recipes"):
        pairs.answers_of_scorer(judgements, graph_of_people_pairs, "zero-shot", Fixed({}))


def test_the_area_is_the_share_of_ordered_cases():
    rng = np.random.default_rng(0)
    right, scores = rng.random(40) < 0.3, rng.integers(5, size=40)
    cases = [(one > two) + 0.5 * (one == two) for one in scores[right] for two in scores[~right]]
    area, low, high = pairs.area_under_curve(right.tolist(), scores.tolist(), range(40))
    assert area == pytest.approx(np.mean(cases))
    # Hanley and McNeil's standard error for cases that are drawn one by one
    a, n, m = area, right.sum(), (~right).sum()
    variance = (
        a * (1 - a) + (n - 1) * (a / (2 - a) - a * a) + (m - 1) * (2 * a * a / (1 + a) - a * a)
    )
    assert (high - low) / 3.92 == pytest.approx(np.sqrt(variance / (n * m)), rel=0.15)
    # Copies of the same cases in a person's cluster are no further evidence.
    copies = pairs.area_under_curve([*right] * 3, [*scores] * 3, [*range(40)] * 3)
    assert copies == pytest.approx((area, low, high))


def test_published_judgements_give_the_figures_of_the_guide(alchemy):
    try:
        path = pairs.judgements_file()
    except ArtefactError:
        pytest.skip("the published judgements are not on this machine")
    judgements = pairs.read_judgements(path, alchemy)
    people = pairs.answers_of_people(judgements, alchemy)
    assert len({each.pair for each in judgements}) == 832
    assert len(judgements) == 1949
    assert len(pairs.with_right_option(judgements, alchemy)) == 178
    assert people.auc == pytest.approx((0.588, 0.564, 0.612), abs=2e-3)
    assert people.right == pytest.approx((0.607, 0.516, 0.700), abs=2e-3)


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
