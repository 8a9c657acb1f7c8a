"""Conversations to fine-tune on: content, selection, files and the command."""

import hashlib
import json
import random
from collections import Counter

import pytest
from helpers import split_of, with_other_results, write_opened

from wordcraft_kg.agents.players import random_distinct, recipe_oracle
from wordcraft_kg.apps.text_agents.benchmark import read_manifest
from wordcraft_kg.apps.text_agents.chats import (
    CLOSING,
    WORDINGS,
    chat_rows,
    new_counts,
    recipe_scorer,
    worded_rules,
)
from wordcraft_kg.apps.text_agents.openenv_server import CraftingSession
from wordcraft_kg.apps.text_agents.plays import GameList, open_play, tool_opening
from wordcraft_kg.apps.text_agents.text_env import TextEnv
from wordcraft_kg.apps.text_agents.trl import CraftingEnvironment, LookUpEnvironment, crafting_rows
from wordcraft_kg.base.errors import ConfigError, LeakError
from wordcraft_kg.graphs import open_graph
from wordcraft_kg.models.model import Model

PLAYERS = ("oracle", "planner", "votes", "graph", "nearest-words", "random")


def kitchen_plays(*depths, part="train", attempts=None):
    return [open_play("kitchen", part, depth, 2, attempts) for depth in depths]


def rows_of(plays, player=recipe_oracle, **settings):
    counts = new_counts()
    rows = [*chat_rows(plays, player, counts, **settings)]
    assert counts["written"] == len(rows) == counts["by_depth"].total()
    assert counts["written"] + counts["left_out"] + counts["repeated"] == counts["played"]
    return rows, counts


def called(message):
    return message["tool_calls"][0]["function"]


@pytest.mark.slow
def test_a_conversation_is_what_a_rollout_of_the_same_game_reads_and_says():
    """The environment for TRL gives the same state, and the same reply to each call."""
    games = {row["task_id"]: row for row in crafting_rows("kitchen", depth=[1, 2], distractors=2)}
    rows, _ = rows_of(kitchen_plays(1, 2))
    assert len(rows) == len(games)
    environment = CraftingEnvironment()
    for row in rows[::7]:
        opening, *turns, closing = row["messages"]
        assert closing == {"role": "assistant", "content": CLOSING}
        task, _, seed = row["id"].rpartition("-")
        table = {"task_id": row["id"], "distractor_seed": int(seed)}
        environment.reset(**games[f"{task}-0"] | table)
        rules, _, state = opening["content"].partition("\n\n")
        assert state == environment.talk.game.state
        if row["wording"] == 0:
            assert opening["content"] == tool_opening(environment.talk)
        assert "Use the tool `combine`" in rules
        for said, reply in zip(turns[::2], turns[1::2], strict=True):
            assert (said["role"], said["content"], reply["role"]) == ("assistant", "", "tool")
            assert called(said)["name"] == reply["name"] == "combine"
            assert reply["content"] == environment.combine(**called(said)["arguments"])
        assert environment.get_reward() == 1
        assert len(turns) == 2 * row["attempts"] == 2 * row["depth"]
        assert row["goal"] == environment.talk.game.goal


def test_text_conversations_are_those_of_players_by_text():
    (play,) = kitchen_plays(2)
    rows, _ = rows_of([play], style="text", tasks=30)
    games = GameList({"train": [play]})
    for row in rows:
        _, *game = games.named(row["id"])
        talk = play.begin(*game)
        rules, *turns = row["messages"]
        assert rules == {
            "role": "system",
            "content": worded_rules(talk, row["wording"], by_tool=False),
        }
        heard = talk.game.state
        for asked, answer in zip(turns[::2], turns[1::2], strict=True):
            assert asked == {"role": "user", "content": heard}
            assert answer["role"] == "assistant"
            heard = talk.hear(answer["content"])
        assert talk.game.is_made
        assert "tools" not in row


def test_equal_conversations_are_written_once():
    plays = kitchen_plays(1)
    rows, counts = rows_of([*plays, *plays], tasks=20)
    assert (len(rows), counts["repeated"]) == (20, 20)


def test_orders_wordings_and_distractors_vary():
    rows, counts = rows_of(kitchen_plays(1), style="text", tasks=60, tables=5)
    answers = [row["messages"][2]["content"].split(" + ") for row in rows]
    ordered = [answer == sorted(answer) for answer in answers if len({*answer}) == 2]
    assert 0.35 < sum(ordered) / len(ordered) < 0.65
    assert {*counts["by_wording"]} == {*range(len(WORDINGS) + 1)}
    assert len({row["messages"][0]["content"] for row in rows}) == len(WORDINGS) + 1
    tables = Counter(row["messages"][1]["content"] for row in rows)
    assert max(tables.values()) == 1


def test_mistakes_are_marked_and_made_good_or_lost():
    rows, counts = rows_of(kitchen_plays(1, attempts=2), keep="all", mistakes=0.6, style="text")
    assert counts["lost"] == sum(not row["made"] for row in rows)
    assert counts["recovered"] == sum(row["made"] and bool(row["mistakes"]) for row in rows) > 20
    replies = Counter()
    for row in rows:
        for place in row["mistakes"]:
            last = place + 1 == len(row["messages"])
            reply = "" if last else row["messages"][place + 1]["content"].splitlines()[0]
            replies["invalid" if reply.startswith("Invalid") else "nothing"] += 1
            assert last or reply.startswith("Invalid") or reply.endswith("-> nothing")
    assert min(replies["invalid"], replies["nothing"]) > 20
    _, short = rows_of(kitchen_plays(1), keep="all", mistakes=0.6)
    assert short["lost"] > 10


def test_each_row_has_the_mark_of_the_benchmark_but_no_request():
    (row, *_), _ = rows_of(kitchen_plays(1), tasks=1)
    assert row["canary"] in read_manifest()[0].canary
    assert row["canary"].split()[-1].count("-") == 4  # the unique part
    assert "do not train" not in json.dumps(row)
    assert "canary" not in json.dumps(row["messages"])


@pytest.mark.parametrize("part", ["test", "all"])
def test_other_parts_are_refused(part):
    with pytest.raises(ConfigError, match=f"`part` {part}: expected train"):
        rows_of(kitchen_plays(1, part=part))


@pytest.mark.parametrize(
    "player",
    [*PLAYERS[4:], *(pytest.param(player, marks=pytest.mark.slow) for player in PLAYERS[:4])],
)
def test_the_command_writes_conversations_of_any_player(run, tmp_path, player):
    out = tmp_path / "new" / "sft.jsonl"
    outcome = run(
        *("chats", "kitchen", "--player", player, "--distractors", "1,2", "--depth", "1,2"),
        *("--tasks", "24", "--json", "--out", out),
    )
    assert outcome.code == 0, outcome.err
    view = json.loads(outcome.out)
    data = out.read_bytes()
    rows = [json.loads(line) for line in data.splitlines()]
    assert view["counts"]["written"] == len(rows) > 0
    assert view["sha256"] == hashlib.sha256(data).hexdigest()
    assert {row["part"] for row in rows} == {"train"}
    assert {*Counter(row["depth"] for row in rows)} <= {1, 2}
    settings = open_play("kitchen", "train", 1, 2, None).settings
    assert (view["graph"], view["prompts"]) == (settings.graph_hash, settings.prompt_hash)


def test_the_same_command_writes_the_same_bytes_and_another_seed_others(run, tmp_path):
    files = []
    for name, seed in (("a", 3), ("b", 3), ("c", 4)):
        out = tmp_path / name / "sft.jsonl"
        options = ["--player", "random", "--keep", "all", "--tasks", "20", "--seed", seed]
        assert run("chats", "kitchen", *options, "--out", out).code == 0
        files.append(out.read_bytes())
    assert files[0] == files[1]
    assert files[0] != files[2]


def test_bad_options_are_refused(run, tmp_path):
    out = tmp_path / "sft.jsonl"
    for options, code, fragment in (
        (["--player", "genius"], 1, "expected one of random, nearest-words"),
        (["--player", "planner:"], 1, "planner:MODEL"),
        (["--player", "scorer"], 1, "scorer:MODEL"),
        (["--player", "scorer:nowhere"], 1, "nowhere"),
        (["--player", "oracle:models"], 1, "expected one of"),
        (["--part", "test"], 2, "part"),
        (["--depth", "0"], 1, "depth"),
        (["--tables", "0"], 1, "tables"),
        (["--tasks", "0"], 1, "tasks"),
        (["--seed", "-1"], 1, "seed"),
        (["--attempts", "0"], 1, "attempts"),
        (["--mistakes", "1"], 1, "mistakes"),
        (["--reasons", "nowhere"], 1, "nowhere"),
    ):
        given = {"--tasks": "2"} if "--tasks" not in options else {}
        flat = [word for pair in given.items() for word in pair]
        outcome = run("chats", "kitchen", *options, *flat, "--out", out, "--force")
        assert (outcome.code, fragment in outcome.err) == (code, True), (options, outcome.err)


@pytest.mark.parametrize("player", ["votes", "planner"])
def test_players_of_pairs_refuse_a_book_of_sets(refused, tmp_path, player):
    out = tmp_path / "sft.jsonl"
    says = "expected a book of pairs, but kitchen-sets has recipes"
    refused("chats", "examples/kitchen-sets.csv", "--player", player, "--out", out, says=says)
    assert not out.exists()


def test_a_model_that_has_learned_the_test_recipes_gives_no_reasons(recipes_folder, monkeypatch):
    opened = open_graph("kitchen")
    recipe_scorer(recipes_folder, opened)
    monkeypatch.setattr(Model, "kg", "full")
    with pytest.raises(LeakError, match="its reasons would name test recipes"):
        recipe_scorer(recipes_folder, opened)


@pytest.mark.slow
def test_reasons_are_train_recipes_but_never_the_answer(run, tmp_path, recipes_folder):
    out = tmp_path / "reasons.jsonl"
    options = ["--style", "text", "--tasks", "60", "--reasons", recipes_folder]
    outcome = run("chats", "kitchen", *options, "--out", out)
    assert outcome.code == 0, outcome.err
    split = open_play("kitchen", "train", 1, 2, None).world.split
    known = {
        (frozenset(recipe.ingredients), recipe.result)
        for recipe in split.graph.recipe_labels(split.recipes("train"))
    }
    given = 0
    for row in map(json.loads, out.read_text().splitlines()):
        *reason, answer = row["messages"][2]["content"].splitlines()
        pair = frozenset(answer.split(" + "))
        for text in reason:
            shown = text.removeprefix("Similar recipes: ").partition(". So ")[0]
            for recipe in shown.split(", "):
                ingredients, _, result = recipe.partition(" -> ")
                fact = (frozenset(ingredients.split(" + ")), result)
                assert fact in known
                assert fact != (pair, row["goal"])
                given += 1
    assert given > 20


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
    settings = {"keep": "all", "tasks": games, "tables": 1 + games // 500}
    return [*chat_rows([play], random_distinct, new_counts(), **settings)]


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
    tasks = len(play.world.tasks)
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
