"""The MCP server, called by the SDK's own client: in this process, on standard streams, and over
HTTP."""

import asyncio
import json
import socket
import sys
import threading
import time
from contextlib import contextmanager
from functools import partial
from pathlib import Path

import httpx2
import pytest

pytest.importorskip("mcp.server")

from mcp.client.client import Client
from mcp.client.stdio import StdioServerParameters

from tests.apps.text_agents.scripted import assert_same, picks_of
from wordcraft_kg.agents.evaluation import Evaluator
from wordcraft_kg.agents.players import random_distinct
from wordcraft_kg.apps.text_agents import conversation, mcp_server
from wordcraft_kg.apps.text_agents.benchmark import open_track
from wordcraft_kg.apps.text_agents.commands.bench import bench_run
from wordcraft_kg.apps.text_agents.conversation import NEVER
from wordcraft_kg.apps.text_agents.mcp_server import (
    HostedGames,
    make_http_app,
    make_server,
    tools_hash,
)
from wordcraft_kg.apps.text_agents.plays import DiscoveryGames, open_play
from wordcraft_kg.apps.text_agents.results import (
    GamesHeader,
    evaluation_of,
    games_writer,
    read_games,
    record_of,
)
from wordcraft_kg.apps.text_agents.submission import verify
from wordcraft_kg.apps.web.serving import listen
from wordcraft_kg.base.errors import ArtefactError, ConfigError, EpisodeError
from wordcraft_kg.envs.words import PROMPTS

ROOT = Path(__file__).parents[3]
MODES = ("legacy", "auto")
COMMAND = ["-m", "wordcraft_kg", "mcp", "kitchen", "--distractors", "3"]
CLIENT = {
    "protocolVersion": "2025-06-18",
    "capabilities": {},
    "clientInfo": {"name": "test", "version": "1"},
}
HELLO = json.dumps({"jsonrpc": "2.0", "id": 7, "method": "initialize", "params": CLIENT}).encode()


@pytest.fixture
def world(games):
    return games.world


def hosted():
    return HostedGames(open_play("kitchen", "test", 1, 3, max_invalid=NEVER))


def connect(server, use, mode="auto"):
    """Connect a client to a server, and use the client."""

    async def connected():
        async with Client(server, mode=mode) as client:
            return await use(client)

    return asyncio.run(connected())


async def called(client, tool, **arguments):
    """Call a tool; return its text and values, None on an error."""
    result = await client.call_tool(tool, arguments)
    (content,) = result.content
    assert result.is_error == (result.structured_content is None)
    return content.text, result.structured_content


def play_by_tools(host, play, mode="auto"):
    return connect(make_server(host), lambda client: play(partial(called, client)), mode)


@pytest.mark.parametrize("track", ["craft-1-lite", "discover-500-lite"])
def test_the_games_of_a_benchmark_track_become_a_submission_that_verifies(tmp_path, track):
    opened = open_track(track)
    host = HostedGames(opened.play(max_invalid=NEVER))
    with games_writer(path := tmp_path / "games.jsonl", header_of(host)) as host.keep:
        for task in range(len(opened) - 1):
            begun = host.begin(0 if opened.is_open_ended else task)
            begun.combine("1", "2")
            begun.end()
        with pytest.raises(ConfigError, match=f"{len(opened) - 1} of {len(opened)} games"):
            bench_run(track, player=f"mcp:{path}", out=tmp_path / "out")
        host.begin(0 if opened.is_open_ended else len(opened) - 1).end()
        with pytest.raises(EpisodeError, match="is played once"):
            host.begin(0)
    bench_run(track, player=f"mcp:{path}", out=tmp_path / "out")
    submission = verify(tmp_path / "out")
    assert (submission.figures.games, submission.prompts) == (len(opened), "standard")


@contextmanager
def served(host):
    """Serve over HTTP in a thread of this process."""
    import uvicorn

    listening, app = listen("127.0.0.1", 0), make_http_app(make_server(host))
    web = uvicorn.Server(uvicorn.Config(app, log_config=None, timeout_graceful_shutdown=1))
    thread = threading.Thread(target=web.run, kwargs={"sockets": [listening]})
    thread.start()
    try:
        yield f"http://127.0.0.1:{listening.getsockname()[1]}/mcp"
    finally:
        web.should_exit = True
        thread.join()
        listening.close()


@pytest.mark.parametrize("mode", [pytest.param("legacy", marks=pytest.mark.slow), "auto"])
def test_a_scripted_player_by_tools_has_its_evaluation(world, mode):
    """A scripted player that plays by tools has its evaluation to the last digit."""
    slots = picks_of(random_distinct, world, 1)
    expected = Evaluator(world, distractor_seeds=1)(random_distinct)
    host, played = hosted(), []
    host.keep = lambda over: played.append(record_of(over))

    async def play(call):
        for task in range(len(world.tasks)):
            _, begun = await call("begin", task=task)
            one, other = slots[task, 0]
            _, over = await call(
                "combine", game=begun["game"], first=one + 1, second=begun["items"][other]
            )
            assert over["is_over"]

    play_by_tools(host, play, mode)
    assert_same(evaluation_of(played, world.groups), expected)
    assert 0 < expected.success.mean() < 1


@pytest.mark.parametrize("mode", MODES)
def test_a_game_has_texts_and_values(world, mode):
    one, other, goal = world.tasks[0].plans[0][0]
    results = ", ".join(
        world.graph.labels(world.graph.outcomes[world.graph.id_of(one), world.graph.id_of(other)])
    )

    async def play(call):
        text, begun = await call("begin", task=0)
        assert (begun["goal"], begun["rules"] in text) == (goal, True)
        assert text.endswith("Attempts left: 1")
        game = begun["game"]
        text, listed = await call("state", game=game)
        assert (
            ", ".join(f"{number} {thing}" for number, thing in enumerate(begun["items"], 1)) in text
        )
        assert (listed["success"], listed["is_over"]) == (None, False)
        text, made = await call("combine", game=game, first=f"the {one.upper()}", second=other)
        assert text == f"{one} + {other} -> {results}\n\nYou made the goal: {goal}."
        assert (made["success"], made["attempts_left"], made["is_over"]) == (True, 0, True)
        assert await call("state", game=game) == (
            f"You made the goal: {goal}.",
            {key: made[key] for key in listed},
        )

    play_by_tools(hosted(), play, mode)


def test_an_invalid_call_is_a_tools_error_that_costs_nothing():
    invalid = (
        ("combine", {"first": "unicorn", "second": 1}, "unknown item 'unicorn': expected 1 to 5"),
        ("combine", {"first": 6, "second": 1}, "unknown item '6': expected 1 to 5"),
        ("combine", {"first": "", "second": 1}, "no answer: expected 1 to 5"),
        ("combine", {"first": True, "second": 1}, "'first': Input should be a valid string"),
        ("combine", {"first": ["1"], "second": 1}, "'first': Input should be a valid string"),
        ("combine", {"first": 10**40, "second": 1}, "'first': Input should be a valid string"),
        (
            "combine",
            {"first": "x" * 201, "second": 1},
            "'first': String should have at most 200 characters",
        ),
        ("combine", {}, "'first': Field required; 'second': Field required."),
        (
            "combine",
            {"first": 1, "second": 2, "third": 3},
            "unknown argument 'third': expected game, first, second.",
        ),
        ("begin", {"task": 10**6}, "less than or equal to 62"),
        ("begin", {"task": -1}, "greater than or equal to 0"),
        ("begin", {"task": 1.5}, "a valid integer"),
        ("begin", {"task": None}, "a valid integer"),
        (
            "state",
            {"game": "elsewhere"},
            "Unknown game id 'elsewhere': expected an id returned by `begin`",
        ),
        ("fly", {}, "Unknown tool: fly"),
    )

    async def play(call):
        game = (await call("begin", task=1))[1]["game"]
        for tool, arguments, expected in invalid:
            text, values = await call(
                tool, **({} if tool == "begin" else {"game": game}) | arguments
            )
            assert (expected in text, "pydantic" in text, values) == (True, False, None), text
            assert text.endswith("Please answer again.") == (tool in ("combine", "begin"))
        assert (await call("state", game=game))[1]["attempts_left"] == 1
        await call("end", game=game)
        over = await call("combine", game=game, first=1, second=2)
        assert over == ("This game is over. The game was ended early. Start a new game.", None)

    play_by_tools(hosted(), play)


@pytest.mark.parametrize(
    ("table", "key", "value"),
    [
        (PROMPTS, "likely_partners", "x"),
        (vars(mcp_server), "MAX_SIZE", 7),
        (vars(mcp_server), "_INSTRUCTIONS", "x"),
    ],
)
def test_the_hash_covers_game_prompts_tool_schemas_and_instructions(monkeypatch, table, key, value):
    before = tools_hash()
    monkeypatch.setitem(table, key, value)
    assert tools_hash.__wrapped__() != before


def test_the_open_ended_world_has_no_tasks_and_no_goal(opened_kitchen):
    pair = next(
        pair
        for pair in opened_kitchen.graph.outcomes
        if {*pair} <= {*opened_kitchen.graph.base_ids.tolist()}
    )
    one, other = opened_kitchen.graph.labels(pair)

    async def play(client):
        (tool,) = (tool for tool in (await client.list_tools()).tools if tool.name == "begin")
        assert tool.input_schema["properties"] == {}
        _, begun = await called(client, "begin")
        assert (begun["goal"], begun["success"], begun["attempts_left"]) == (None, None, 4)
        attempt = {"game": begun["game"], "first": one, "second": other}
        _, made = await called(client, "combine", **attempt)
        assert made["new"] == list(opened_kitchen.graph.labels(opened_kitchen.graph.outcomes[pair]))
        assert made["items"] == begun["items"] + made["new"]
        text, again = await called(client, "combine", **attempt)
        assert text.startswith(f"{one} + {other} -> nothing new (already tried)")
        assert again["new"] == []

    games = DiscoveryGames(opened_kitchen, attempts=4, max_invalid=NEVER)
    connect(make_server(HostedGames(games)), play)


def test_finished_games_are_forgotten_first_then_the_oldest(tmp_path):
    """Finished games are forgotten first then the oldest which are recorded."""
    host = HostedGames(hosted().play, most=3)
    with games_writer(path := tmp_path / "games.jsonl", header_of(host)) as host.keep:
        names = [host.begin(task).name for task in range(3)]
        host.game(names[0])  # the game played last
        host.game(names[2]).end()
        names += [host.begin(task).name for task in (3, 4)]
    assert [host.game(name).name for name in (names[0], *names[3:])] == [names[0], *names[3:]]
    for name in names[1:3]:
        with pytest.raises(EpisodeError):
            host.game(name)
    assert [(one.task, one.messages[1]) for one in games_of(path)] == [
        (task, "end") for task in (2, 1)
    ]


def test_messages_of_a_game_have_a_limit_and_are_gone_with_the_record(monkeypatch):
    monkeypatch.setattr(conversation, "MOST_CHARACTERS", 1_000)
    game = hosted().begin()
    for _ in range(20):
        assert game.combine("x" * 200, "1").startswith("Invalid answer: unknown item")
    assert len(game.messages) == 5
    game.end()
    assert game.messages == []


def header_of(host):
    return GamesHeader(player="clients", settings=host.play.settings)


def games_of(path):
    return read_games(path)[1]


def test_each_game_that_is_over_is_in_the_file_once_and_the_file_goes_on(tmp_path):
    path, host = tmp_path / "new" / "games.jsonl", hosted()
    header = header_of(host)
    with games_writer(path, header) as host.keep:
        first = host.begin(5, distractor_seed=2)
        host.begin(6)  # never played
        invalid = first.combine("unicorn", "1").partition("\n\n")[0]
        first.combine("1", "1")
        first.end()
        with (
            pytest.raises(ArtefactError, match="being written by another process"),
            games_writer(path, header),
        ):
            pass
    with games_writer(path, header) as host.keep:
        host.begin(7).end()
    one, two = games_of(path)
    thing = one.table[0]
    assert (one.task, one.distractor_seed, one.invalid_actions) == (5, 2, 1)
    assert invalid.startswith("Invalid answer: unknown item 'unicorn'")
    assert one.messages[1:4] == ("unicorn + 1", invalid, "1 + 1")
    assert one.messages[4].startswith(f"{thing} + {thing} -> ")
    assert one.messages[4].endswith(f"You have no attempts left. You did not make {one.goal}.")
    assert (two.task, two.actions, two.messages[1:]) == (7, 0, ("end", "The game was ended early."))


def test_a_record_that_cannot_be_written_is_an_error_and_written_later(tmp_path, monkeypatch):
    path, host = tmp_path / "games.jsonl", hosted()

    def full(file):
        raise OSError(28, "No space left on device")

    async def play(call):
        game = (await call("begin", task=0))[1]["game"]
        with monkeypatch.context() as patched:
            patched.setattr("os.fsync", full)
            text, values = await call("combine", game=game, first=1, second=1)
        assert "its record could not be saved: No space left on device" in text
        assert (values, path.read_bytes()) == (None, before)
        await call("end", game=game)

    with games_writer(path, header_of(host)) as host.keep:
        before = path.read_bytes()
        play_by_tools(host, play)
    (line,) = games_of(path)
    assert (line.task, line.actions) == (0, 2)


def test_a_file_without_games_is_refused_and_not_even_touched(tmp_path):
    path, host = tmp_path / "run.json", hosted()
    path.write_text('{"kind": "train-agent"}\n')
    before = path.stat().st_mtime_ns
    with pytest.raises(ArtefactError, match="is damaged"), games_writer(path, header_of(host)):
        pass
    assert path.stat().st_mtime_ns == before


async def transcript(call, task):
    """Play a task and return all replies without the game's id."""
    text, begun = await call("begin", task=task, distractor_seed=1)
    game = begun["game"]
    invalid = await call("combine", game=game, first="nonsense", second=1)
    replies = [
        (text.replace(game, ""), begun),
        invalid,
        await call("combine", game=game, first=2, second=1),
    ]
    replies.append(await call("state", game=game))
    return [(text, {**(values or {}), "game": ""}) for text, values in replies]


def transcripts(tasks):
    async def play(client):
        return [await transcript(partial(called, client), task) for task in tasks]

    return play


def played_alone(tasks):
    return connect(make_server(hosted()), transcripts(tasks))


@pytest.mark.slow
def test_the_same_game_is_played_by_another_process_on_standard_streams(tmp_path):
    path = {"PYTHONPATH": str(ROOT), "PYTHONHASHSEED": "7"}
    command = StdioServerParameters(command=sys.executable, args=COMMAND, env=path, cwd=tmp_path)
    assert connect(command, transcripts((0, 40)), "legacy") == played_alone((0, 40))


def test_a_client_that_leaves_within_its_request_is_no_error(caplog):
    """200 such clients wrote 200 tracebacks."""
    head = b"POST /mcp HTTP/1.1\r\nHost: localhost\r\nContent-Length: 100\r\n"
    head += b"Content-Type: application/json\r\nAccept: application/json, text/event-stream\r\n\r\n"
    with served(hosted()) as address:
        port = int(address.split(":")[2].removesuffix("/mcp"))
        with socket.create_connection(("127.0.0.1", port)) as connection:
            connection.sendall(head + b"{")
            time.sleep(0.5)  # until the server waits for the rest
        time.sleep(0.5)
    assert [record.message for record in caplog.records if record.exc_info] == []


@pytest.mark.slow
def test_over_http_bad_requests_are_refused():
    """Over http malformed long and foreign requests are refused and the server goes on."""

    def status_of(body, path="/mcp", **headers):
        given = {
            "Content-Type": "application/json",
            "Accept": "application/json, text/event-stream",
        }
        given |= {name.replace("_", "-"): value for name, value in headers.items()}
        answer = httpx2.post(address.replace("/mcp", path), content=body, headers=given, timeout=20)
        return answer.status_code, answer.text

    with served(hosted()) as address:
        for body in (b"nonsense", b"", b"[" * 60_000, b'{"jsonrpc": "2.0"}', b"\xff"):
            status, text = status_of(body)
            assert (status, "error" in json.loads(text)) == (400, True), (body[:20], text)
        assert status_of(b"x" * 70_000)[0] == 413
        assert status_of(HELLO, Host="elsewhere.org")[0] == 421
        assert status_of(HELLO, Origin="http://elsewhere.org")[0] == 403
        assert status_of(HELLO, Content_Type="text/plain")[0] == 400
        assert status_of(HELLO, "/other")[0] == 404
        for method in ("GET", "DELETE", "PUT"):
            answer = httpx2.request(
                method, address, headers={"Accept": "text/event-stream"}, timeout=20
            )
            assert answer.status_code == 405
        status, text = status_of(HELLO)
        assert (status, json.loads(text)["result"]["serverInfo"]["name"]) == (200, "wordcraft-kg")


@pytest.mark.parametrize("mode", MODES)
def test_over_http_a_game_goes_on_in_another_connection(mode):
    with served(hosted()) as address:
        _, begun = connect(address, lambda client: called(client, "begin", task=0), mode)
        _, state = connect(
            address, lambda client: called(client, "state", game=begun["game"]), mode
        )
    assert (state["game"], state["attempts_left"]) == (begun["game"], 1)


def test_bad_options_are_refused_before_anything_is_served(run, tmp_path):
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        for options, setting, fragment in (
            (
                ["--transport", "http", "--port", taken.getsockname()[1]],
                "port",
                "is in use by another program",
            ),
            (["--json"], "", "stdout is reserved for the protocol"),
            (["--scorer", tmp_path], "knowledge", "expected scorer with a model folder"),
            (["--open-ended", "--base", "unicorn"], "base", "no entity 'unicorn' in kitchen"),
        ):
            outcome = run("mcp", "kitchen", *options)
            assert (outcome.code, outcome.setting, fragment in outcome.err) == (1, setting, True), (
                options
            )
