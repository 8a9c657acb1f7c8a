"""Reading opinions from answers, as language models write them."""

import time

import pytest

from wordcraft_kg.apps.elicitation.answers import Answer
from wordcraft_kg.apps.elicitation.config import AskingConfig, OpinionsConfig
from wordcraft_kg.apps.elicitation.prompts import make_prompts
from wordcraft_kg.apps.elicitation.reading import read_opinions

ENTITIES = ("Sun", "berry", "brick", "c++", "earth", "fire", "glass", "ice cream", "mud", "mud pie", "stone", "water")


def read(text: str, entities: tuple[str, ...] = ENTITIES) -> tuple[list[tuple[str, float]], list[str]]:
    config = OpinionsConfig("kitchen", "http://localhost/v1", "oracle", AskingConfig(goals_per_prompt=100))
    prompts = make_prompts(config, entities)
    opinions, unread = read_opinions(prompts, [Answer(text=text)], entities)
    shown = []
    for one in opinions:
        a, b, goal = (entities[entity] for entity in one.recipe)
        shown.append((f"{a} + {b} = {goal}", one.weight))
    return shown, [one.why for one in unread]


@pytest.mark.parametrize(
    "line",
    [
        "mud: water + earth",
        "Mud: Earth + Water",
        "- mud: water + earth",
        "1. mud: water + earth.",
        "* **mud**: `water` + `earth`",
        "mud = water + earth",
        "water + earth = mud",
        "water + earth -> mud",
        "mud <- the water + an earth",
        "mud : waters & earths",
        'mud: "water" + "earth"',
        "mud:\n  - water + earth",
        "**Mud**\n1) earth + water",
        "<think>mud: fire + fire\nperhaps not</think>\nmud: water + earth",
        "perhaps\nmud: fire + fire\nor not</think>\nmud: water + earth",
        "```\nmud: water + earth\n```",
    ],
)
def test_one_opinion_is_read_however_it_is_written(line):
    assert read(line) == ([("earth + water = mud", 1.0)], [])


def test_places_count_among_the_pairs_of_a_goal_that_can_be_read():
    lines = ("mud: water + earth", "mud: water + gold", "mud: stone + water", "glass: fire + stone")
    text = "\n".join([*lines, "mud: fire + water, ice cream + earth"])
    assert read(text) == (
        [
            ("earth + water = mud", 1.0),
            ("stone + water = mud", 0.75),
            ("fire + water = mud", pytest.approx(2 / 3)),
            ("earth + ice cream = mud", 0.625),
            ("fire + stone = glass", 1.0),
        ],
        ["unknown thing"],
    )


def test_lines_that_say_nothing_are_told_with_why():
    text = (
        "Sure, here they are!\nmud: water\nlava: earth + fire\nmud: mud + water\nmud: earth + water\nmud: water + earth"
    )
    assert read(text) == (
        [("earth + water = mud", 1.0)],
        ["no pair", "no pair", "unknown thing", "makes itself", "named twice"],
    )
    config = OpinionsConfig("kitchen", "http://localhost/v1", "oracle", AskingConfig(goals_per_prompt=8))
    first, second = make_prompts(config, ENTITIES)
    answers = [Answer(text="mud: water + earth"), Answer(text="glass: fire + stone\nmud: earth + fire")]
    opinions, unread = read_opinions([first, second], answers, ENTITIES)
    assert [one.recipe for one in opinions] == [(4, 5, 8)]
    assert [one.why for one in unread] == ["not asked for", "not asked for"]


def test_labels_with_signs_in_them_are_read_exactly():
    assert read("c++: fire + water\nmud: c++ + earth\nmud pie: mud + fire") == (
        [("fire + water = c++", 1.0), ("c++ + earth = mud", 1.0), ("fire + mud = mud pie", 1.0)],
        [],
    )


def test_a_label_that_begins_as_another_one_is_read_to_its_end():
    entities = ("day", "day–night", "night", "star", "star: wars", "water")
    assert read("star: wars: day + water\nday–night: star + water\nstar: night + water", entities) == (
        [("day + water = star: wars", 1.0), ("star + water = day–night", 1.0), ("night + water = star", 1.0)],
        [],
    )


@pytest.mark.parametrize("again", [": ", "+ ", "a = b + ", "mud: water + "])
def test_a_model_that_repeats_itself_for_ever_is_read_in_no_time(again):
    began = time.perf_counter()
    assert read(f"mud: earth + water\n{again * 4_000}")[0] == [("earth + water = mud", 1.0)]
    assert time.perf_counter() - began < 2  # a tenth of it; once each beginning of the line was compared, ten times it


def test_any_text_is_read_without_an_error():
    for text in (
        "",
        "\n\n",
        ":",
        "+",
        "= + =",
        "mud:" * 500,
        "a + " * 500,
        "mud: " + "water + " * 300,
        "\x00\x1b[31m",
        "²: ½ + ٣",
    ):
        assert read(text)[0] == []
