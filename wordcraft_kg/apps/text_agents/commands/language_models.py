"""``wordcraft-kg chats``, ``mcp`` and ``serve openenv``: games for language models."""

import signal
import sys
from contextlib import ExitStack
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Parameter

from wordcraft_kg.apps.text_agents.settings import LOOK_UPS, KnowledgeKind, LookUps
from wordcraft_kg.base import (
    MAX_SIZE,
    ConfigError,
    check_output_file,
    counted,
    number_in,
    whole,
)
from wordcraft_kg.base.extras import check_extra
from wordcraft_kg.cli.console import Flag, Output, split_labels, whole_numbers
from wordcraft_kg.cli.options import Book, Force, Words
from wordcraft_kg.graphs import TaskPart, open_graph

if TYPE_CHECKING:
    from mcp.server import MCPServer

    from wordcraft_kg.apps.text_agents.plays import Play

GROUP = "Text agents"
SUBJECT = "Serve games to programs that train language models: openenv."
FILE_ONLY = {"serve openenv": ("--attempts", "--look-ups")}
EXAMPLES = {
    "chats": (
        "wordcraft-kg chats everyday --player oracle --out sft.jsonl",
        "wordcraft-kg chats everyday --depth 1,2,3,4 --player planner --keep shortest "
        "--out sft.jsonl",
        "wordcraft-kg chats kitchen --player scorer:models/kitchen --style text --out sft.jsonl",
    ),
    "mcp": (
        "wordcraft-kg mcp everyday --part test --distractors 8",
        "wordcraft-kg mcp kitchen --depth 2 --attempts 4 --transport http --out games.jsonl",
        "wordcraft-kg mcp everyday --open-ended --attempts 100",
        "wordcraft-kg mcp --track craft-8-lite --out games.jsonl",
    ),
    "serve openenv": (
        "wordcraft-kg serve openenv everyday --depth 1,2 --port 8000",
        "wordcraft-kg serve openenv everyday --part train,valid --distractors 2,8 "
        "--reward official",
        "wordcraft-kg serve openenv --track craft-8-lite --out games.jsonl",
    ),
}
_OWN_GAMES = "--track has its own games; omit the graph and the options of games but --knowledge."
_MOST_SESSIONS = 10_000
_LONGEST_IDLE = 86_400.0


def _kinds_of_games(
    depth: list[str] | None, distractors: list[str] | None
) -> list[tuple[int, int]]:
    """Return each depth with each number of distractors, from the options of these names."""
    return list(
        product(
            whole_numbers("depth", depth or ["1"]),
            whole_numbers("distractors", distractors or ["8"]),
        )
    )


def chats(  # noqa: PLR0913 - parameters are the command's options
    graph: Book = "everyday",
    *,
    out: Annotated[Path, Parameter(name=["--out"])],
    player: str = "oracle",
    depth: Words = None,
    distractors: Words = None,
    attempts: int | None = None,
    tables: int = 1,
    tasks: int | None = None,
    difficulty: str | None = None,
    keep: Literal["made", "shortest", "all"] = "made",
    style: Literal["tools", "text"] = "tools",
    mistakes: float = 0.0,
    reasons: Path | None = None,
    seed: int = 0,
    force: Force = False,
    output: Output = Output(),
) -> None:
    """Write a player's games as conversations to fine-tune language models on.

    Games are of train tasks alone, so that test tasks measure what was learned. A line is a
    conversation, in the messages format of TRL's SFTTrainer. The same command writes the same
    bytes.

    Args:
        graph: graph folder, recipe book or known book's name.
        out: file to write (JSON lines).
        player: oracle, planner (by the train recipes), votes, graph, nearest-words, random,
            planner:MODEL, scorer:MODEL or agent:RUN.
        depth: comma-separated depths of tasks, 1 to 5. Default: 1.
        distractors: comma-separated numbers of distractors on a table. Default: 8.
        attempts: attempts in a game. Default: the task's depth.
        tables: tables for each task, each with distractors of its own.
        tasks: most tasks for each depth and number of distractors, evenly spaced. Default: all.
        difficulty: least and largest difficulty of tasks, such as .2:.8: the share of games that
            nearest words, a learner and a planner lose; measured for everyday. Default: all.
        keep: games that made the goal (made), those of them in the fewest possible attempts
            (shortest), or all.
        style: calls of the tool combine (tools), or lines such as water + earth (text).
        mistakes: probability of a mistake before each attempt: an item that is not on the table, or
            a pair that makes nothing. Their places are in each line, so that a learner can skip
            them. With more attempts than the depth, games recover; else they are lost.
        reasons: model folder of train-recipes: an answer begins with the train recipes that make
            the model expect it, without its own recipe.
        seed: seed of the player, the tables, the wordings and the orders.
    """
    kinds = _kinds_of_games(depth, distractors)
    whole("seed", seed, 0, MAX_SIZE - 1)
    whole("tables", tables, 1, MAX_SIZE)
    number_in("mistakes", mistakes, 0, 0.9, "a probability from 0 to 0.9")
    from wordcraft_kg.apps.text_agents import benchmark_players, plays
    from wordcraft_kg.apps.text_agents.chats import (
        chat_rows,
        new_counts,
        recipe_scorer,
        write_chats,
    )

    check_output_file(out, force=force)
    source = open_graph(graph)
    games = [plays.open_play(graph, "train", *kind, attempts) for kind in kinds]
    title, played_by = benchmark_players.named_player(player, source, games[0].world.tasks)
    counts = new_counts()
    rows = chat_rows(
        games,
        played_by,
        counts,
        style=style,
        keep=keep,
        tables=tables,
        tasks=tasks,
        mistakes=mistakes,
        seed=seed,
        difficulty=plays.read_range(difficulty),
        scorer=None if reasons is None else recipe_scorer(reasons, source),
    )
    digest = write_chats(out, rows, force=force)
    view = {
        "out": str(out),
        "graph": source.graph.hash,
        "split": source.split.hash,
        "prompts": games[0].settings.prompt_hash,
        "player": title,
        "sha256": digest,
        "counts": counts,
    }
    output.result(
        view,
        [
            f"{counted(counts['written'], 'conversation')} of {counted(counts['played'], 'game')} "
            f"by {title}; left out: {counts['left_out']:,} not to be kept, "
            f"{counts['repeated']:,} repeated",
            f"wrote {out}",
        ],
    )


def mcp(  # noqa: PLR0913 - parameters are the command's options
    graph: Book = "everyday",
    *,
    part: TaskPart = "test",
    depth: int = 1,
    distractors: int = 8,
    attempts: int | None = None,
    open_ended: Flag = False,
    base: Words = None,
    knowledge: KnowledgeKind = "none",
    scorer: Path | None = None,
    look_ups: int = LOOK_UPS,
    track: str | None = None,
    transport: Literal["stdio", "http"] = "stdio",
    host: str = "127.0.0.1",
    port: int = 8765,
    allow_host: Annotated[list[str] | None, Parameter(negative=(), consume_multiple=False)] = None,
    out: Path | None = None,
    output: Output = Output(),
) -> None:
    """Serve games to language models as Model Context Protocol tools, until Ctrl-C.

    Clients start the server and use the standard streams, or connect over HTTP. Tasks and tables
    are the same as for agents.

    Args:
        graph: graph folder, recipe book or known book's name.
        part: tasks to play: train, valid, test or all.
        depth: fewest attempts that solve a task, 1 to 5.
        distractors: entities on the table that no plan needs.
        attempts: attempts in a game. Default: depth; 100 in the open-ended world.
        open_ended: discover as many entities as possible from the base, without tasks.
        base: comma-separated initial entities, with --open-ended. Default: the graph's base.
        knowledge: look-up source: none, partial (train recipes that do not make the goal from the
            table) or scorer (best links by --scorer).
        scorer: model folder, for --knowledge scorer.
        look_ups: look-ups in a game.
        track: track of the benchmark, such as craft-8-lite, instead of other games; fits with
            --knowledge only.
        transport: stdio, for a local client that starts the server, or http.
        host: address to listen on; any but 127.0.0.1, such as 0.0.0.0, opens the games to other
            machines.
        port: port to listen on; 0 selects a free port.
        allow_host: additional server name or address, as with --host 0.0.0.0 or a proxy;
            repeatable.
        out: file for finished games (JSON lines), which the same command continues.
    """
    # One foreign line on stdout, and the client cannot parse the protocol any more.
    if transport == "stdio" and output.json:
        raise ConfigError(
            "--json: stdout is reserved for the protocol; omit --json, or add --transport http."
        )
    open_ended = open_ended or base is not None
    if open_ended and (part, depth, distractors) != ("test", 1, 8):
        raise ConfigError("--open-ended has no tasks; omit --part, --depth and --distractors.")
    game_options = (graph, part, depth, distractors, attempts, open_ended, scorer, look_ups)
    defaults = ("everyday", "test", 1, 8, None, False, None, LOOK_UPS)
    if track is not None and game_options != defaults:
        raise ConfigError(_OWN_GAMES)
    check_extra("mcp")
    from wordcraft_kg.apps.text_agents import benchmark, conversation, mcp_server, plays, results
    from wordcraft_kg.apps.web.serving import listen, serve

    with ExitStack() as stack:
        # The port first: if it is taken, nobody waits for a graph and a model to load.
        listening = None
        if transport == "http":
            listening = stack.enter_context(listen(host, port))
        # Tools reject an invalid call, and the client asks again; so it never costs an attempt.
        rules: dict[str, Any] = {
            "max_invalid": conversation.NEVER,
            "knowledge": knowledge,
            "scorer": scorer,
            "look_ups": look_ups,
        }
        if track is not None:
            play = benchmark.open_track(track).play(**rules)
        elif open_ended:
            play = plays.DiscoveryGames(
                open_graph(graph),
                attempts=attempts,
                base=split_labels(base) if base else None,
                **rules,
            )
        else:
            play = plays.open_play(graph, part, depth, distractors, attempts, **rules)
        hosted = mcp_server.HostedGames(play)
        if out is not None:
            header = results.GamesHeader(player="MCP clients", settings=hosted.play.settings)
            hosted.keep = stack.enter_context(results.games_writer(out, header))
        server = mcp_server.make_server(hosted)
        if listening is None:
            _serve_stdio(server)
            return

        def started(address: str) -> None:
            output.result(
                {"address": address + mcp_server.PATH},
                [f"{address}{mcp_server.PATH}   Ctrl-C stops the server"],
            )

        serve(
            mcp_server.make_http_app(server, host, allow_host or ()),
            listening,
            started,
            has_lifespan=True,
        )


def _serve_stdio(server: "MCPServer[Any]") -> None:
    if sys.stdin is not None and sys.stdin.isatty():
        print(
            "Waiting for an MCP client on stdin and stdout; Ctrl-C stops the server.",
            file=sys.stderr,
        )
    # The SDK reads stdin in a thread that cannot be interrupted, so Python's own handler would
    # wait for it for ever.
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    try:
        server.run("stdio")
    except* BrokenPipeError:
        # The client has left without closing stdin.
        pass


def serve_openenv(  # noqa: PLR0913 - parameters are the command's options
    graph: Book = "everyday",
    *,
    part: Words = None,
    depth: Words = None,
    distractors: Words = None,
    attempts: int | None = None,
    difficulty: str | None = None,
    reward: Literal["sparse", "official"] = "sparse",
    knowledge: LookUps = "none",
    look_ups: int = LOOK_UPS,
    track: str | None = None,
    host: str = "127.0.0.1",
    port: int = 8000,
    allow_host: Annotated[list[str] | None, Parameter(negative=(), consume_multiple=False)] = None,
    sessions: int = 256,
    idle: float = 900.0,
    out: Path | None = None,
    output: Output = Output(),
) -> None:
    """Serve games to language models by OpenEnv, until Ctrl-C: TRL, verifiers and others connect.

    Each client has a session with a game of its own. The same task and seed give the same table,
    which is that of all other players.

    Args:
        graph: graph folder, recipe book or known book's name.
        part: comma-separated parts of the split that clients may play: train, valid, test, all.
            Tasks of other parts are refused. Default: train.
        depth: comma-separated depths of tasks, 1 to 5. Default: 1.
        distractors: comma-separated numbers of distractors on a table. Default: 8.
        attempts: attempts in a game. Default: the task's depth.
        difficulty: least and largest difficulty of tasks, such as .2:.8: the share of games that
            nearest words, a learner and a planner lose; measured for everyday. Default: all.
        reward: sparse (1 for the goal), or official (shaped as in the paper's released code).
        knowledge: look-up source: none, or partial (train recipes that do not make the goal from
            the table).
        look_ups: look-ups in a game.
        track: track of the benchmark, such as craft-8-lite, instead of other games; fits with
            --knowledge only.
        host: address to listen on; any but 127.0.0.1, such as 0.0.0.0, opens the games to other
            machines.
        port: port to listen on; 0 selects a free port.
        allow_host: additional server name or address, as with --host 0.0.0.0 or a proxy;
            repeatable.
        sessions: most sessions at a time, as far as the system permits so many open files.
        idle: seconds without a message after which a session ends.
        out: file for finished games (JSON lines), which the same command continues; for one part,
            depth and number of distractors.
    """
    whole("sessions", sessions, 1, _MOST_SESSIONS)
    number_in("idle", idle, 1, _LONGEST_IDLE, f"seconds, 1 to {_LONGEST_IDLE:,.0f}")
    # `open_play` checks the names.
    parts: list[Any] = list(dict.fromkeys(split_labels(part or ["train"])))
    kinds = _kinds_of_games(depth, distractors)
    game_options = (graph, part, depth, distractors, attempts, difficulty, reward, look_ups)
    if track is not None and game_options != (
        "everyday",
        None,
        None,
        None,
        None,
        None,
        "sparse",
        LOOK_UPS,
    ):
        raise ConfigError(_OWN_GAMES)
    if out is not None and len(parts) * len(kinds) > 1:
        raise ConfigError(
            "`out`: a file of games has one part, depth and number of distractors; give one of "
            "each, or leave --out out."
        )
    check_extra("openenv")
    from wordcraft_kg.apps.text_agents import benchmark, openenv_server, plays, results
    from wordcraft_kg.apps.web.serving import listen, most_web_sockets, serve

    # A quarter of the web sockets is for clients who are told that all sessions are taken.
    sessions = min(sessions, most_web_sockets() * 3 // 4)
    with ExitStack() as stack:
        # The port first: if it is taken, nobody waits for the tasks.
        listening = stack.enter_context(listen(host, port))
        games_by_part: dict[str, list[Play]] = {}
        if track is not None:
            games_by_part["test"] = [benchmark.open_track(track).play(knowledge)]
        else:
            for name in parts:
                games_by_part[name] = [
                    plays.open_play(graph, name, *kind, attempts, reward, knowledge, look_ups)
                    for kind in kinds
                ]
        games = plays.GameList(games_by_part, plays.read_range(difficulty))
        keep = None
        if out is not None:
            ((play,),) = games_by_part.values()
            header = results.GamesHeader(player="OpenEnv clients", settings=play.settings)
            keep = stack.enter_context(results.games_writer(out, header))
        app = openenv_server.make_openenv_app(
            games, keep=keep, sessions=sessions, idle=idle, host=host, more_hosts=allow_host or ()
        )

        def started(address: str) -> None:
            counts = {name: games.count(name) for name in games_by_part}
            offered = ", ".join(f"{count:,} {name} tasks" for name, count in counts.items())
            view = {"address": address, "tasks": counts, "sessions": sessions}
            text = f"{address}   {offered}, {sessions:,} sessions   Ctrl-C stops the server"
            output.result(view, [text])

        serve(app, listening, started, has_web_sockets=True)
