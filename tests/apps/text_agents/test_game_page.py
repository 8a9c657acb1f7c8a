"""A book's game as a page: the whole book, hostile labels as text, nothing run but the page's own
script."""

import base64
import hashlib
import json
import re

import pytest
from starlette.testclient import TestClient

from wordcraft_kg import RecipeGraph, open_graph
from wordcraft_kg.apps.text_agents import browser_game as game
from wordcraft_kg.apps.text_agents.browser_game import export_game, icons_of, make_game_app
from wordcraft_kg.base.errors import ConfigError

SETS = "examples/kitchen-sets.csv"


def book_on(page):
    """The book that a page holds."""
    held = re.findall(r'<script type="application/json" id="book">(.*?)</script>', page, re.DOTALL)
    (text,) = held
    return json.loads(text)


@pytest.mark.parametrize("source", ["kitchen", SETS])
def test_a_page_holds_the_whole_book(source, tmp_path):
    graph = open_graph(source).graph
    export_game(graph, tmp_path / "game.html")
    book = book_on((tmp_path / "game.html").read_text(encoding="utf-8"))
    labels = book["labels"]
    recipes = {tuple(labels[entity] for entity in row) for row in book["recipes"]}
    assert recipes == {(*recipe.ingredients, recipe.result) for recipe in graph.recipe_labels()}
    assert {labels[entity] for entity in book["base"]} == set(graph.base)
    assert book["key"] == graph.hash


def test_labels_are_text_on_the_page_whatever_they_say(tmp_path):
    hostile = '</script><script>alert(1)</script><img src=x onerror="alert(2)">'
    graph = RecipeGraph.from_recipes([("a", hostile, "b<!--")], name=hostile)
    export_game(graph, tmp_path / "game.html", {0: hostile})
    page = (tmp_path / "game.html").read_text(encoding="utf-8")
    assert hostile in book_on(page)["labels"]
    assert book_on(page)["icons"] == {"0": hostile}
    assert page.count("<script") == 2
    assert "<img" not in page


def test_only_the_own_style_and_script_of_an_exported_page_are_permitted(tmp_path):
    export_game(open_graph("kitchen").graph, tmp_path / "game.html")
    page = (tmp_path / "game.html").read_text(encoding="utf-8")
    (policy,) = re.findall(r'Content-Security-Policy" content="(.*?)"', page)
    assert "default-src &#39;none&#39;" in policy
    for tag in ("style", "script"):
        (text,) = re.findall(rf"<{tag}>(.*?)</{tag}>", page, re.DOTALL)
        digest = base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()
        assert re.search(rf"{tag}-src &#39;sha256-([^&]*)&#39;", policy)[1] == digest


def test_a_book_too_large_for_a_file_is_refused_and_nothing_is_written(tmp_path, monkeypatch):
    monkeypatch.setattr(game, "MOST_EXPORTED", 325)
    with pytest.raises(
        ConfigError, match=r"found 326 recipes; a page holds at most 325.*--browser"
    ):
        export_game(open_graph("kitchen").graph, tmp_path / "game.html")
    assert not any(tmp_path.iterdir())


def test_the_server_gives_out_the_page_and_its_files_alone():
    client = TestClient(
        make_game_app(open_graph("kitchen").graph, "127.0.0.1"), base_url="http://localhost:8767"
    )
    page = client.get("/")
    assert page.status_code == 200
    assert len(book_on(page.text)["recipes"]) == 326
    for name in ("game.css", "game.js"):
        assert f'"/files/{name}"' in page.text
        assert client.get(f"/files/{name}").status_code == 200
    for address in ("/files/study.js", "/files/..%2fgame.py", "/elsewhere"):
        assert client.get(address).status_code == 404


def test_the_command_writes_the_file_and_names_it(run, tmp_path):
    path = tmp_path / "game.html"
    outcome = run("play", "kitchen", "--export", path, "--json")
    assert (outcome.code, json.loads(outcome.out)) == (0, {"game": str(path)})
    assert path.is_file()


def test_icons_come_from_a_column_named_emoji(run, put, tmp_path):
    path = put(
        "# base: water, earth, fire\nfirst,second,result,emoji\nwater,earth, mud ,🟤\nmud,fire,brick,\n"
    )
    graph = open_graph(path).graph
    assert icons_of(str(path), graph) == {graph.id_of("mud"): "🟤"}
    assert icons_of("kitchen", graph) == {}
    assert run("play", path, "--export", tmp_path / "game.html").code == 0
    page = (tmp_path / "game.html").read_text(encoding="utf-8")
    assert book_on(page)["icons"] == {str(graph.id_of("mud")): "🟤"}


def test_a_book_in_which_everything_has_a_recipe_is_refused(tmp_path):
    graph = RecipeGraph.from_recipes([("a", "b", "c"), ("c", "c", "a"), ("c", "a", "b")])
    with pytest.raises(ConfigError, match="has no base: found a recipe for each entity"):
        export_game(graph, tmp_path / "game.html")


def test_a_file_that_exists_is_replaced_only_by_force(run, put):
    """The file may be the book itself."""
    book = put("a,b,result\nwater,earth,mud\nmud,fire,brick\n")
    before = book.read_bytes()
    refused = run("play", book, "--export", book)
    assert (refused.code, refused.kind, book.read_bytes()) == (1, "OutputExistsError", before)
    page = put("mine", "game.html")
    assert run("play", book, "--export", page).code == 1
    assert page.read_text() == "mine"
    assert run("play", book, "--export", page, "--force").code == 0
    assert book_on(page.read_text("utf-8"))["labels"]
