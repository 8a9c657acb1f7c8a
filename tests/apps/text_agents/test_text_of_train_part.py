"""Games as text on two books that differ in held-out results alone: equal to the letter."""

import random

import pytest
from helpers import split_of, with_other_results, write_opened

from wordcraft_kg import open_graph
from wordcraft_kg.agents.players import random_distinct
from wordcraft_kg.apps.text_agents.chats import ChatCounts, ChatSettings, chat_rows
from wordcraft_kg.apps.text_agents.hosted_games import GameList, open_play
from wordcraft_kg.apps.text_agents.openenv_server import CraftingSession
from wordcraft_kg.apps.text_agents.text_env import TextEnv
from wordcraft_kg.apps.text_agents.trl import LookUpEnvironment, crafting_rows

KINDS = [
    "by-goal",
    *(pytest.param(kind, marks=pytest.mark.slow) for kind in ("by-recipe", "by-slot")),
]
GAMES = [30, pytest.param(1_000, marks=pytest.mark.slow)]
GAME = {"depth": 2, "distractors": 3, "attempts": 3}


@pytest.fixture(scope="module", params=KINDS)
def graphs(request, tmp_path_factory):
    """Folders of the kitchen, and of the kitchen with other held-out results."""
    opened = split_of(open_graph("kitchen").graph, request.param)
    parent = tmp_path_factory.mktemp("graphs")
    both = (opened, with_other_results(opened, 1))
    return [str(write_opened(each, parent / str(i) / "kitchen")) for i, each in enumerate(both)]


def chats(graph, games):
    play = open_play(graph, "train", 2, 3, 3)
    settings = ChatSettings(kept="all", tasks=games, tables=1 + games // 500)
    return [*chat_rows([play], random_distinct, settings, ChatCounts())]


def pair_of(table, rng):
    return [rng.choice(table), rng.choice(table)]


def tools(graph, games):
    """Rows of TRL, and what its environment with look-ups answers."""
    rng = random.Random(0)
    env = LookUpEnvironment()
    told = []
    for row in crafting_rows(graph, **GAME, knowledge="partial", tasks=games):
        told.append({name: row[name] for name in row.keys() - {"graph", "split_hash"}})
        told.append(env.reset(**row))
        for _ in range(3):
            table = env._begun.game.labels
            told += [env.look_up(rng.choice(table)), env.combine(*pair_of(table, rng))]
        told.append(env.get_reward())
    return told


def messages(graph, games):
    rng = random.Random(1)
    env = TextEnv(graph, depth=2, num_distractors=3, max_attempts=3, knowledge="partial")
    env.reset(seed=0)
    told = []
    for _ in range(games):
        told.append(env.reset())
        while not env.talk.is_over:
            told.append(env.step(" + ".join(pair_of(env.talk.game.labels, rng))))
    return told


def sessions(graph, games):
    rng = random.Random(2)
    play = open_play(graph, "train", 2, 3, 3)
    tasks = len(play.games.world.tasks)
    session = CraftingSession(GameList({"train": [play]}))
    told = []
    for index in range(games):
        game = {"index": index % tasks, "seed": index // tasks}
        seen = session.reset({"split": "train", **game})
        told.append(seen)
        while not seen.get("done"):
            pair = pair_of(seen["observation"]["table"], rng)
            seen = session.step({"answer": " + ".join(pair)})
            told.append(seen)
    return told


@pytest.mark.parametrize("games", GAMES)
@pytest.mark.parametrize("stream", [chats, tools, messages, sessions])
def test_no_text_of_the_train_part_depends_on_held_out_results(graphs, stream, games):
    one, other = (stream(graph, games) for graph in graphs)
    assert len(one) >= games / 2  # a small book has fewer tasks
    assert one == other
