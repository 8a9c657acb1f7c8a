"""``wordcraft-kg mcp``."""

import sys
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Parameter

from wordcraft_kg.apps.text_agents.config import ATTEMPTS, LOOK_UPS, KnowledgeKind
from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.base.settings import MAX_SIZE, whole
from wordcraft_kg.cli.console import Flag, Output, split_labels
from wordcraft_kg.cli.options import Book, Scorer
from wordcraft_kg.envs.config import MAX_ATTEMPTS, WordCraftConfig
from wordcraft_kg.graphs.tasks import TaskPart

if TYPE_CHECKING:
    from wordcraft_kg.apps.text_agents.games import DiscoveryGames, TaskGames
    from wordcraft_kg.apps.text_agents.records import WordsSettings
    from wordcraft_kg.graphs.folder import OpenedGraph

    Games = TaskGames | DiscoveryGames

GROUP = "Players that use words"
EXAMPLES = (
    "wordcraft-kg mcp everyday --part test --distractors 8",
    "wordcraft-kg mcp kitchen --depth 2 --attempts 4 --transport http --out games.jsonl",
    "wordcraft-kg mcp everyday --open-ended --attempts 100",
)
PLAYER = "MCP clients"
List = Annotated[list[str] | None, Parameter(negative=(), consume_multiple=False)]


def mcp(
    graph: Book = "everyday",
    *,
    part: TaskPart = "test",
    depth: int = WordCraftConfig.depth,
    distractors: int = WordCraftConfig.num_distractors,
    attempts: int | None = None,
    open_ended: Flag = False,
    base: List = None,
    knowledge: KnowledgeKind = "none",
    scorer: Scorer = None,
    look_ups: int = LOOK_UPS,
    transport: Literal["stdio", "http"] = "stdio",
    host: str = "127.0.0.1",
    port: int = 8765,
    allow_host: List = None,
    out: Path | None = None,
    output: Output = Output(),
) -> None:
    """Let language models play by tools, as a server of the Model Context Protocol; Ctrl-C ends it.

    Clients start it themselves and talk to it on its standard streams, or ask it over HTTP, many at once. The tasks and
    tables are those on which agents are evaluated.

    Args:
        graph: graph folder, recipe book or known book's name.
        part: tasks to play: train, valid, test or all.
        depth: fewest attempts that solve a task, 1 to 5.
        distractors: entities on the table that no plan needs.
        attempts: attempts in a game. Default: depth; 100 in the open-ended world.
        open_ended: no tasks: discover as many entities as you can from the base.
        base: comma-separated entities known at the start of the open-ended world. Default: the graph's base.
        knowledge: what a player may look up: none, partial (the train recipes, but none that solves the task) or
            scorer (the best links of --scorer).
        scorer: model folder, for --knowledge scorer.
        look_ups: how often something may be looked up in a game.
        transport: stdio, for a client on this machine that starts the server, or http.
        host: address of this machine to listen on; others than 127.0.0.1, such as 0.0.0.0, open the games to others.
        port: port to listen on; 0 takes a free one.
        allow_host: a further name or address by which the server may be asked for, as with --host 0.0.0.0 or behind a
            proxy; several by several options.
        out: file for the games that are over (JSON lines). The same command goes on with it.
    """
    from wordcraft_kg.base.extras import check_extra

    if transport == "stdio" and output.json:
        raise ConfigError("--json: on stdio the output belongs to the protocol; leave it out, or add --transport http.")
    if base and not open_ended:
        raise ConfigError(f"--base {','.join(base)}: tasks have no base; add --open-ended.")
    fixed = (WordCraftConfig.depth, WordCraftConfig.num_distractors, "test")
    if open_ended and (depth, distractors, part) != fixed:
        raise ConfigError("--open-ended has no tasks; leave --part, --depth and --distractors out.")
    whole("look_ups", look_ups, 0, MAX_SIZE)
    check_extra("mcp")
    from wordcraft_kg.apps.text_agents.hosted_games import NEVER, HostedGames
    from wordcraft_kg.apps.text_agents.kept_games import kept_games
    from wordcraft_kg.apps.text_agents.knowledge import open_knowledge
    from wordcraft_kg.apps.text_agents.mcp_server import make_server, tools_hash
    from wordcraft_kg.apps.text_agents.mcp_serving import serve_http, serve_stdio
    from wordcraft_kg.apps.text_agents.records import GamesHeader
    from wordcraft_kg.apps.web.serving import Serving, listen
    from wordcraft_kg.graphs.folder import open_graph

    with ExitStack() as stack:
        listening = None
        if transport == "http":
            listening = listen(host, port)  # before the work
            stack.callback(listening.close)
        opened = open_graph(graph)
        known, scorer_hash, kg = open_knowledge(knowledge, opened, scorer)
        rules = {"knowledge": knowledge, "scorer": scorer_hash, "kg": kg, "look_ups": look_ups}
        rules |= {"refusals": NEVER, "texts": tools_hash()}
        if open_ended:
            games, settings = _worlds(opened, rules, attempts, base)
        else:
            if attempts is not None:
                whole("attempts", attempts, depth, MAX_ATTEMPTS)
            config = WordCraftConfig(part=part, depth=depth, num_distractors=distractors, max_attempts=attempts)
            games, settings = _tasks(opened, rules, config)
        hosted = HostedGames(games, settings, known)
        if out is not None:
            header = GamesHeader(player=PLAYER, settings=settings)
            hosted.keep = stack.enter_context(kept_games(out, header))
        server = make_server(hosted)
        if listening is None:
            if sys.stdin is not None and sys.stdin.isatty():
                print("An MCP client talks to this server on stdin and stdout; Ctrl-C ends it.", file=sys.stderr)
            serve_stdio(server)
            return

        def started(address: str) -> None:
            output.result(Serving(address), [f"{address}   Ctrl-C ends it"])
            sys.stdout.flush()

        serve_http(server, listening, host, allow_host or (), started)


def _tasks(opened: "OpenedGraph", rules: dict[str, Any], config: WordCraftConfig) -> "tuple[Games, WordsSettings]":
    from wordcraft_kg.apps.text_agents.games import TaskGames
    from wordcraft_kg.apps.text_agents.records import WordsSettings
    from wordcraft_kg.envs.world import World

    world = World(opened, config)
    return TaskGames(world), WordsSettings.of_tasks(world, **rules)


def _worlds(
    opened: "OpenedGraph", rules: dict[str, Any], attempts: int | None, base: list[str] | None
) -> "tuple[Games, WordsSettings]":
    from wordcraft_kg.apps.text_agents.games import DiscoveryGames
    from wordcraft_kg.apps.text_agents.records import WordsSettings

    labels = split_labels(base) if base else None
    whole("attempts", ATTEMPTS if attempts is None else attempts, 1, MAX_SIZE)
    games = DiscoveryGames(opened, attempts=ATTEMPTS if attempts is None else attempts, base=labels)
    return games, WordsSettings.of_world(games.env, opened.split, **rules)
