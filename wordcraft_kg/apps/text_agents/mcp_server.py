"""The crafting worlds as a server of the Model Context Protocol, whose tools play games.

Connections have no memory in the present protocol, so ``begin`` returns an id for each game.
"""

import hashlib
import json
from collections.abc import Collection
from typing import Annotated, Any, Self

from mcp.server import MCPServer
from mcp.server.mcpserver import Context
from mcp.server.mcpserver.exceptions import ToolError
from mcp.server.transport_security import TransportSecuritySettings
from mcp_types import CallToolResult, InputRequiredResult, TextContent, ToolAnnotations
from pydantic import BaseModel, BeforeValidator, Field, ValidationError
from starlette.types import ASGIApp

from wordcraft_kg import __version__
from wordcraft_kg.apps.text_agents.conversation import facts_in_words
from wordcraft_kg.apps.text_agents.games import TaskGame, TaskGames
from wordcraft_kg.apps.text_agents.hosted_games import HostedGame, HostedGames
from wordcraft_kg.apps.web.guard import LONGEST_BODY, LOOPBACK
from wordcraft_kg.base.errors import ActionError, WordCraftKGError
from wordcraft_kg.base.settings import MAX_SIZE
from wordcraft_kg.envs.words import texts_hash, told

_LONGEST = 200
"""Characters of a label or a game's id."""
PATH = "/mcp"
_TOOLS = {
    "begin": "Begin a game and return its id, the rules and the state. Task {first} to {last}; draw chooses what else "
    "is on the table. The same task and draw are always the same game.",
    "begin_world": "Begin a game and return its id, the rules and the state. There is one world, the same for all.",
    "state": "Show where a game stands: the goal if there is one, what can be combined, and the attempts left.",
    "combine": "Make an attempt: combine two things, or a thing with itself. Give each by its word or its number. What "
    "is not understood is refused and costs nothing.",
    "look_up": "Look up what is known of a thing, by its word. It costs no attempt; {look_ups} times a game.",
    "end": "Give a game up.",
}
"""Descriptions of the tools for language models, in addition to :data:`~wordcraft_kg.envs.words.TEXTS`."""
_INSTRUCTIONS = "Call begin, then combine until the game is over."
_READS = ToolAnnotations(read_only_hint=True, open_world_hint=False)
_PLAYS = ToolAnnotations(read_only_hint=False, destructive_hint=False, idempotent_hint=False, open_world_hint=False)
_ENDS = ToolAnnotations(read_only_hint=False, destructive_hint=False, idempotent_hint=True, open_world_hint=False)


def tools_hash() -> str:
    """Return the hash for all MCP prompts: game texts, tool descriptions and instructions."""
    return hashlib.sha256(json.dumps([texts_hash(), _TOOLS, _INSTRUCTIONS], sort_keys=True).encode()).hexdigest()


class Position(BaseModel, frozen=True):
    """Where a game stands."""

    game: str = Field(description="id of the game")
    goal: str | None = Field(description="what is to be made; null if there is no goal")
    things: list[str] = Field(description="what can be combined, in the order of its numbers from 1")
    attempts_left: int = Field(description="attempts left")
    is_over: bool = Field(description="whether the game is over")
    success: bool | None = Field(description="whether the goal was made; null before the end, or if there is no goal")

    @classmethod
    def of(cls, hosted: HostedGame, **more: Any) -> Self:
        """Return a hosted game's position."""
        game = hosted.talk.game
        return cls(
            game=hosted.name,
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


class Facts(BaseModel, frozen=True):
    """What is known of a thing."""

    game: str = Field(description="id of the game")
    thing: str = Field(description="the thing")
    facts: list[str] = Field(description="what is known of it, what concerns the game most first")
    look_ups_left: int = Field(description="how often something may still be looked up in this game")


def _as_text(value: Any) -> Any:
    return str(value) if type(value) is int and abs(value) < 10**9 else value  # models write a number either way


_GameName = Annotated[str, Field(max_length=_LONGEST, description="id of the game, from begin")]
_Thing = Annotated[str, Field(max_length=_LONGEST, description="word or number of a thing"), BeforeValidator(_as_text)]


class _Server(MCPServer[Any]):
    async def call_tool(
        self, name: str, arguments: dict[str, Any], context: Context[Any, Any] | None = None
    ) -> CallToolResult | InputRequiredResult:
        """Call a tool; reword errors for players."""
        try:
            return await super().call_tool(name, arguments, context)
        except ToolError as error:
            cause = error.__cause__
            if not isinstance(cause, ValidationError | OSError | WordCraftKGError):
                raise
            raise ToolError(_in_words(cause)) from cause


def _in_words(error: ValidationError | OSError | WordCraftKGError) -> str:
    if isinstance(error, ValidationError):
        details = error.errors(include_url=False, include_context=False, include_input=False)
        each = (f"'{'.'.join(map(str, one['loc']))}': {one['msg']}" for one in details)
        return told("refused", why="; ".join(each) + ".")
    if isinstance(error, ActionError):
        return told("refused", why=str(error))
    if isinstance(error, OSError):
        return (
            f"The game is over, but its record could not be written: {error.strerror or error}. `state` tells how it "
            "ended, and `end` tries again to write it."
        )
    return str(error)


def make_server(hosted: HostedGames) -> MCPServer[Any]:
    """Return a game server for any transport."""
    games, settings = hosted.play.games, hosted.play.settings
    rules, about_look_ups = games.begin().rules, _TOOLS["look_up"].format(look_ups=settings.look_ups)
    if settings.look_ups:
        rules = f"{rules}\n{about_look_ups}"
    server = _Server(
        "wordcraft-kg",
        title="Crafting worlds of wordcraft-kg",
        instructions=f"{rules}\n{_INSTRUCTIONS}",
        version=__version__,
        log_level="WARNING",
    )
    if isinstance(games, TaskGames):
        _add_begin_task(server, hosted, last=len(games.world.tasks) - 1)
    else:

        @server.tool(title="Begin a game", description=_TOOLS["begin_world"], annotations=_PLAYS)
        async def begin() -> Annotated[CallToolResult, Begun]:
            return _begun(hosted.begin())

    @server.tool(title="State of a game", description=_TOOLS["state"], annotations=_READS)
    async def state(game: _GameName) -> Annotated[CallToolResult, Position]:
        playing = hosted.game(game)
        return _result(playing.talk.game.state, Position.of(playing))

    @server.tool(title="Combine two things", description=_TOOLS["combine"], annotations=_PLAYS)
    async def combine(game: _GameName, first: _Thing, second: _Thing) -> Annotated[CallToolResult, Combined]:
        playing = hosted.game(game)
        before = set(playing.talk.game.labels)
        result = playing.combine(first, second)
        new = [label for label in playing.talk.game.labels if label not in before]
        return _result(f"{result}\n\n{playing.talk.game.state}", Combined.of(playing, result=result, new=new))

    if settings.look_ups:

        @server.tool(title="Look a thing up", description=about_look_ups, annotations=_PLAYS)
        async def look_up(
            game: _GameName, thing: Annotated[str, Field(max_length=_LONGEST, description="word of a thing")]
        ) -> Annotated[CallToolResult, Facts]:
            playing = hosted.game(game)
            label, facts = playing.look_up(thing)
            left = settings.look_ups - playing.talk.look_ups
            return _result(facts_in_words(label, facts), Facts(game=game, thing=label, facts=facts, look_ups_left=left))

    @server.tool(title="End a game", description=_TOOLS["end"], annotations=_ENDS)
    async def end(game: _GameName) -> Annotated[CallToolResult, Position]:
        playing = hosted.game(game)
        playing.end()
        return _result(playing.talk.game.state, Position.of(playing))

    return server


def _add_begin_task(server: MCPServer[Any], hosted: HostedGames, last: int) -> None:
    which = Field(ge=0, le=last, description=f"number of the task, 0 to {last}")
    what = Field(ge=0, le=MAX_SIZE, description="number of the draw of what else is on the table")

    @server.tool(title="Begin a game", description=_TOOLS["begin"].format(first=0, last=last), annotations=_PLAYS)
    async def begin(
        task: Annotated[int, which], distractor_seed: Annotated[int, what] = 0
    ) -> Annotated[CallToolResult, Begun]:
        return _begun(hosted.begin(task, distractor_seed))


def _begun(hosted: HostedGame) -> CallToolResult:
    game = hosted.talk.game
    return _result(f"Game {hosted.name}\n{game.rules}\n\n{game.state}", Begun.of(hosted, rules=game.rules))


def _result(text: str, values: BaseModel) -> CallToolResult:
    return CallToolResult(content=[TextContent(type="text", text=text)], structured_content=values.model_dump())


def make_http_app(server: MCPServer[Any], host: str = LOOPBACK[0], more_hosts: Collection[str] = ()) -> ASGIApp:
    """Return the server as an application for a host, this machine's own names and further names.

    The SDK refuses other hosts (DNS rebinding), pages of other sites, and long bodies.
    """
    names = sorted({*LOOPBACK, host.lower(), *(name.lower() for name in more_hosts)})
    hosts = [(f"[{name}]" if ":" in name else name) + port for name in names for port in ("", ":*")]
    origins = [f"{scheme}://{one}" for scheme in ("http", "https") for one in hosts]
    return server.streamable_http_app(
        streamable_http_path=PATH,
        # A call has one answer, and games have ids: neither streams nor sessions are needed.
        json_response=True,
        stateless_http=True,
        max_request_body_size=LONGEST_BODY,
        transport_security=TransportSecuritySettings(allowed_hosts=hosts, allowed_origins=origins),
    )
