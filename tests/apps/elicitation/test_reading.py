"""Reading elicited recipes from answers, as language models write them."""

import time

import pytest

from wordcraft_kg.apps.elicitation.answers import Answer
from wordcraft_kg.apps.elicitation.config import ElicitationConfig, RequestConfig
from wordcraft_kg.apps.elicitation.prompts import make_prompts
from wordcraft_kg.apps.elicitation.reading import read_elicited

ENTITIES = ("Sun", "berry", "brick", "c++", "day", "day–night", "earth", "fire", "glass", "ice cream", "mud", "mud pie")
ENTITIES += ("night", "star", "star: wars", "stone", "water")


def read(*texts: str, goals: int = 100) -> tuple[dict[str, float], list[str]]:
    """Return the weights of the elicited recipes in answers, and the reasons of unreadable lines."""
    config = ElicitationConfig("kitchen", "http://localhost/v1", "oracle", RequestConfig(goals_per_prompt=goals))
    answers = [Answer(text=text) for text in texts]
    elicited, unread = read_elicited(make_prompts(config, ENTITIES), answers, ENTITIES)
    weights = {}
    for one in elicited:
        a, b, goal = (ENTITIES[entity] for entity in one.recipe)
        weights[f"{a} + {b} = {goal}"] = one.weight
    assert len(weights) == len(elicited)
    return weights, [one.why for one in unread]


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
def test_one_recipe_is_read_however_it_is_written(line):
    assert read(line) == ({"earth + water = mud": 1}, [])


def test_ranks_count_the_readable_pairs_of_a_goal():
    lines = ("mud: water + earth", "mud: water + gold", "mud: stone + water", "glass: fire + stone")
    weights, unread = read("\n".join([*lines, "mud: fire + water, ice cream + earth"]))
    mud = {"earth + water = mud": 1, "stone + water = mud": 3 / 4, "fire + water = mud": 2 / 3}
    assert weights == pytest.approx({**mud, "earth + ice cream = mud": 5 / 8, "fire + stone = glass": 1})
    assert unread == ["unknown item"]


def test_lines_without_a_recipe_have_a_reason():
    lines = ("Sure, here they are!", "mud: water", "lava: earth + fire", "mud: mud + water", "mud: earth + water")
    weights, unread = read("\n".join([*lines, "mud: water + earth"]))
    assert weights == {"earth + water = mud": 1}
    assert unread == ["no pair", "no pair", "unknown item", "goal as ingredient", "duplicate"]
    weights, unread = read("mud: water + earth", "glass: fire + stone\nmud: earth + fire", goals=9)
    assert (weights, unread) == ({"earth + fire = mud": 1}, ["not requested", "not requested"])


@pytest.mark.parametrize(
    ("line", "recipe"),
    [
        ("c++: fire + water", "fire + water = c++"),
        ("mud: c++ + earth", "c++ + earth = mud"),
        ("mud pie: mud + fire", "fire + mud = mud pie"),
        ("star: wars: day + water", "day + water = star: wars"),
        ("star: night + water", "night + water = star"),
        ("day–night: star + water", "star + water = day–night"),
    ],
)
def test_labels_with_signs_and_labels_within_labels_are_read_exactly(line, recipe):
    assert read(line) == ({recipe: 1}, [])


@pytest.mark.parametrize(
    "more",
    [
        *(again * 4_000 for again in (": ", "+ ", "a = b + ", "mud: water + ", "mud: ", "glass: fire + stone, ")),
        *(f"glass: {', '.join(['fire + stone'] * 20_000)}", f"mud{' ' * 20_000}x", f"{'- ' * 9_000}x"),
        *("x\n" * 400_000, "<think>" * 20_000, " " * 100_000),
    ],
    ids=range(12),
)
def test_a_model_that_repeats_itself_for_ever_is_read_in_no_time(more):
    began = time.process_time()
    assert read(f"mud: earth + water\n{more}")[0]["earth + water = mud"] == 1
    assert time.process_time() - began < 5  # some of these took minutes


def test_any_text_is_read_without_an_error():
    long = ("mud:" * 500, "a + " * 500, "mud: " + "water + " * 300)
    for text in ("", "\n\n", ":", "+", "= + =", *long, "\x00\x1b[31m", "²: ½ + ٣"):
        assert read(text)[0] == {}
