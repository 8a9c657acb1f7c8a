import re

from quick import text_of

from wordcraft_kg.agents.discovery import HUMAN_CURVE
from wordcraft_kg.graphs import open_graph

QUICK = ("--runs", 3, "--attempts", 12)


def test_the_table_has_a_row_for_each_player_and_one_for_people():
    text = text_of("discover", "kitchen", *QUICK)
    rows = {line.split("  ")[0]: line for line in text.splitlines()}
    assert rows["entities known after"].split()[-3:] == ["1", "10", "12"]
    for name in ("random-no-repeat", "greedy"):
        assert re.search(r"\d\.\d", rows[name])
    assert "recipe-learner" not in rows
    assert rows["people, another game"].split()[-2:] == ["5", "9.95"]
    assert "720 entities" in text


def test_json_holds_the_same_figures_and_the_setting(printed):
    arguments = ("discover", "kitchen", *QUICK, "--players", "greedy,random-no-repeat", "--seed", 4)
    values = printed(*arguments)
    assert list(values["players"]) == ["greedy", "random-no-repeat"]
    figures = values["players"]["random-no-repeat"]["12"]
    assert figures["low"] <= figures["mean"] <= figures["high"]
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


def test_a_single_run_has_no_interval(printed, run):
    values = printed("discover", "kitchen", "--runs", 1, "--players", "random-no-repeat")
    assert values["players"]["random-no-repeat"]["100"]["low"] is None
    text = run("discover", "kitchen", "--runs", 1, "--players", "random-no-repeat").out
    assert "[" not in text.split("people")[0].split("\n", 2)[2]


def test_a_scorer_of_another_book_explores(printed, recipes_folder, put, refused):
    book = put(
        "ingredient_a,ingredient_b,result\nseed,water,weed\nweed,water,weed "
        "wine\nfire,water,steam\n",
        "other.csv",
    )
    start = ("discover", book, "--base", "seed,water,fire", "--scorer", recipes_folder)
    unseen = printed(*start, *QUICK)
    assert list(unseen["players"])[-1] == "recipe-learner"
    book.write_text(book.read_text() + "Eggs,animal,chicken\n")  # a train recipe of the scorer
    assert "shared_recipes" not in unseen
    assert printed(*start, *QUICK)["shared_recipes"] == 1
    text = text_of(*start, "--runs", 1, "--attempts", 500, "--players", "recipe-learner")
    rows = {line.split("  ")[0]: line.split() for line in text.splitlines()}
    assert rows["entities known after"][-5:] == ["100", "200", "300", "400", "500"]
