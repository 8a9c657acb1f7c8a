import re
import xml.etree.ElementTree as ET

from quick import text_of

from wordcraft_kg.agents.discovery import HUMAN_CURVE
from wordcraft_kg.graphs import open_graph

QUICK = ("--runs", 3, "--attempts", 12)


def test_the_table_has_a_row_for_each_player_and_one_for_people():
    text = text_of("discover", "kitchen", *QUICK)
    rows = {line.split("  ")[0]: line for line in text.splitlines()}
    assert rows["entities known after"].split()[-4:] == ["1", "10", "12", "repeated"]
    for name in ("random", "random-no-repeat", "greedy", "empowerment"):
        assert re.search(r"\d\.\d", rows[name])
    assert "recipe-learner" not in rows
    assert rows["people, another game"].split()[-2:] == ["5", "9.95"]
    assert "720 entities" in text


def test_json_holds_the_same_figures_and_the_setting(printed):
    arguments = ("discover", "kitchen", *QUICK, "--players", "greedy,random", "--seed", 4)
    values = printed(*arguments)
    assert list(values["players"]) == ["greedy", "random"]
    figures = values["players"]["random"]["12"]
    assert figures["low"] <= figures["mean"] <= figures["high"]
    assert 0 <= figures["repeated"] <= 1
    assert (values["attempts"], values["runs"], values["seed"], values["marks"]) == (
        12,
        3,
        4,
        [1, 10, 12],
    )
    assert values["hash"] == open_graph("kitchen").graph.hash
    assert values["people"] == {str(attempt): known for attempt, known in HUMAN_CURVE.items()}
    assert values == printed(*arguments)


def test_a_scorer_adds_a_player_and_another_base_is_where_play_begins(printed, recipes_folder):
    base = open_graph("kitchen").graph.base[1:]
    values = printed(
        "discover", "kitchen", *QUICK, "--scorer", recipes_folder, "--base", ",".join(base)
    )
    assert list(values["players"])[-1] == "recipe-learner"
    assert (values["scorer"], values["base"]) == (recipes_folder.name, list(base))
    assert f"note: {recipes_folder.name} was trained on recipes of kitchen" in text_of(
        "discover", "kitchen", *QUICK, "--scorer", recipes_folder
    )


def test_a_link_predictor_guides_no_player(refused, trained):
    says = "expected a model from train-recipes"
    refused("discover", "kitchen", *QUICK, "--scorer", trained / "one", says=says)


def test_the_page_is_one_file_with_all_curves_and_people(tmp_path, recipes_folder):
    page = tmp_path / "deep" / "page.html"
    assert f"wrote {page}" in text_of(
        "discover", "kitchen", "--runs", 2, "--scorer", recipes_folder, "--out", page
    )
    assert list(page.parent.iterdir()) == [page]
    html = page.read_text(encoding="utf-8")
    assert not re.search(r"<link|src=|https?://", html)
    svg = ET.fromstring(re.search(r"<svg.*?</svg>", html, re.DOTALL)[0])
    lines = [path for path in svg.iter("path") if path.get("stroke-width") == "2"]
    # Told apart by dash and colour together.
    assert len({(line.get("stroke"), line.get("stroke-dasharray")) for line in lines}) == 6
    assert any(path.get("fill-opacity") for path in svg.iter("path"))
    labels = {text.text for text in svg.iter("text")}
    assert {"random", "greedy", "recipe-learner", "people (another game)"} <= labels
    assert "Brändle" in html


def test_players_that_never_repeat_a_pair_are_named(run, tmp_path):
    """Players that never repeat a pair are named instead of drawn at zero."""
    page = tmp_path / "page.html"
    assert (
        run(
            "discover",
            "kitchen",
            *QUICK,
            "--players",
            "random,random-no-repeat,greedy",
            "--out",
            page,
        ).code
        == 0
    )
    html = page.read_text(encoding="utf-8")
    known, repeated = (
        ET.fromstring(svg) for svg in re.findall(r"<svg.*?</svg>", html, re.DOTALL)[:2]
    )
    drawn = [
        {text.text for text in svg.iter("text")} & {"random", "random-no-repeat", "greedy"}
        for svg in (known, repeated)
    ]
    assert drawn == [{"random", "random-no-repeat", "greedy"}, {"random"}]
    assert "Never repeated a pair: random-no-repeat, greedy." in html
    assert (
        run("discover", "kitchen", *QUICK, "--players", "greedy", "--out", page, "--force").code
        == 0
    )
    # Greedy knows the graph, so no map shows its discoveries.
    assert page.read_text(encoding="utf-8").count("<svg") == 1


def test_a_scorer_of_another_book_explores_beside_published_runs(
    printed, recipes_folder, tmp_path, refused
):
    """A recipe scorer of another book explores and published figures stand beside long runs."""
    book = tmp_path / "other.csv"
    book.write_text(
        "ingredient_a,ingredient_b,result\nseed,water,weed\nweed,water,weed "
        "wine\nfire,water,steam\n"
    )
    start = ("discover", book, "--base", "seed,water,fire", "--scorer", recipes_folder)
    unseen = printed(*start, *QUICK)
    assert list(unseen["players"])[-1] == "recipe-learner"
    book.write_text(book.read_text() + "Eggs,animal,chicken\n")  # a train recipe of the scorer
    assert ("knows_recipes" in unseen, printed(*start, *QUICK).get("knows_recipes")) == (
        False,
        True,
    )
    text = text_of(*start, "--runs", 1, "--attempts", 500, "--players", "recipe-learner")
    rows = {line.split("  ")[0]: line.split() for line in text.splitlines()}
    assert rows["entities known after"][-6:-1] == ["100", "200", "300", "400", "500"]
    assert rows["o1, published"][-1] == "177"
    assert "stopped before" in text
