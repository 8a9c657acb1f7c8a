"""The crafting worlds as a server of the Model Context Protocol: tools to play, resources with rules and facts.

Connections have no memory in the present protocol, so each game has an id, which ``begin`` returns.
"""

import hashlib
import json
from collections.abc import Collection
from typing import Annotated, Any, Self

from mcp.server import MCPServer
from mcp.server.mcpserver import Context
from mcp.server.mcpserver.exceptions import ToolError
from mcp.server.mcpserver.resources import TextResource
from mcp.server.transport_security import TransportSecuritySettings
from mcp_types import CallToolResult, InputRequiredResult, TextContent, ToolAnnotations
from pydantic import BaseModel, BeforeValidator, Field, ValidationError
from starlette.types import ASGIApp

from wordcraft_kg import __version__
from wordcraft_kg.apps.text_agents.conversation import Play, facts_in_words
from wordcraft_kg.apps.text_agents.games import TaskGame, TaskGames
from wordcraft_kg.apps.text_agents.hosted_games import HostedGame, HostedGames
from wordcraft_kg.apps.web.guard import LONGEST_BODY, LOOPBACK
from wordcraft_kg.base.errors import ActionError, WordCraftKGError
from wordcraft_kg.base.records import as_values
from wordcraft_kg.base.settings import MAX_SIZE
from wordcraft_kg.envs.words import numbered, texts_hash, told

LONGEST = 200
"""Characters of a label or a game's id."""
PATH = "/mcp"
TOOLS = {
    "begin": "Begin a game and return its id, the rules and the state. Task {first} to {last}; draw chooses what else "
    "is on the table. The same task and draw are always the same game.",
    "begin_world": "Begin a game and return its id, the rules and the state. There is one world, the same for all.",
    "state": "Show where a game stands: the goal if there is one, what can be combined, and the attempts left.",
    "combine": "Make an attempt: combine two things, or a thing with itself. Give each by its word or its number. What "
    "is not understood is refused and costs nothing.",
    "known": "List what can be combined with its numbers, and the attempts so far with what came of them.",
    "look_up": "Look up what is known of a thing, by its word. It costs no attempt; {look_ups} times a game.",
    "end": "Give a game up.",
}
"""Descriptions of the tools for language models, in addition to :data:`~wordcraft_kg.envs.words.TEXTS`."""
PROMPTS = {
    "task": "Play a game of crafting. Begin task {task} and play until the game is over, with as few attempts as you "
    "can.",
    "world": "Play a game of crafting. Begin a game and play until it is over; discover as many things as you can.",
    "instructions": "Call begin, then combine until the game is over.",
}
BOOK = (
    *("name", "entities", "recipes", "base", "graph_hash", "split_hash", "part", "depth", "tasks", "distractors"),
    *("attempts", "knowledge", "look_ups", "texts"),
)
"""Keys of the facts of a book; none of them is a recipe."""
_READS = ToolAnnotations(read_only_hint=True, open_world_hint=False)
_PLAYS = ToolAnnotations(read_only_hint=False, destructive_hint=False, idempotent_hint=False, open_world_hint=False)
_ENDS = ToolAnnotations(read_only_hint=False, destructive_hint=False, idempotent_hint=True, open_world_hint=False)


def tools_hash() -> str:
    """Return the hash of all texts that players read here: texts of all games, tools' descriptions and prompts."""
    return hashlib.sha256(json.dumps([texts_hash(), TOOLS, PROMPTS], sort_keys=True).encode()).hexdigest()


class Position(BaseModel, frozen=True):
    """Where a game stands."""

    game: str = Field(description="id of the game")
    goal: str | None = Field(description="what is to be made; null if there is no goal")
    things: list[str] = Field(description="what can be combined, in the order of its numbers from 1")
    attempts_left: int = Field(description="attempts left")
    is_over: bool = Field(description="whether the game is over")
    success: bool | None = Field(description="whether the goal was made; null before the end, or if there is no goal")

    @classmethod
    def of(cls, found: HostedGame, **more: Any) -> Self:
        """Return where a hosted game stands."""
        game = found.talk.game
        return cls(
            game=found.name,
            goal=game.goal,
            things=list(game.labels),
            attempts_left=game.attempts_left,
            is_over=game.is_over,
            success=game.is_made if isinstance(game, TaskGame) and game.is_over else None,
            **more,
        )


class Begun(Position, frozen=True):
    """A game that begins."""

    rules: str = Field(description="the rules")


class Combined(Position, frozen=True):
    """What came of an attempt."""

    result: str = Field(description="the attempt in words, such as 'water + earth -> mud'")
    new: list[str] = Field(description="things that can be combined now and could not before")


class Known(Position, frozen=True):
    """What is known in a game."""

    attempts: list[str] = Field(description="the attempts so far, and what came of them")


class Facts(BaseModel, frozen=True):
    """What is known of a thing."""

    game: str = Field(description="id of the game")
    thing: str = Field(description="the thing")
    facts: list[str] = Field(description="what is known of it, what concerns the game most first")
    look_ups_left: int = Field(description="how often something may still be looked up in this game")


def _as_text(value: Any) -> Any:
    """Return the digits of a number: language models write either."""
    return str(value) if type(value) is int and abs(value) < 10**9 else value


def _no_truth_value(value: Any) -> Any:
    if isinstance(value, bool):
        raise ValueError("a truth value is no number")
    return value


GameName = Annotated[str, Field(max_length=LONGEST, description="id of the game, from begin")]
Thing = Annotated[str, Field(max_length=LONGEST, description="word or number of a thing"), BeforeValidator(_as_text)]
Word = Annotated[str, Field(max_length=LONGEST, description="word of a thing")]


class _Server(MCPServer[Any]):
    async def call_tool(
        self, name: str, arguments: dict[str, Any], context: Context[Any, Any] | None = None
    ) -> CallToolResult | InputRequiredResult:
        """Call a tool as the base class does, with errors in words for players."""
        try:
            return await super().call_tool(name, arguments, context)
        except ToolError as error:
            text = _in_words(error.__cause__)
            if text is None:
                raise
            raise ToolError(text) from error.__cause__


def _in_words(error: BaseException | None) -> str | None:
    """Return the text for a player's error; None for another one."""
    if isinstance(error, ValidationError):
        found = error.errors(include_url=False, include_context=False, include_input=False)
        each = (f"'{'.'.join(map(str, one['loc']))}': {one['msg'].removeprefix('Value error, ')}" for one in found)
        return told("refused", why="; ".join(each) + ".")
    if isinstance(error, OSError):
        return (
            f"The game is over, but its record could not be written: {error.strerror or error}. `state` tells how it "
            "ended, and `end` tries again to write it."
        )
    if isinstance(error, WordCraftKGError):
        return told("refused", why=str(error)) if isinstance(error, ActionError) else str(error)
    return None


def make_server(hosted: HostedGames) -> MCPServer[Any]:
    """Return a server of games for any transport, or for clients in this process."""
    games, settings = hosted.play.games, hosted.play.settings
    rules, about_look_ups = games.begin().rules, TOOLS["look_up"].format(look_ups=settings.look_ups)
    if settings.look_ups:
        rules = f"{rules}\n{about_look_ups}"
    server = _Server(
        "wordcraft-kg",
        title="Crafting worlds of wordcraft-kg",
        instructions=f"{rules}\n{PROMPTS['instructions']}",
        version=__version__,
        log_level="WARNING",
    )
    if isinstance(games, TaskGames):
        _add_tasks(server, hosted, last=len(games.world.tasks) - 1)
    else:
        _add_world(server, hosted)

    @server.tool(title="State of a game", description=TOOLS["state"], annotations=_READS)
    async def state(game: GameName) -> Annotated[CallToolResult, Position]:
        found = hosted.game(game)
        return _result(found.talk.game.state, Position.of(found))

    @server.tool(title="Combine two things", description=TOOLS["combine"], annotations=_PLAYS)
    async def combine(game: GameName, first: Thing, second: Thing) -> Annotated[CallToolResult, Combined]:
        found = hosted.game(game)
        before = set(found.talk.game.labels)
        came = found.combine(first, second)
        new = [label for label in found.talk.game.labels if label not in before]
        return _result(f"{came}\n\n{found.talk.game.state}", Combined.of(found, result=came, new=new))

    @server.tool(title="What is known in a game", description=TOOLS["known"], annotations=_READS)
    async def known(game: GameName) -> Annotated[CallToolResult, Known]:
        found = hosted.game(game)
        text = "\n".join([numbered(found.talk.game.labels), *found.attempts])
        return _result(text, Known.of(found, attempts=[*found.attempts]))

    if settings.look_ups:

        @server.tool(title="Look a thing up", description=about_look_ups, annotations=_PLAYS)
        async def look_up(game: GameName, thing: Word) -> Annotated[CallToolResult, Facts]:
            found = hosted.game(game)
            label, facts = found.look_up(thing)
            left = settings.look_ups - found.talk.look_ups
            return _result(facts_in_words(label, facts), Facts(game=game, thing=label, facts=facts, look_ups_left=left))

    @server.tool(title="End a game", description=TOOLS["end"], annotations=_ENDS)
    async def end(game: GameName) -> Annotated[CallToolResult, Position]:
        found = hosted.game(game)
        found.end()
        return _result(found.talk.game.state, Position.of(found))

    _add_resources(server, hosted.play, rules)
    return server


def _add_world(server: MCPServer[Any], hosted: HostedGames) -> None:
    """Add the tool and the prompt that begin a game in the open-ended world."""

    @server.tool(title="Begin a game", description=TOOLS["begin_world"], annotations=_PLAYS)
    async def begin() -> Annotated[CallToolResult, Begun]:
        return _begun(hosted.begin())

    @server.prompt(title="Play", description="Play a game to its end.")
    async def play() -> str:
        return PROMPTS["world"]


def _add_tasks(server: MCPServer[Any], hosted: HostedGames, last: int) -> None:
    """Add the tool and the prompt that begin a task, by its number from 0 to ``last``."""
    which = Field(ge=0, le=last, description=f"number of the task, 0 to {last}")
    what = Field(ge=0, le=MAX_SIZE, description="number of the draw of what else is on the table")

    @server.tool(title="Begin a game", description=TOOLS["begin"].format(first=0, last=last), annotations=_PLAYS)
    async def begin(
        task: Annotated[int, which, BeforeValidator(_no_truth_value)],
        draw: Annotated[int, what, BeforeValidator(_no_truth_value)] = 0,
    ) -> Annotated[CallToolResult, Begun]:
        return _begun(hosted.begin(task, draw))

    @server.prompt(title="Play", description="Play a game to its end.")
    async def play(
        task: Annotated[str, Field(description=f"number of the task, 0 to {last}; 0 if left out")] = "0",
    ) -> str:
        return PROMPTS["task"].format(task=task[:LONGEST])


def _begun(found: HostedGame) -> CallToolResult:
    game = found.talk.game
    return _result(f"Game {found.name}\n{game.rules}\n\n{game.state}", Begun.of(found, rules=game.rules))


def _add_resources(server: MCPServer[Any], play: Play, rules: str) -> None:
    graph, settings = play.games.graph, as_values(play.settings)
    settings |= {"name": graph.name, "entities": graph.num_entities, "recipes": len(graph.recipes)}
    settings["base"] = settings["base"] or graph.labels(graph.base_ids)
    settings["tasks"] = len(play.games.world.tasks) if isinstance(play.games, TaskGames) else None
    book = json.dumps({name: settings[name] for name in BOOK}, ensure_ascii=False, indent=2)
    for name, about, text, kind in (
        ("rules", "What is played, and how.", rules, "text/plain"),
        ("book", "Facts of the book that is played.", book, "application/json"),
        ("things", "All things that there are, a line each.", "\n".join(graph.entities), "text/plain"),
    ):
        uri, title = f"wordcraft://{name}", name.title()
        server.add_resource(TextResource(uri=uri, name=name, title=title, description=about, text=text, mime_type=kind))


def _result(text: str, values: BaseModel) -> CallToolResult:
    return CallToolResult(content=[TextContent(type="text", text=text)], structured_content=values.model_dump())


def make_http_app(server: MCPServer[Any], host: str = LOOPBACK[0], more_hosts: Collection[str] = ()) -> ASGIApp:
    """Return a server as an application that answers for a host, for this machine and for further names.

    The SDK refuses other hosts (DNS rebinding), pages of other sites, and bodies that are too long.
    """
    names = {*LOOPBACK, host.lower(), *(name.lower() for name in more_hosts)}
    shown = [f"[{name}]" if ":" in name else name for name in sorted(names)]
    hosts = [ending for name in shown for ending in (name, f"{name}:*")]
    origins = [f"{scheme}://{one}" for scheme in ("http", "https") for one in hosts]
    return server.streamable_http_app(
        streamable_http_path=PATH,
        # A call has one answer, and games have ids: neither streams nor sessions are needed.
        json_response=True,
        stateless_http=True,
        max_request_body_size=LONGEST_BODY,
        transport_security=TransportSecuritySettings(allowed_hosts=hosts, allowed_origins=origins),
    )
