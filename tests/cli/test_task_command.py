"""``tasks`` as a user runs it."""

import json

import pytest
from graph_folders import write_graph

from wordcraft_kg.envs.wordcraft import WordCraftEnv
from wordcraft_kg.graphs import Recipe, open_graph
from wordcraft_kg.graphs.tasks import replay

# Each depth-2 task of this book has one plan, so the text below can be read off the book.
BREWERY = "# base: barley,water,yeast\ningredient_a,ingredient_b,result\nbarley,water,malt\nmalt,yeast,beer\n"


@pytest.fixture
def shown(run, home):
    """Run ``tasks`` with ``--json``, and return its object."""

    def shown(*arguments):
        outcome = run("tasks", *arguments, "--json")
        assert (outcome.code, outcome.err) == (0, "")
        return json.loads(outcome.out)

    return shown


def test_tasks_are_printed_with_their_table_and_plans(run, home):
    (home / "brewery.csv").write_text(BREWERY, encoding="utf-8")
    outcome = run("tasks", home / "brewery.csv", "--depth", 2, "--distractors", 0, "--part", "all")
    assert (outcome.code, outcome.err) == (0, "")
    heading, shown = outcome.out.split("\n\n")
    assert {"graph     brewery", "tasks     1", "complete  true"} <= set(heading.splitlines())
    goal, start, distractors, table, plan = shown.splitlines()
    assert (goal, start.split(maxsplit=1)[1]) == ("beer", "barley, water, yeast")
    assert sorted(table.replace(",", "").split()[1:]) == ["barley", "water", "yeast"]
    assert distractors.split() == ["distractors", "none"]
    assert plan.endswith("  barley + water -> malt; malt + yeast -> beer")


@pytest.mark.parametrize(("part", "depth"), [("all", 1), ("train", 2), ("test", 2), ("test", 3)])
def test_what_is_shown_are_tasks_as_an_agent_sees_them(shown, kitchen, part, depth):
    values = shown("kitchen", "--depth", depth, "--distractors", 4, "--part", part, "--limit", 30)
    made = WordCraftEnv("kitchen", part=part, depth=depth, num_distractors=4).tasks
    assert {key: values[key] for key in values if key != "shown"} == {
        **{"graph": "kitchen", "depth": depth, "part": part},
        **{"tasks": len(made), "complete": depth < 3, "mixed": made.mixed},
    }
    known = {(task.goal, task.start): task for task in made}
    assert len({(task["goal"], *task["start"]) for task in values["shown"]}) == len(values["shown"]) == 30
    for task in values["shown"]:
        plans = tuple(tuple(Recipe(*row) for row in plan) for plan in task["plans"])
        assert plans == known[task["goal"], tuple(task["start"])].plans
        for plan in plans:
            assert task["goal"] in replay(kitchen, task["start"], plan)
        assert sorted(task["table"]) == sorted(task["start"] + task["distractors"])
        assert len(task["distractors"]) == 4
        assert task["distractors"] == sorted(task["distractors"])
        between = {row.result for plan in plans for row in plan}
        assert not between & set(task["table"])


def test_tables_are_shuffled_and_differ_in_their_distractors(shown):
    values = shown("kitchen", "--depth", 2, "--distractors", 4)
    assert any(task["table"][: len(task["start"])] != task["start"] for task in values["shown"])
    assert len({tuple(task["distractors"]) for task in values["shown"]}) > 15


def test_the_order_is_seeded_and_a_lower_limit_shows_the_first(shown):
    values = shown("kitchen", "--limit", 8)
    assert shown("kitchen", "--limit", 8) == values
    assert shown("kitchen", "--limit", 5)["shown"] == values["shown"][:5]
    assert shown("kitchen", "--limit", 8, "--seed", 1)["shown"] != values["shown"]


def test_a_limit_beyond_the_tasks_shows_each_once(shown):
    values = shown("kitchen", "--part", "all", "--limit", 10_000)
    assert len({(task["goal"], *task["start"]) for task in values["shown"]}) == values["tasks"] == 326


def test_without_options_the_tasks_are_those_of_the_environment_without_settings(shown):
    values, env = shown(), WordCraftEnv("everyday")
    assert (values["graph"], values["tasks"]) == ("everyday", len(env.tasks))
    assert (values["depth"], values["part"]) == (env.config.depth, env.config.part)
    assert {len(task["distractors"]) for task in values["shown"]} == {env.config.num_distractors}
    assert len(values["shown"]) == 20


def test_a_graph_folder_brings_its_own_split(shown, home, kitchen):
    folder = write_graph(home / "graph", kind="by-goal", seed=3)
    held_out = {recipe.result for recipe in kitchen.recipe_labels(open_graph(folder).split.recipes("test"))}
    values = shown(folder, "--part", "test", "--limit", 10_000)
    assert {task["goal"] for task in values["shown"]} == held_out
