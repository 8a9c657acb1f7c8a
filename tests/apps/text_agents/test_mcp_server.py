"""The MCP server, asked by the SDK's own client: in this process, on standard streams, and over HTTP."""

import asyncio
import json
import os
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Awaitable, Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import httpx2
import pytest

pytest.importorskip("mcp.server")

from mcp.client.client import Client
from mcp.client.stdio import StdioServerParameters
from mcp.server import MCPServer

from tests.apps.text_agents.scripted import assert_same, picks_of
from wordcraft_kg.agents.evaluation import Evaluator
from wordcraft_kg.agents.players import random_distinct
from wordcraft_kg.apps.text_agents.conversation import Play
from wordcraft_kg.apps.text_agents.games import TaskGames
from wordcraft_kg.apps.text_agents.hosted_games import NEVER, HostedGames, kept_games
from wordcraft_kg.apps.text_agents.knowledge import ScorerKnowledge
from wordcraft_kg.apps.text_agents.mcp_server import make_http_app, make_server, tools_hash
from wordcraft_kg.apps.text_agents.records import GamesHeader, PlayedSettings, PlayedTask, PlayedWorld
from wordcraft_kg.apps.text_agents.results import evaluation_of, record_of
from wordcraft_kg.apps.text_agents.settings import GameSettings
from wordcraft_kg.apps.web.serving import listen
from wordcraft_kg.base.errors import ArtefactError, EpisodeError, LeakError
from wordcraft_kg.base.records import parse_lines
from wordcraft_kg.envs.config import WordCraftConfig
from wordcraft_kg.envs.world import World
from wordcraft_kg.graphs.folder import OpenedGraph
from wordcraft_kg.models.scorers.baselines import FrequencyScorer

ROOT = Path(__file__).parents[3]
MODES = ("legacy", "auto")
COMMAND = ["-m", "wordcraft_kg", "mcp", "kitchen", "--distractors", "3"]
CLIENT = {"protocolVersion": "2025-06-18", "capabilities": {}, "clientInfo": {"name": "test", "version": "1"}}
HELLO = json.dumps({"jsonrpc": "2.0", "id": 7, "method": "initialize", "params": CLIENT}).encode()


@pytest.fixture(scope="module")
def world(kitchen: OpenedGraph) -> World:
    return World(kitchen, WordCraftConfig(part="test", num_distractors=3))


def hosted(**options: Any) -> HostedGames:
    settings = GameSettings(**({"distractors": 3} if "open_ended" not in options else {}), **options)
    return HostedGames(Play.open("kitchen", settings, refusals=NEVER, texts=tools_hash()))


def asked(server: Any, ask: Callable[[Client], Any], mode: str = "auto") -> Any:
    """Connect to a server and ask it something."""

    async def connected() -> Any:
        async with Client(server, mode=mode) as client:
            return await ask(client)

    return asyncio.run(connected())


async def called(client: Client, tool: str, **arguments: Any) -> tuple[str, dict[str, Any] | None]:
    """Call a tool; return its text and values, which are None if it was refused."""
    result = await client.call_tool(tool, arguments)
    (content,) = result.content
    assert result.is_error == (result.structured_content is None)
    return content.text, result.structured_content


@contextmanager
def served(server: MCPServer[Any]) -> Iterator[str]:
    """Serve over HTTP in a thread of this process."""
    import uvicorn

    listening = listen("127.0.0.1", 0)
    web = uvicorn.Server(uvicorn.Config(make_http_app(server), log_config=None, timeout_graceful_shutdown=1))
    thread = threading.Thread(target=web.run, kwargs={"sockets": [listening]})
    thread.start()
    try:
        yield f"http://127.0.0.1:{listening.getsockname()[1]}/mcp"
    finally:
        web.should_exit = True
        thread.join()
        listening.close()


# --- playing ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("mode", MODES)
def test_a_scripted_player_that_plays_by_tools_has_its_evaluation_to_the_last_digit(world: World, mode: str):
    slots = picks_of(random_distinct, world, 1)
    expected = Evaluator(world, draws=1)(random_distinct)
    host, played = hosted(), []
    host.keep = lambda over: played.append(record_of(over.talk, over.messages))

    async def play(client: Client) -> None:
        for task in range(len(world.tasks)):
            _, begun = await called(client, "begin", task=task)
            one, other = slots[task, 0]
            _, over = await called(client, "combine", game=begun["game"], first=one + 1, second=begun["things"][other])
            assert over["is_over"]

    asked(make_server(host), play, mode)
    assert_same(evaluation_of(played), expected)
    assert 0 < expected.success.mean() < 1


@pytest.mark.parametrize("mode", MODES)
def test_a_game_is_told_in_words_and_in_values(world: World, mode: str):
    one, other, goal = world.tasks[0].plans[0][0]
    made_of = ", ".join(world.graph.labels(world.graph.outcomes[world.graph.id_of(one), world.graph.id_of(other)]))

    async def play(client: Client) -> None:
        text, begun = await called(client, "begin", task=0)
        assert (begun["goal"], begun["rules"] in text) == (goal, True)
        assert text.endswith("Attempts left: 1")
        game = begun["game"]
        text, listed = await called(client, "known", game=game)
        assert text == ", ".join(f"{number} {thing}" for number, thing in enumerate(begun["things"], 1))
        assert (listed["attempts"], listed["success"], listed["is_over"]) == ([], None, False)
        text, made = await called(client, "combine", game=game, first=f"the {one.upper()}", second=other)
        assert text == f"{one} + {other} -> {made_of}\n\nYou made {goal}."
        assert (made["success"], made["attempts_left"], made["is_over"]) == (True, 0, True)
        text, state = await called(client, "state", game=game)
        assert (text, state) == (f"You made {goal}.", {key: made[key] for key in state})
        assert (await called(client, "known", game=game))[1]["attempts"] == [made["result"]]

    asked(make_server(hosted()), play, mode)


def test_what_is_not_understood_is_a_tools_error_that_costs_nothing():
    async def play(client: Client) -> None:
        _, begun = await called(client, "begin", task=1)
        game = begun["game"]
        for first, said in (
            ("unicorn", "'unicorn': expected 1 to 5, one of the words"),
            (6, "'6': expected 1 to 5"),
            ("", "nothing written: expected 1 to 5"),
            (True, "'first': Input should be a valid string"),
            (["1"], "'first': Input should be a valid string"),
            (10**40, "'first': Input should be a valid string"),
            ("x" * 201, "'first': String should have at most 200 characters"),
        ):
            text, values = await called(client, "combine", game=game, first=first, second=1)
            assert text.startswith(f"Not understood: {said}"), text
            assert (text.endswith("Nothing was lost; answer again."), values) == (True, None)
        text, _ = await called(client, "combine", game=game)
        assert text.startswith("Not understood: 'first': Field required; 'second': Field required.")
        for task, said in (
            (True, "a truth value is no number"),
            (10**6, "less than or equal to 62"),
            (-1, "greater than or equal to 0"),
            (1.5, "a valid integer"),
            (None, "a valid integer"),
        ):
            text, values = await called(client, "begin", task=task)
            assert (said in text, "pydantic" in text, values) == (True, False, None)
        assert await called(client, "fly", game=game) == ("Unknown tool: fly", None)
        text, values = await called(client, "state", game="elsewhere")
        assert text.startswith("There is no game 'elsewhere': expected the id that `begin` returned")
        assert (await called(client, "state", game=game))[1]["attempts_left"] == 1
        await called(client, "end", game=game)
        text, values = await called(client, "combine", game=game, first=1, second=2)
        assert (text, values) == ("This game is over. The game was ended. Begin another one.", None)

    asked(make_server(hosted()), play)


def test_the_open_ended_world_has_no_tasks_and_no_goal(kitchen: OpenedGraph):
    host = hosted(open_ended=True, attempts=4)
    pair = next(pair for pair in kitchen.graph.outcomes if {*pair} <= {*kitchen.graph.base_ids.tolist()})
    one, other = kitchen.graph.labels(pair)

    async def play(client: Client) -> None:
        (tool,) = (tool for tool in (await client.list_tools()).tools if tool.name == "begin")
        assert tool.input_schema["properties"] == {}
        _, begun = await called(client, "begin")
        assert (begun["goal"], begun["success"], begun["attempts_left"]) == (None, None, 4)
        _, made = await called(client, "combine", game=begun["game"], first=one, second=other)
        assert made["new"] == list(kitchen.graph.labels(kitchen.graph.outcomes[pair]))
        assert made["things"] == begun["things"] + made["new"]
        text, again = await called(client, "combine", game=begun["game"], first=one, second=other)
        assert text.startswith(f"{one} + {other} -> nothing new (tried before)")
        assert again["new"] == []

    asked(make_server(host), play)


def test_look_ups_cost_no_attempt_are_counted_and_only_there_if_something_can_be_looked_up():
    async def names(client: Client) -> list[str]:
        return [tool.name for tool in (await client.list_tools()).tools]

    async def play(client: Client) -> None:
        assert "look_up" in await names(client)
        game = (await called(client, "begin", task=0))[1]["game"]

        async def look_up(thing: str) -> tuple[str, dict[str, Any] | None]:
            return await called(client, "look_up", game=game, thing=thing)

        text, facts = await look_up("the Bread")
        assert text == "Of bread is known:\n" + "\n".join(facts["facts"])
        assert (facts["thing"], facts["look_ups_left"]) == ("bread", 1)
        assert "expected one of the words" in (await look_up("unicorn"))[0]
        assert (await look_up("water"))[1]["look_ups_left"] == 0
        assert (await look_up("water"))[1] is None
        assert (await called(client, "state", game=game))[1]["attempts_left"] == 1

    assert "look_up" not in asked(make_server(hosted()), names)
    asked(make_server(hosted(knowledge="partial", look_ups=2)), play)


def test_what_a_scorer_remembers_is_refused_before_somebody_plays(kitchen: OpenedGraph):
    train = World(kitchen, WordCraftConfig(part="train"))
    scorer = FrequencyScorer(kitchen.graph, kitchen.split.partial)
    with pytest.raises(LeakError):
        Play(TaskGames(train), PlayedSettings.of_tasks(train), ScorerKnowledge(scorer, kitchen.split))


def test_rules_facts_and_things_can_be_read_and_tell_no_recipe(world: World, kitchen: OpenedGraph):
    async def read(client: Client) -> list[str]:
        found = [str(resource.uri) for resource in (await client.list_resources()).resources]
        assert found == ["wordcraft://rules", "wordcraft://book", "wordcraft://things"]
        (prompt,) = (await client.list_prompts()).prompts
        said = (await client.get_prompt(prompt.name, {"task": "7"})).messages[0].content.text
        assert (prompt.name, "Begin task 7" in said) == ("play", True)
        assert prompt.arguments[0].description.startswith("number of the task, 0 to ")
        return [(await client.read_resource(uri)).contents[0].text for uri in found]

    rules, book, things = asked(make_server(hosted()), read)
    assert rules.startswith("This is a game of crafting.")
    assert things.splitlines() == list(kitchen.graph.entities)
    facts = json.loads(book)
    assert (facts["name"], facts["tasks"], facts["split_hash"]) == ("kitchen", len(world.tasks), kitchen.split.hash)
    assert "->" not in book


def test_the_oldest_games_are_forgotten_and_others_go_on():
    host = hosted()
    host._most = 3
    names = [host.begin(task).name for task in range(3)]
    host.game(names[0])  # it was played last
    host.begin(3)
    assert host.game(names[0]).name == names[0]
    with pytest.raises(EpisodeError):
        host.game(names[1])


# --- keeping ---------------------------------------------------------------------------------------------------------


def header_of(host: HostedGames) -> GamesHeader:
    return GamesHeader(player="clients", settings=host.play.settings)


def test_each_game_that_is_over_is_in_the_file_once_and_the_file_goes_on(tmp_path: Path):
    path, host = tmp_path / "new" / "games.jsonl", hosted()
    header = header_of(host)
    with kept_games(path, header) as host.keep:
        first = host.begin(5, draw=2)
        host.begin(6)  # never played
        with pytest.raises(ValueError, match="unicorn"):
            first.combine("unicorn", "1")
        first.combine("1", "1")
        first.end()
        with pytest.raises(ArtefactError, match="being written by another process"), kept_games(path, header):
            pass
    with kept_games(path, header) as host.keep:
        host.begin(7).end()
    one, two = parse_lines(path.read_bytes().partition(b"\n")[2], PlayedTask, path)
    thing = one.table[0]
    assert (one.task, one.draw, one.success, one.ending, one.refused) == (5, 2, False, "same_twice", 1)
    refusal = "'unicorn': expected 1 to 5, one of the words, or the beginning of one."
    assert one.messages[1:4] == ("unicorn + 1", refusal, "1 + 1")
    assert one.messages[4].startswith(f"{thing} + {thing} -> ")
    assert one.messages[4].endswith(f"No attempt is left; {one.goal} was not made.")
    assert (two.task, two.picks, two.messages[1:]) == (7, 0, ("end", "The game was ended."))


def test_a_record_that_cannot_be_written_is_said_and_written_later(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    path, host = tmp_path / "games.jsonl", hosted()

    def full(file: int) -> None:
        raise OSError(28, "No space left on device")

    async def play(client: Client) -> None:
        _, begun = await called(client, "begin", task=0)
        with monkeypatch.context() as patched:
            patched.setattr("os.fsync", full)
            text, values = await called(client, "combine", game=begun["game"], first=1, second=1)
        assert "its record could not be written: No space left on device" in text
        assert (values, path.read_bytes()) == (None, before)
        await called(client, "end", game=begun["game"])

    with kept_games(path, header_of(host)) as host.keep:
        before = path.read_bytes()
        asked(make_server(host), play)
    (line,) = parse_lines(path.read_bytes().removeprefix(before), PlayedTask, path)
    assert (line.task, line.picks) == (0, 2)


def test_games_in_the_open_ended_world_are_numbered_as_they_end(tmp_path: Path):
    path, host = tmp_path / "games.jsonl", hosted(open_ended=True, attempts=2)
    for _ in range(2):
        with kept_games(path, header_of(host)) as host.keep:
            game = host.begin()
            game.combine("1", "1")
            game.combine("1", "2")
    played = parse_lines(path.read_bytes().partition(b"\n")[2], PlayedWorld, path)
    assert [(one.game, len(one.known_after)) for one in played] == [(0, 2), (1, 2)]


# --- transports ------------------------------------------------------------------------------------------------------


Call = Callable[..., Awaitable[tuple[str, dict[str, Any] | None]]]


async def transcript(call: Call, task: int) -> list[Any]:
    """Play a task and return all that was told, but for the game's id."""
    text, begun = await call("begin", task=task, draw=1)
    assert begun is not None
    game = begun["game"]
    told = [(text.replace(game, ""), begun)]
    for tool, arguments in (
        ("combine", {"first": "nonsense", "second": 1}),
        ("known", {}),
        ("combine", {"first": 2, "second": 1}),
        ("state", {}),
    ):
        told.append(await call(tool, game=game, **arguments))
    return [(text, {**(values or {}), "game": ""}) for text, values in told]


def transcripts(tasks: Sequence[int]) -> Callable[[Client], Awaitable[list[Any]]]:
    async def play(client: Client) -> list[Any]:
        return [await transcript(partial(called, client), task) for task in tasks]

    return play


def played_alone(tasks: Sequence[int]) -> Any:
    return asked(make_server(hosted()), transcripts(tasks))


@contextmanager
def running(*options: str) -> Iterator[subprocess.Popen[bytes]]:
    """Run the command in another process."""
    pipes = dict.fromkeys(("stdin", "stdout", "stderr"), subprocess.PIPE)
    process = subprocess.Popen(
        [sys.executable, *COMMAND, *options], cwd=ROOT, env={**os.environ, "PYTHONPATH": str(ROOT)}, **pipes
    )
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


@pytest.mark.slow
def test_a_hundred_sessions_at_once_over_http_go_like_each_alone():
    tasks = [number % 63 for number in range(100)]

    async def together(address: str) -> list[Any]:
        # The SDK's client compiles the schemas of all tools for each session: that would take most of the time.
        async def call(tool: str, **arguments: Any) -> tuple[str, dict[str, Any] | None]:
            asks = {"jsonrpc": "2.0", "id": 1, "method": "tools/call", "params": {"name": tool, "arguments": arguments}}
            answer = await web.post(address, json=asks, headers={"Accept": "application/json, text/event-stream"})
            result = answer.json()["result"]
            return result["content"][0]["text"], result.get("structuredContent")

        async with httpx2.AsyncClient(limits=httpx2.Limits(max_connections=len(tasks))) as web:
            return await asyncio.gather(*(transcript(call, task) for task in tasks))

    with served(make_server(hosted())) as address:
        found = asyncio.run(together(address))
    assert found == played_alone(tasks)


def test_clients_of_both_versions_of_the_protocol_play_at_once_over_http():
    async def together(address: str) -> list[Any]:
        async def session(task: int) -> list[Any]:
            async with Client(address, mode=MODES[task % 2]) as client:
                return await transcript(partial(called, client), task)

        return await asyncio.gather(*(session(task) for task in range(4)))

    with served(make_server(hosted())) as address:
        found = asyncio.run(together(address))
    assert found == played_alone(range(4))


def test_the_same_game_is_played_by_another_process_on_standard_streams(tmp_path: Path):
    path = {"PYTHONPATH": str(ROOT), "PYTHONHASHSEED": "7"}
    command = StdioServerParameters(command=sys.executable, args=COMMAND, env=path, cwd=tmp_path)
    assert asked(command, transcripts((0, 40)), "legacy") == played_alone((0, 40))


@pytest.mark.slow
def test_malformed_messages_on_stdin_are_passed_over_and_ctrl_c_ends_the_server():
    lines = (b"nonsense", b'{"jsonrpc": "2.0"}', b'"\xff\xfe"', b"[" * 100_000, b"x" * 3_000_000, HELLO)
    with running() as process:
        process.stdin.write(b"".join(line + b"\n" for line in lines))  # type: ignore[union-attr]
        process.stdin.flush()  # type: ignore[union-attr]
        begun = json.loads(process.stdout.readline())  # type: ignore[union-attr]
        assert (begun["id"], begun["result"]["serverInfo"]["name"]) == (7, "wordcraft-kg")
        process.send_signal(signal.SIGINT)
        assert process.communicate(timeout=20)[0] == b""
        assert process.returncode == -signal.SIGINT


def posted(address: str, body: bytes, **headers: str) -> tuple[int, str]:
    kind = {"Content-Type": "application/json", "Accept": "application/json, text/event-stream"}
    given = {name.replace("_", "-"): value for name, value in headers.items()}
    answer = httpx2.post(address, content=body, headers=kind | given, timeout=20)
    return answer.status_code, answer.text


def test_over_http_what_is_malformed_too_long_or_of_another_site_is_refused_and_the_server_goes_on():
    with served(make_server(hosted())) as address:
        for version in ({}, {"MCP_Protocol_Version": "2026-07-28"}):
            for body in (b"nonsense", b"", b"[" * 60_000, b'{"jsonrpc": "2.0"}', b'{"id": 1, "method": 5}', b"\xff"):
                status, text = posted(address, body, **version)
                assert (status, "error" in json.loads(text)) == (400, True), (body[:20], text)
        assert posted(address, b"x" * 70_000)[0] == 413
        assert posted(address, HELLO, Host="elsewhere.org")[0] == 421
        assert posted(address, HELLO, Origin="http://elsewhere.org")[0] == 403
        assert posted(address, HELLO, Content_Type="text/plain")[0] == 400
        assert posted(address.replace("/mcp", "/other"), HELLO)[0] == 404
        status, text = posted(address, HELLO)
        assert (status, json.loads(text)["result"]["serverInfo"]["name"]) == (200, "wordcraft-kg")


@pytest.mark.parametrize("mode", MODES)
def test_over_http_a_game_goes_on_in_another_connection(mode: str):
    with served(make_server(hosted())) as address:

        async def begin(client: Client) -> str:
            return str((await called(client, "begin", task=0))[1]["game"])

        game = asked(address, begin, mode)
        _, state = asked(address, lambda client: called(client, "state", game=game), mode)
    assert (state["game"], state["attempts_left"]) == (game, 1)


# --- the command -----------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_the_command_serves_over_http_and_what_was_answered_is_kept_though_it_is_killed(tmp_path: Path):
    out = tmp_path / "games.jsonl"
    with running("--transport", "http", "--port", "0", "--json", "--out", str(out)) as process:

        async def play(client: Client) -> None:
            _, begun = await called(client, "begin", task=3)
            await called(client, "combine", game=begun["game"], first=1, second=1)
            process.send_signal(signal.SIGKILL)  # what was answered is on the disk

        asked(json.loads(process.stdout.readline())["address"], play)  # type: ignore[union-attr]
    (line,) = parse_lines(out.read_bytes().partition(b"\n")[2], PlayedTask, out)
    assert (line.task, line.ending) == (3, "same_twice")


def test_bad_options_are_refused_before_anything_is_served(run: Any, tmp_path: Path):
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        for options, said in (
            (["--transport", "http", "--port", port], f"--port {port} is in use by another program"),
            (["--json"], "--json: on stdio the output belongs to the protocol"),
            (["--scorer", tmp_path], "only --knowledge scorer asks one"),
            (["--base", "water"], "tasks have no base; add --open-ended"),
            (["--open-ended", "--depth", "2"], "--open-ended has no tasks"),
            (["--open-ended", "--base", "unicorn"], "--base: no entity 'unicorn' in kitchen"),
            (["--attempts", "0"], "--attempts 0"),
        ):
            outcome = run("mcp", "kitchen", *options)
            assert (outcome.code, said in outcome.err) == (1, True), options


def test_without_its_package_the_command_names_the_extra(run: Any, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("wordcraft_kg.base.extras.find_spec", lambda name: None)
    outcome = run("mcp", "kitchen")
    assert (outcome.code, outcome.kind) == (1, "MissingExtraError")
    assert "pip install 'wordcraft-kg[mcp]'" in outcome.err
