"""Results of open-ended play: areas, passed bottlenecks, reasons, many worlds, and their pages."""

import importlib.util
import json
import re
import statistics
import sys
import xml.etree.ElementTree as ET
from hashlib import sha256
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace
from refusals import refuses

from wordcraft_kg.agents.discovery import NEVER, make_discoverers, play_runs
from wordcraft_kg.base.records import as_values
from wordcraft_kg.evaluation.discovery import (
    ORACLES,
    curve_area,
    explain_run,
    open_guides,
    oracle_area,
    view_discovery,
)
from wordcraft_kg.evaluation.discovery_worlds import PlayedWorld, view_worlds
from wordcraft_kg.graphs import RecipeGraph, open_book, open_graph
from wordcraft_kg.graphs.worlds import cut_world
from wordcraft_kg.reports.discovery_report import discovery_page, worlds_page

ATTEMPTS = 25
HOSTILE = "<img src=x onerror=alert(1)>"


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


def test_areas_are_mean_discoveries_relative_to_the_better_oracle(worlds):
    view = view_worlds(worlds, ORACLES)

    def area(curve):
        return statistics.mean(known - curve[0] for known in curve[1:])

    ratios = []
    for world, result in zip(worlds, view.worlds, strict=True):
        first = world.fits[0]
        oracles = {
            name: statistics.mean(area(run.tolist()) for run in first.known[number])
            for number, name in enumerate(first.players)
            if name in ORACLES
        }
        best = max(oracles.values())
        assert oracles[result.oracle] == best
        of_runs = [area(run.tolist()) / best for fit in world.fits for run in fit.known[0]]
        assert result.areas["random-no-repeat"] == pytest.approx(statistics.mean(of_runs))
        ratios += of_runs
    player = view.players["random-no-repeat"]
    assert player.area.mean == pytest.approx(statistics.mean(ratios))
    assert player.area.low < player.area.mean < player.area.high
    assert player.fits == 2
    assert view.players["greedy"].fits == 1
    assert max(each.area.mean for each in view.players.values()) <= 1
    known = [run[ATTEMPTS] for world in worlds for fit in world.fits for run in fit.known[0]]
    assert player.known[str(ATTEMPTS)].mean == pytest.approx(np.mean(known))
    assert player.curve["0"].mean == np.mean([len(world.graph.base) for world in worlds])


def test_the_share_of_runs_that_pass_main_bottlenecks_and_when(worlds):
    view = view_worlds(worlds, ORACLES)
    passed = []
    for world, result in zip(worlds, view.worlds, strict=True):
        main = result.statistics.main
        assert main == result.statistics.bottlenecks[0]
        entity = world.graph.id_of(main.entity)
        attempts = [run[entity] for fit in world.fits for run in fit.learnt[0].tolist()]
        learnt = [attempt for attempt in attempts if attempt != NEVER]
        assert result.passed["random-no-repeat"] == len(learnt) / len(attempts)
        if learnt:
            assert result.passed_at["random-no-repeat"] == statistics.median(learnt)
        passed += [attempt != NEVER for attempt in attempts]
    assert view.players["random-no-repeat"].passed.mean == pytest.approx(np.mean(passed))
    assert [result.shared for result in view.worlds][:2] == [{}, {"random-no-repeat": 1}]


def test_differences_are_paired_and_leave_oracles_out(worlds):
    more = []
    for world in worlds:
        random, *others = world.fits
        again = play(world.graph, ["random"])
        stacked = [
            np.concatenate([getattr(random, name), getattr(again, name)])
            for name in ("known", "repeated", "learnt")
        ]
        both = type(random)((*random.players, "random"), *stacked)
        more.append(PlayedWorld(world.graph, [both, *others], {}))
    view = view_worlds(more, ORACLES)
    assert view.best in ("random", "random-no-repeat")
    ((other, difference),) = view.differences.items()
    gap = view.players[view.best].area.mean - view.players[other].area.mean
    assert difference.mean == pytest.approx(gap) != 0
    assert difference.low < difference.mean < difference.high


def test_worlds_with_other_players_or_without_an_oracle_are_refused(worlds):
    with refuses("worlds"):
        view_worlds([], ORACLES)
    graph = worlds[0].graph
    with refuses("worlds"):
        view_worlds([worlds[0], PlayedWorld(graph, [play(graph)], {})], ORACLES)
    with refuses("players"):
        view_worlds([PlayedWorld(graph, [play(graph, ["random"])], {})], ORACLES)
    with refuses("players"):
        oracle_area(play(graph, ["random"]))


def test_more_attempts_than_pairs_are_marked_and_all_is_known():
    graph = RecipeGraph.from_recipes([("a", "b", "c"), ("a", "c", "d")], ["a", "b"])
    plays = play(graph, attempts=40)
    assert plays.known[:, :, -1].tolist() == [[4] * 3] * 3
    view = view_worlds([PlayedWorld(graph, [plays], {})], ORACLES)
    assert view.worlds[0].more_attempts_than_pairs
    assert view.players["greedy"].area.mean == pytest.approx(1)
    assert view.players["greedy"].area.low is None
    single, _ = view_discovery(graph, ["greedy"], attempts=40, runs=1)
    assert single.statistics.pairs == 10


def test_curves_have_the_area_of_their_gains():
    known = np.array([[4, 4, 5, 7], [4, 4, 4, 4]])
    np.testing.assert_allclose(curve_area(known), [(0 + 1 + 3) / 3, 0])


class Tags(HTMLParser):
    def __init__(self, page):
        super().__init__()
        self.found = []
        self.feed(page)

    def handle_starttag(self, tag, attrs):
        self.found += [tag, *(name for name, _ in attrs)]


@pytest.fixture(scope="module")
def hostile():
    names = [HOSTILE, "\"><script>alert('x')</script>", "{{ 7 * 7 }}", "a & b", "</svg>", "é"]
    rows = [(names[0], names[1], names[2]), (names[0], names[2], names[3])]
    rows += [(names[1], names[3], names[4]), (names[4], names[4], names[5])]
    graph = RecipeGraph.from_recipes(rows, names[:2])
    graph.name = "<script>book</script>"
    return graph


def test_no_label_of_a_book_becomes_markup(hostile):
    view, plays = view_discovery(hostile, ["random", "greedy"], attempts=9, runs=2)
    page = discovery_page(view, plays, hostile)
    many = view_worlds([PlayedWorld(hostile, [play(hostile)], {})] * 2, ORACLES)
    for html in (page, worlds_page(many, [PlayedWorld(hostile, [play(hostile)], {})] * 2)):
        found = Tags(html).found
        assert "img" not in found
        assert "onerror" not in found
        # The page's own script alone, whose hash the page names.
        assert found.count("script") == 1
        assert "{{ 7 * 7 }}" in html
        for svg in re.findall(r"<svg.*?</svg>", html, re.DOTALL):
            ET.fromstring(svg)
    assert "&lt;img" in page


def test_the_page_maps_discoveries_of_the_best_player_without_an_oracle(kitchen):
    view, plays = view_discovery(kitchen, ["random", "greedy"], attempts=60, runs=2)
    page = discovery_page(view, plays, kitchen)
    picture = next(svg for svg in re.findall(r"<svg.*?</svg>", page, re.DOTALL) if "round 0" in svg)
    cells = {
        rect.find("title").text.split(":")[0]: rect for rect in ET.fromstring(picture).iter("rect")
    }
    assert set(cells) == set(kitchen.entities)
    for label, rect in cells.items():
        attempts = plays.learnt[0, :, kitchen.id_of(label)]
        is_found = (attempts != NEVER).any()
        assert (rect.get("class") == "grid") != is_found
        if label in kitchen.base:
            assert "known at the start" in rect.find("title").text
    main = view.statistics.main
    assert main.entity in page
    assert f"<td>{main.needed_by}</td>" in page


@pytest.mark.slow
def test_reasons_repeat_the_first_run_with_evidence_of_the_scorers_book(recipes_folder, kitchen):
    guides = open_guides(recipes_folder, kitchen)
    view, plays = view_discovery(kitchen, ["recipe-learner"], attempts=20, runs=2, scorer=guides)
    tried = explain_run(kitchen, guides, 20)
    gained = 0
    for one in tried:
        gained += len(one.made)
        assert plays.known[0, 0, one.attempt] == len(kitchen.base) + gained
        results = {kitchen.entities[c] for c in kitchen.results(one.ingredient_a, one.ingredient_b)}
        assert set(one.made) <= results
    train = {tuple(kitchen.labels(row)) for row in guides.recipes.scorer.recipes.tolist()}
    evidence = [each for one in tried for each in one.evidence]
    assert evidence
    assert {(each.ingredient_a, each.ingredient_b, each.result) for each in evidence} <= train
    page = discovery_page(replace(view, tried=tried), plays, kitchen)
    assert "Tried, and why" in page
    assert f"{evidence[0].ingredient_a} + {evidence[0].ingredient_b} →" in page
    # The scorer belongs to this book: its recipes are named and counted.
    assert view.knows_recipes
    assert view.shared_recipes == guides.shared > 0
    assert view.contradicted == 0
    with refuses("scorer"):
        explain_run(kitchen, guides._replace(recipes=None), 20)


def test_a_scorer_of_other_results_is_counted(recipes_folder, kitchen):
    from wordcraft_kg.graphs.worlds import with_wrong_recipes

    book = open_book("kitchen")
    wrong = RecipeGraph.from_book(with_wrong_recipes(book, 50))
    guides = open_guides(recipes_folder, wrong)
    trained = {tuple(kitchen.labels(row)) for row in guides.recipes.scorer.recipes.tolist()}
    recipes = {tuple(wrong.labels(row)) for row in wrong.recipes.tolist()}
    assert guides.shared == len(trained & recipes)
    pairs = {recipe[:2] for recipe in trained} & {recipe[:2] for recipe in recipes}
    assert guides.contradicted == len(pairs - {recipe[:2] for recipe in trained & recipes}) > 0


def test_a_world_of_one_entity_or_of_thousands_of_results_of_a_pair():
    one = RecipeGraph(["water"], np.empty((0, 3), dtype=np.int64), [0], "one")
    with refuses("base"):
        view_discovery(one, ["random"])
    rows = [("a", "b", f"thing {number}") for number in range(5_000)]
    many = RecipeGraph.from_recipes(rows, ["a", "b"])
    view, plays = view_discovery(many, ["random-no-repeat", *ORACLES], attempts=4, runs=1)
    assert view.players["greedy"]["1"].mean == 5_002
    # Too many entities for bottlenecks and for a map.
    assert view.statistics.bottlenecks == ()
    assert "Found when" not in discovery_page(view, plays, many)
    assert as_values(view)["statistics"]["width"] == [2, 5_000]


@pytest.fixture
def script(monkeypatch):
    """The benchmark as a module, and a function that runs it with arguments."""
    path = Path(__file__).parents[2] / "benchmarks" / "discovery_worlds.py"
    spec = importlib.util.spec_from_file_location("discovery_worlds_script", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)

    def run(*arguments):
        monkeypatch.setattr(sys, "argv", ["discovery_worlds.py", *map(str, arguments)])
        module.main()

    module.run = run
    return module


def test_the_script_plays_worlds_and_writes_figures_and_a_page(script, tmp_path, capsys):
    out = (tmp_path / "figures.json", tmp_path / "page.html")
    quick = ("--worlds", 8, "--runs", 1, "--attempts", 12, "--book", "kitchen")
    script.run("everyday", *quick, "--json", out[0], "--page", out[1])
    figures = json.loads(out[0].read_text())
    assert [world["name"] for world in figures["worlds"]] == ["world-8-everyday"]
    assert list(figures["players"]) == [*script.SCRIPTED, "book-votes"]
    assert figures["worlds"][0]["hash"] == open_graph("world-8:everyday").graph.hash
    assert "book-votes" in capsys.readouterr().out
    page = out[1].read_text()
    assert page.count("<svg") == 4
    assert "world-8-everyday" in page


def test_worlds_for_measuring_follow_from_the_committed_secret(script, tmp_path, monkeypatch):
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
