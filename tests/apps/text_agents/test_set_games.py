"""Games by text on a book whose recipes have any number of ingredients."""

import asyncio

import pytest

from wordcraft_kg import WordCraftConfig, World
from wordcraft_kg.agents.evaluation import Evaluator
from wordcraft_kg.agents.players import recipe_oracle
from wordcraft_kg.apps.text_agents.conversation import (
    Conversation,
    PartialGraphKnowledge,
    Play,
    hidden_pairs,
)
from wordcraft_kg.apps.text_agents.games import TaskGames
from wordcraft_kg.apps.text_agents.hosted_games import GameList, HostedGames, open_play
from wordcraft_kg.apps.text_agents.results import evaluation_of, record_of
from wordcraft_kg.apps.text_agents.settings import GameSettings
from wordcraft_kg.apps.text_agents.text_env import TextEnv
from wordcraft_kg.apps.text_agents.trl import SetCraftingEnvironment, crafting_rows
from wordcraft_kg.base.answers import read_set
from wordcraft_kg.base.errors import ActionError
from wordcraft_kg.envs.words import prompt_hash

BOOK = "examples/kitchen-sets.csv"
TABLE = ("water", "earth", "fire", "egg", "salt and pepper", "2")


@pytest.fixture(scope="module")
def world():
    return World.open(BOOK, WordCraftConfig(part="test", num_distractors=2))


def ingredients(game):
    return game.tasks[game.task].plans[0][0].ingredients


@pytest.mark.parametrize(
    ("message", "places"),
    [
        ("water + earth + fire", (0, 1, 2)),
        ("I think of mud.\n\nAnswer: 1 + egg + egg + fire = cake", (0, 3, 3, 2)),
        ("combine Water, earth and the fire.", (0, 1, 2)),
        (r"\boxed{water + salt and pepper}", (0, 4)),
        ("salt and pepper", (4,)),
        ("<think>fire</think>eggs", (3,)),
        ('So:\n["water", "earth",\n"egg"]', (0, 1, 3)),
        ('{"items": ["water", "salt and pepper", 2]}', (0, 4, 5)),
        ('{"name": "combine", "arguments": {"items": ["egg", "egg", "fire"]}}', (3, 3, 2)),
        ('combine("water", "egg", "fire")', (0, 3, 2)),
        ('combine(items=["water", "egg", "fire"])', (0, 3, 2)),
        ("I combine **water** and **egg** and **salt and pepper** now.", (0, 3, 4)),
        ("1 4 3", (0, 3, 2)),
    ],
)
def test_an_answer_names_a_set(message, places):
    assert read_set(message, TABLE, 4) == places


@pytest.mark.parametrize(
    ("message", "says"),
    [
        ("", "0 items: expected 1 to 4"),
        ("water + earth + fire + egg + egg", "5 items: expected 1 to 4"),
        ("water + unicorn", "unknown item 'unicorn'"),
        ("water + + earth", "no answer"),
        ("1 " * 1000, "1,999 characters: expected 1 to 4 items"),
        ("I combine water, earth and unicorn now.", "unknown item 'unicorn now'"),
        ("I never combine **water** and **earth** today.", "unknown item"),
        ("combine(water, egg) or combine(fire, egg)", "2 different sets: expected one"),
    ],
)
def test_an_answer_that_names_no_set_is_refused(message, says):
    with pytest.raises(ActionError, match=says):
        read_set(message, TABLE, 4)


@pytest.mark.parametrize(
    ("message", "places"),
    [
        ("salt and pepper and oil", (0, 2)),
        ("oil, salt and pepper, pepper", (2, 0, 1)),
        ("salt and pepper + oil + C++ code", (0, 2, 3)),
        ("salt", (0,)),
    ],
)
def test_labels_that_hold_a_separator_are_read_whole(message, places):
    assert read_set(message, ("salt and pepper", "pepper", "oil", "C++ code"), 4) == places


def test_a_piece_of_a_list_is_no_beginning_of_a_label_with_a_separator():
    with pytest.raises(ActionError, match="only the beginning of 'salt and pepper'"):
        read_set("salt, pepper, oil", ("salt and pepper", "pepper", "oil"), 4)


def test_a_player_by_text_has_the_evaluation_of_a_player_by_slots(world):
    games = TaskGames(world)
    records = []
    for seed in range(2):
        for task in range(len(world.tasks)):
            talk = Conversation(games.begin(task, seed))
            answer = " + ".join(ingredients(talk.game))
            # One task in three gets an answer that lacks an ingredient.
            talk.hear(answer if task % 3 else answer.partition(" + ")[2])
            records.append(record_of(talk))
    found = evaluation_of(records, world.groups)
    oracle = Evaluator(world, distractor_seeds=2)(recipe_oracle)
    is_right = [task % 3 > 0 for task in range(len(world.tasks))]
    assert found.success.all(axis=1).tolist() == is_right
    assert (found.actions[is_right] == oracle.actions[is_right]).all()
    assert oracle.success.all()


def test_every_interface_makes_a_goal_with_a_set(world):
    play = open_play(BOOK, "test", 1, 2, None)
    game = play.begin().game
    items = list(ingredients(game))
    assert "from one to 6 of them" in game.rules

    env = TextEnv(world)
    env.reset(seed=0, options={"task": 0, "distractor_seed": 0})
    _, reward, is_over, _, info = env.step(" + ".join(items))
    assert (reward, is_over, info["is_success"]) == (1, True, True)

    rows = crafting_rows(BOOK, part="test", depth=1, distractors=2)
    environment = SetCraftingEnvironment()
    environment.reset(**rows[0])
    assert "7 items: expected 1 to 6" in environment.combine(7 * items[:1])
    environment.combine(items)
    assert environment.get_reward() == 1

    pytest.importorskip("starlette")
    from wordcraft_kg.apps.text_agents.openenv_server import CraftingSession

    session = CraftingSession(GameList({"test": [play]}))
    session.reset({"index": 0})
    assert session.step({"items": items})["reward"] == 1


def test_a_tool_of_the_mcp_server_takes_a_list_of_items():
    pytest.importorskip("mcp.server")
    from mcp.client.client import Client

    from wordcraft_kg.apps.text_agents.mcp_server import make_server, tools_hash

    play = Play.open(BOOK, GameSettings(part="test", depth=1, distractors=2))
    items = list(ingredients(play.begin().game))

    async def ask():
        async with Client(make_server(HostedGames(play))) as client:
            begun = (await client.call_tool("begin", {"task": 0})).structured_content
            arguments = {"game": begun["game"], "items": items}
            return (await client.call_tool("combine", arguments)).structured_content

    assert asyncio.run(ask())["success"] is True
    assert tools_hash(sets=True) != tools_hash()
    assert prompt_hash(sets=True) == play.settings.prompt_hash != prompt_hash()


def test_look_ups_show_no_set_that_solves_the_task(world):
    games = TaskGames(world.variant(part="train"))
    knowledge = PartialGraphKnowledge(world.split)
    for task in range(len(games.world.tasks)):
        game = games.begin(task)
        assert hidden_pairs(game)
        recipe = game.tasks[game.task].plans[0][0]
        for label in recipe.ingredients:
            facts = knowledge.facts(world.graph.id_of(label), game)
            assert str(recipe) not in facts
