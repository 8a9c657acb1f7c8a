"""``wordcraft-kg mcp``."""

import signal
import sys
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Parameter

from wordcraft_kg.apps.text_agents.settings import GameSettings
from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.base.extras import check_extra
from wordcraft_kg.cli.console import Output
from wordcraft_kg.cli.options import Book

if TYPE_CHECKING:
    from mcp.server import MCPServer

GROUP = "Text agents"
EXAMPLES = (
    "wordcraft-kg mcp everyday --part test --distractors 8",
    "wordcraft-kg mcp kitchen --depth 2 --attempts 4 --transport http --out games.jsonl",
    "wordcraft-kg mcp everyday --open-ended --attempts 100",
    "wordcraft-kg mcp --track craft-8-lite --out games.jsonl",
)


def mcp(  # noqa: PLR0913 - parameters are the command's options
    graph: Book = "everyday",
    *,
    settings: Annotated[GameSettings, Parameter(name="*", group="Games")] = GameSettings(),
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
        settings: the games.
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
    if track is not None:
        has_own_games = settings != GameSettings(knowledge=settings.knowledge)
        if graph != "everyday" or has_own_games:
            raise ConfigError(
                "--track has its own games; omit the graph and the options of games "
                "but --knowledge."
            )
    check_extra("mcp")
    from wordcraft_kg.apps.text_agents.benchmark import open_track
    from wordcraft_kg.apps.text_agents.conversation import NEVER, Play
    from wordcraft_kg.apps.text_agents.game_records import GamesHeader
    from wordcraft_kg.apps.text_agents.hosted_games import HostedGames, games_writer
    from wordcraft_kg.apps.text_agents.mcp_server import (
        PATH,
        make_http_app,
        make_server,
        tools_hash,
    )
    from wordcraft_kg.apps.web.serving import listen, serve

    with ExitStack() as stack:
        # The port first: if it is taken, nobody waits for a graph and a model to load.
        listening = None
        if transport == "http":
            listening = stack.enter_context(listen(host, port))
        # Tools reject an invalid call, and the client asks again; so it never costs an attempt.
        rules: dict[str, Any] = {"max_invalid": NEVER}
        if track:
            play = open_track(track).play(settings.knowledge, **rules)
        else:
            play = Play.open(graph, settings, **rules)
        play = play.with_prompts(tools_hash(sets=play.games.has_sets))
        hosted = HostedGames(play)
        if out is not None:
            header = GamesHeader(player="MCP clients", settings=hosted.play.settings)
            hosted.keep = stack.enter_context(games_writer(out, header))
        server = make_server(hosted)
        if listening is None:
            _serve_stdio(server)
            return

        def started(address: str) -> None:
            output.result(
                {"address": address + PATH}, [f"{address}{PATH}   Ctrl-C stops the server"]
            )
            # A script may wait for the address on a pipe.
            sys.stdout.flush()

        serve(make_http_app(server, host, allow_host or ()), listening, started, has_lifespan=True)


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
