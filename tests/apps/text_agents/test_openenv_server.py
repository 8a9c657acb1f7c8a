"""The OpenEnv server: messages in this process, real web sockets, and OpenEnv's own client."""

import asyncio
import importlib.util
import json
import os
import re
import shlex
import signal
import subprocess
import sys
import time
import tomllib
from collections import Counter
from contextlib import contextmanager
from pathlib import Path

import pytest
from starlette import testclient
from starlette.websockets import WebSocketDisconnect

from tests.apps.text_agents.scripted import plan_pairs
from wordcraft_kg import __version__
from wordcraft_kg.apps.text_agents.benchmark import open_track, read_manifest
from wordcraft_kg.apps.text_agents.openenv_server import CraftingSession, make_openenv_app
from wordcraft_kg.apps.text_agents.plays import GameList, open_play
from wordcraft_kg.apps.text_agents.results import GamesHeader, games_writer, read_games
from wordcraft_kg.apps.text_agents.submission import replay
from wordcraft_kg.apps.text_agents.trl import CraftingEnvironment, crafting_rows

pytest.importorskip("starlette")

ROOT = Path(__file__).parents[3]
HAS_WEB_SOCKETS = importlib.util.find_spec("websockets") is not None


def kitchen_games(part="train", depths=(1, 2), **settings):
    plays = [open_play("kitchen", part, depth, 2, None, **settings) for depth in depths]
    return GameList({part: plays})


def client_of(games=None, **options):
    app = make_openenv_app(games or kitchen_games(), **options)
    return testclient.TestClient(app, base_url="http://localhost")


@contextmanager
def session(client):
    with client.websocket_connect("ws://localhost/ws") as socket:

        def ask(kind, data=None):
            socket.send_text(json.dumps({"type": kind} | ({} if data is None else {"data": data})))
            return socket.receive_json()

        yield ask


def seen(answer):
    assert answer["type"] == "observation", answer
    return answer["data"]


def test_http_describes_the_protocol_and_says_where_to_play():
    """The six checks of ``openenv validate --url``: version, health, metadata, schema, MCP, mode."""
    client = client_of()
    described = client.get("/openapi.json").json()
    assert described["info"]["version"]
    assert {"/reset", "/step", "/state"} <= described["paths"].keys()
    assert client.get("/health").json() == {"status": "healthy"}
    assert client.get("/metadata").json().keys() >= {"name", "description"}
    assert client.get("/schema").json().keys() == {"action", "observation", "state"}
    assert client.post("/mcp", json={}).json()["jsonrpc"] == "2.0"
    begun = client.post("/reset", json={"split": "train", "index": 3}).json()
    assert begun["observation"]["task_id"] == "kitchen-train-1-2-3-0"
    assert client.post("/reset").json()["done"] is False
    refused = client.post("/reset", json={"split": "test"})
    assert (refused.status_code, "not offered" in refused.json()["detail"]) == (400, True)
    step = client.post("/step", json={"action": {"answer": "1 + 2"}})
    assert (step.status_code, "/ws" in step.json()["detail"]) == (409, True)
    assert client.get("/state").json() == {"episode_id": None, "step_count": 0}


def test_a_plan_by_each_kind_of_action_earns_the_reward():
    games = kitchen_games()
    with session(client_of(games)) as ask:
        for index in (0, 3, games.count("train") - 1):
            play, task = games.at("train", index)
            for act in (
                lambda pair: {"answer": f"I think so.\n{pair[0]} + {pair[1]}"},
                lambda pair: {"first": pair[0], "second": pair[1]},
                lambda pair: {"answer": [*pair]},
            ):
                begun = seen(ask("reset", {"split": "train", "index": index}))
                assert begun["reward"] is None
                assert begun["observation"]["task_id"] == play.name(task)
                assert "Choose two of the listed items" in begun["observation"]["text"]
                rewards = []
                for pair in plan_pairs(play.game(task)):
                    last = seen(ask("step", act(pair)))
                    rewards.append(last["reward"])
                assert sum(rewards) == 1
                assert (last["done"], last["metadata"]["success"]) == (True, True)


def test_a_row_of_the_data_set_a_name_and_an_index_are_the_same_game():
    rows = crafting_rows("kitchen", depth=[1, 2], distractors=2, tables=2, tasks=4)
    environment = CraftingEnvironment()
    games = kitchen_games()
    with session(client_of(games)) as ask:
        for row in rows:
            environment.reset(**row)
            by_name = seen(ask("reset", {"task_id": row["task_id"]}))["observation"]
            assert by_name["table"] == [*environment.talk.game.labels]
            place = row["task"] + (0 if row["depth"] == 1 else len_of(games, 0))
            by_index = seen(ask("reset", {"index": place, "seed": row["distractor_seed"]}))
            assert by_index["observation"] == by_name


def len_of(games, place):
    return len(games.plays["train"][place].world.tasks)


def test_a_seed_draws_the_same_game_in_each_session():
    client = client_of()
    with session(client) as one, session(client) as other:
        first = [seen(one("reset", {"seed": seed})) for seed in range(20)]
        assert [seen(other("reset", {"seed": seed})) for seed in range(20)] == first
    assert len({begun["observation"]["task_id"] for begun in first}) == 20


def test_sessions_do_not_disturb_each_other():
    """An interleaved game equals a game alone."""
    client = client_of()
    with session(client) as one, session(client) as other:
        alone = [one("reset", {"index": 7}), one("step", {"answer": "1 + 2"})]
        begun = one("reset", {"index": 7})
        other("reset", {"index": 8})
        other("step", {"answer": "1 + 1"})
        assert [begun, one("step", {"answer": "1 + 2"})] == alone


@pytest.mark.parametrize(
    ("asked", "says"),
    [
        ({"split": "test", "index": 0}, "the part 'test' is not offered here; expected train"),
        ({"task_id": "kitchen-test-1-2-0-0"}, "no game of this server"),
        ({"task_id": "kitchen-train-3-2-0-0"}, "no game of this server"),
        ({"task_id": "kitchen-train-1-2-999999999-0"}, "no game of this server"),
        ({"task_id": "x" * 10_000}, "no game of this server"),
        ({"task_id": 7}, "no game of this server"),
        ({"index": -1}, "`index` -1: expected a whole number, 0 to"),
        ({"index": 10**30}, "`index` 1"),
        ({"index": 0.5}, "`index` 0.5"),
        ({"seed": "x"}, "`seed`"),
        ({"seed": -1}, "`seed`"),
        ({"goal": "bread"}, "reset has no argument 'goal': seed, episode_id"),
        ({"split": ["train"]}, "is not offered here"),
    ],
)
def test_a_game_that_is_not_offered_is_refused_and_the_session_goes_on(asked, says):
    with session(client_of()) as ask:
        begun = ask("reset", {"index": 1})
        refused = ask("reset", asked)
        assert refused["type"] == "error"
        assert says in refused["data"]["message"]
        assert len(refused["data"]["message"]) < 400
        # The refused reset did not end the game before.
        assert seen(ask("step", {"answer": "nonsense"}))["done"] is False
        assert ask("reset", {"index": 1}) == begun


@pytest.mark.parametrize(
    ("message", "code"),
    [
        ("nonsense", "INVALID_JSON"),
        ("[" * 100_000, "INVALID_JSON"),
        ("[]", "INVALID_JSON"),
        ("7", "INVALID_JSON"),
        ('{"type": "mcp"}', "UNKNOWN_TYPE"),
        ('{"type": ["reset"]}', "UNKNOWN_TYPE"),
        ('{"type": "reset", "data": 7}', "UNKNOWN_TYPE"),
        ('{"type": "step"}', "EXECUTION_ERROR"),
        # The object that an action is, and not the types of messages, is what such a client lacks.
        ('{"type": "step", "data": "1 + 2"}', "EXECUTION_ERROR"),
        ('{"type": "step", "data": {"answer": "1 + 2"}}', "EXECUTION_ERROR"),
        ('{"type": "step", "data": {"answer": "1 + 2", "first": "1"}}', "EXECUTION_ERROR"),
    ],
)
def test_a_malformed_message_is_answered_and_the_session_goes_on(message, code):
    client = client_of()
    with client.websocket_connect("ws://localhost/ws") as socket:
        socket.send_text(message)
        assert socket.receive_json()["data"]["code"] == code
        socket.send_bytes(b'{"type": "state"}')
        assert socket.receive_json() == {
            "type": "state",
            "data": {"episode_id": None, "step_count": 0},
        }


def test_invalid_answers_of_any_length_count_and_end_the_game():
    with session(client_of()) as ask:
        ask("reset", {"index": 0, "episode_id": "mine"})
        begin = time.perf_counter()
        for step in range(4):
            answer = seen(ask("step", {"answer": "word " * 2_000_000}))
            assert len(answer["observation"]["text"]) < 1_000
            assert answer["done"] == (step == 3)
        assert time.perf_counter() - begin < 5
        assert answer["metadata"]["invalid_actions"] == 4
        assert answer["reward"] == 0
        over = seen(ask("step", {"answer": "1 + 2"}))
        assert over["observation"]["text"].startswith("This game is over.")
        assert (over["done"], over["reward"]) == (True, 0)
        assert ask("state")["data"] == {"episode_id": "mine", "step_count": 4}


def test_the_number_of_sessions_is_bounded_and_a_place_becomes_free():
    client = client_of(sessions=2)
    with session(client) as one, session(client):
        with client.websocket_connect("ws://localhost/ws") as third:
            error = third.receive_json()["data"]
            assert error["code"] == "CAPACITY_REACHED"
            assert "2 sessions are open" in error["message"]
            with pytest.raises(WebSocketDisconnect):
                third.receive_json()
        assert seen(one("reset", {"index": 0}))["done"] is False
    with session(client) as again:
        assert seen(again("reset", {"index": 0}))["done"] is False


def test_a_silent_session_ends():
    with (
        client_of(idle=0.1).websocket_connect("ws://localhost/ws") as socket,
        pytest.raises(WebSocketDisconnect) as closed,
    ):
        socket.receive_json()
    assert closed.value.reason == "silent for 0.1 seconds; connect again"


@pytest.mark.parametrize(
    "headers",
    [{"host": "elsewhere.org"}, {"host": "localhost", "origin": "http://elsewhere.org"}],
)
def test_pages_of_other_sites_are_refused(headers):
    client = client_of()
    with (
        pytest.raises(WebSocketDisconnect),
        client.websocket_connect("ws://localhost/ws", headers=headers),
    ):
        pass
    answer = client.post("/crafting/num_tasks", json={"split": "train"}, headers=headers)
    assert answer.status_code in (403, 421)
    assert "detail" in answer.json()


def test_the_task_api_describes_the_games():
    games = kitchen_games()
    client = client_of(games)
    assert client.get("/metadata").json()["name"] == "crafting"
    # A client of verifiers sends plain text as the only field that is required.
    assert client.get("/schema").json()["action"]["required"] == ["answer"]
    assert client.get("/list_environments").json() == ["crafting"]
    assert client.get("/crafting/splits").json() == [{"name": "train", "type": "train"}]
    count = games.count("train")
    answers = {
        name: client.post(f"/crafting/{name}", json=asked).json()
        for name, asked in {
            "num_tasks": {"split": "train"},
            "task": {"split": "train", "index": count - 1},
            "tasks": {"split": "train"},
            "task_range": {"split": "train", "start": 2, "stop": 4},
        }.items()
    }
    assert answers["num_tasks"] == {"num_tasks": count}
    tasks = answers["tasks"]["tasks"]
    assert answers["task"]["task"] == tasks[-1]
    assert answers["task_range"]["tasks"] == tasks[2:4]
    assert len({task["id"] for task in tasks}) == count
    assert {task["depth"] for task in tasks} == {1, 2}


@pytest.mark.parametrize(
    ("name", "body", "status"),
    [
        ("task", '{"split": "test", "index": 0}', 400),
        ("task", '{"split": "train"}', 400),
        ("task", '{"split": "train", "index": -1}', 400),
        ("task_range", '{"split": "train", "start": "a"}', 422),
        ("num_tasks", "nonsense", 422),
        ("num_tasks", "[]", 422),
        ("num_tasks", "[" * 60_000, 422),
        ("num_tasks", "x" * 100_000, 413),
    ],
)
def test_malformed_requests_are_refused_in_json(name, body, status):
    answer = client_of().post(f"/crafting/{name}", content=body)
    assert (answer.status_code, "detail" in answer.json()) == (status, True)


def test_games_of_a_track_become_a_submission_that_verifies(tmp_path, run):
    track = open_track("craft-1-lite")
    play = track.play()
    path = tmp_path / "games.jsonl"
    header = GamesHeader(player="OpenEnv clients", settings=play.settings)
    with (
        games_writer(path, header) as keep,
        session(client_of(GameList({"test": [play]}), keep=keep)) as ask,
    ):
        for index in range(len(track)):
            done = seen(ask("reset", {"split": "test", "index": index}))["done"]
            if index == 3:  # the client leaves this game after an invalid answer: it counts
                ask("step", {"answer": "no idea"})
                done = True
            while not done:
                done = seen(ask("step", {"answer": "1 + 2"}))["done"]
    out = tmp_path / "submission"
    played = run("bench", "run", track.name, "--player", f"openenv:{path}", "--out", out)
    assert played.code == 0, played.err
    assert run("bench", "verify", out).code == 0
    lines = (out / "games.jsonl").read_text().splitlines()
    assert json.loads(lines[3])["ended"] is True
    for number, game in enumerate(read_games(path)[1]):
        line = replay(play, number, game)
        assert line.pairs == game.pairs


@contextmanager
def recorded(path, play):
    """Yield a session whose games are recorded, and how to ask it."""
    header = GamesHeader(player="clients", settings=play.settings)
    with (
        games_writer(path, header) as keep,
        session(client_of(GameList({"test": [play]}), keep=keep)) as ask,
    ):
        yield ask


@pytest.mark.parametrize("answer", ["\ud800", "1 + \udfff \0", "x" * 1_000_000])
def test_a_game_is_recorded_whatever_its_player_says(tmp_path, answer):
    path = tmp_path / "games.jsonl"
    with recorded(path, open_track("craft-1-lite").play()) as ask:
        for index in range(2):
            seen(ask("reset", {"index": index}))
            done = False
            while not done:
                done = seen(ask("step", {"answer": answer}))["done"]
        seen(ask("reset", {"index": 2}))
        ask("step", {"answer": answer})  # and left
    assert [(one.task, one.success) for one in read_games(path)[1]] == [
        (0, False),
        (1, False),
        (2, False),
    ]


def test_a_lost_game_cannot_be_played_again_because_the_disk_was_full(tmp_path, monkeypatch):
    def full(file):
        raise OSError(28, "No space left on device")

    path = tmp_path / "games.jsonl"
    play = open_track("craft-1-lite").play()
    with games_writer(path, GamesHeader(player="clients", settings=play.settings)) as keep:
        client = client_of(GameList({"test": [play]}), keep=keep)
        with monkeypatch.context() as patch, session(client) as ask:
            patch.setattr("os.fsync", full)
            seen(ask("reset", {"index": 0}))
            assert "was not saved" in ask("step", {"answer": "1 + 1"})["data"]["message"]
            assert "was not saved" in ask("reset", {"index": 0})["data"]["message"]
        assert not read_games(path)[1]
        # The client has left, and comes again.
        with session(client) as ask:
            seen(ask("reset", {"index": 0}))
            seen(ask("step", {"answer": "1 + 2"}))
    assert [(one.task, len({*one.pairs[-1]})) for one in read_games(path)[1]] == [(0, 1), (0, 2)]


@contextmanager
def running(*options, files=None):
    """Run the command in another process, with a limit of open files; yield it with its address."""

    def limit():
        if files is not None:
            resource = importlib.import_module("resource")  # not on Windows
            resource.setrlimit(resource.RLIMIT_NOFILE, (files, files))

    command = [sys.executable, "-m", "wordcraft_kg", "serve", "openenv", "kitchen"]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT), *sys.path])}
    process = subprocess.Popen(
        [*command, "--port", "0", "--json", *options],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        env=environment,
        preexec_fn=limit,
    )
    try:
        yield process, json.loads(process.stdout.readline())["address"]
    finally:
        process.kill()
        process.communicate()


@pytest.mark.slow
@pytest.mark.skipif(not HAS_WEB_SOCKETS, reason="the extra openenv is not installed")
def test_no_finished_game_is_lost_when_clients_and_the_server_are_killed(tmp_path):
    """Twenty players at once: some leave in the middle, and then the server is killed twice."""
    from websockets.asyncio.client import connect
    from websockets.exceptions import ConnectionClosed

    finished = []

    async def play(address, number):
        async with connect(f"ws{address[4:]}/ws", proxy=None) as socket:

            async def ask(kind, data):
                await socket.send(json.dumps({"type": kind, "data": data}))
                return json.loads(await socket.recv())["data"]

            for game in range(50):
                begun = await ask("reset", {"index": (number + 20 * game) % 63, "seed": game})
                if number % 4 == 0 and game == 3:
                    socket.transport.abort()
                    return
                answer = await ask("step", {"answer": "1 + 2"})
                assert answer["done"]
                finished.append((begun["observation"]["goal"], begun["observation"]["table"]))

    async def all_play(process, address, enough):
        players = [asyncio.create_task(play(address, number)) for number in range(20)]
        while len(finished) < enough:
            await asyncio.sleep(0.01)
        process.kill()
        ends = await asyncio.gather(*players, return_exceptions=True)
        assert all(end is None or isinstance(end, ConnectionClosed) for end in ends), ends

    path = tmp_path / "games.jsonl"
    for enough in (200, 400):
        with running("--part", "test", "--out", str(path)) as (process, address):
            asyncio.run(all_play(process, address, enough))
    with running("--part", "test", "--out", str(path)) as (process, _):
        process.send_signal(signal.SIGINT)
        assert process.wait(10) == 0
    played = Counter((game.goal, *game.table) for game in read_games(path)[1])
    told = Counter((goal, *table) for goal, table in finished)
    assert told.total() >= 400
    # The last answer of a player may have been on its way.
    assert not told - played
    assert played.total() - told.total() <= 40


@pytest.mark.slow
@pytest.mark.skipif(not HAS_WEB_SOCKETS, reason="the extra openenv is not installed")
def test_the_client_of_openenv_plays():
    openenv = pytest.importorskip("openenv", reason="OpenEnv is not installed")
    with (
        running("--part", "train,test") as (_, address),
        openenv.GenericEnvClient(base_url=address).sync() as env,
    ):
        begun = env.reset(split="test", index=2)
        assert begun.observation["task_id"] == "kitchen-test-1-8-2-0"
        assert env.step({"answer": "1 + 2"}).done
        assert env.state()["step_count"] == 1
        with pytest.raises(RuntimeError, match="the part 'valid' is not offered"):
            env.reset(split="valid", index=0)


def test_bad_options_are_refused_before_anything_is_served(refused, tmp_path):
    for options, setting, fragment in (
        (["--part", "train,exam"], "part", "expected one of all, train, valid, test"),
        (["--depth", "9"], "depth", "1 to 5"),
        (["--depth", "x"], "depth", "whole numbers"),
        (["--sessions", "0"], "sessions", "1"),
        (["--idle", "nan"], "idle", "seconds"),
        (["--track", "craft-1"], "", "--track has its own games"),
        (["--depth", "1,2", "--out", tmp_path / "games"], "out", "one part, depth and number"),
    ):
        refused("serve", "openenv", "kitchen", *options, says=fragment, setting=setting)


@pytest.mark.skipif(not HAS_WEB_SOCKETS, reason="the extra openenv is not installed")
def test_an_open_ended_track_has_no_reward_and_is_refused(refused):
    refused("serve", "openenv", "--track", "discover-500", "--port", "0", says="nor a reward")


PACKAGE = Path(__file__).parents[3] / "publish" / "openenv"


@pytest.mark.slow
def test_canary_games_and_the_declared_number_of_tasks_are_those_of_the_server():
    games = GameList({"train": [open_play("everyday", "train", 1, 8, None)]})
    session = CraftingSession(games)
    lines = (PACKAGE / "validation" / "canaries.jsonl").read_text(encoding="utf-8").splitlines()
    rewards = []
    for line in map(json.loads, lines):
        session.reset(line["reset"])
        total = sum(session.step(action)["reward"] for action in line["actions"])
        assert total == line["reward"]
        rewards.append(total)
    assert {*rewards} == {0.0, 1.0}
    declared = (PACKAGE / "openenv.yaml").read_text(encoding="utf-8")
    assert re.search(r"^      train: (\d+)$", declared, re.M)[1] == str(games.count("train"))


def test_the_card_of_the_benchmark_names_its_tracks():
    card = (PACKAGE.parent / "everyday-v3" / "README.md").read_text(encoding="utf-8")
    rows = "\n".join(line for line in card.splitlines() if line.startswith("| `"))
    assert set(re.findall(r"`([a-z0-9-]+)`", rows)) == set(read_manifest()[0].tracks)


def test_the_package_is_of_this_version_and_ships_no_oracle_in_its_image():
    declared = (PACKAGE / "openenv.yaml").read_text(encoding="utf-8")
    assert f"\nversion: {__version__}\n" in declared
    copied = re.findall(r"^COPY (.*)", (PACKAGE / "Dockerfile").read_text(encoding="utf-8"), re.M)
    assert copied == ["*.whl ./", "server ./server"]


def test_the_image_has_the_packages_of_the_small_installation_and_of_the_extra():
    root = PACKAGE.parents[1]
    project = tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    guide = (root / "docs" / "installation.md").read_text(encoding="utf-8")
    small = re.findall(r"^pip install (cyclopts .*)$", guide, re.M)[0].split()
    (command,) = re.findall(
        r"pip install --no-cache-dir (cyclopts.*?) &&",
        (PACKAGE / "Dockerfile").read_text(encoding="utf-8"),
        re.S,
    )
    extra = project["optional-dependencies"]["openenv"]
    # Sessions stand on pages' guard, whose messages are templates.
    assert sorted(shlex.split(command.replace("\\\n", ""))) == sorted([*small, *extra, "jinja2"])
