"""A server with tools for crafting games, for clients of the Model Context Protocol (MCP).

Connections have no memory in the present protocol: each call stands alone. So ``begin`` returns an
id for each game, which every other tool takes.
"""

import copy
import hashlib
import itertools
import json
import logging
import secrets
from collections import OrderedDict
from collections.abc import Callable, Collection
from functools import lru_cache
from typing import Annotated, Any, Self

import anyio
import msgspec
from mcp.server import MCPServer
from mcp.server.mcpserver import Context
from mcp.server.mcpserver.exceptions import ToolError
from mcp.server.transport_security import TransportSecuritySettings
from mcp_types import CallToolResult, InputRequiredResult, TextContent, ToolAnnotations
from pydantic import BaseModel, BeforeValidator, Field, ValidationError
from starlette.requests import ClientDisconnect
from starlette.types import ASGIApp

from wordcraft_kg import __version__
from wordcraft_kg.apps.text_agents.conversation import MOST_ITEMS, Conversation
from wordcraft_kg.apps.text_agents.games import TaskGame
from wordcraft_kg.apps.text_agents.plays import Play
from wordcraft_kg.apps.text_agents.results import Keep
from wordcraft_kg.apps.web.guard import LONGEST_BODY, LOOPBACK, Guard
from wordcraft_kg.base import MAX_SIZE, ActionError, EpisodeError, WordCraftKGError, counted
from wordcraft_kg.envs.words import prompt_hash, prompt_text

_MOST_GAMES = 1_000
"""Remembered games: ten per player for a hundred players."""
_LONGEST = 200
"""Most characters of a label or a game's id."""
PATH = "/mcp"
"""Path of the server below its address."""
# Language models read these texts, so they are prompts: `tools_hash` is recorded with each game,
# and results under another wording are not comparable.
_TOOLS = {
    "begin": "Start a game. Returns the game id, the rules and the current state. Tasks are "
    "numbered 0 to {last}; `distractor_seed` selects the distractor items on the table. The same "
    "task and seed always give the same game.",
    "begin_world": "Start a game in the open-ended world. Returns the game id, the rules and the "
    "current state. All games start from the same items.",
    "state": "Get the current state of a game: the goal (if any), the available items, and the "
    "attempts left.",
    "combine": "Make an attempt: combine two items, or one item with itself. Refer to each item by "
    "name or number. Invalid input is rejected and does not use up an attempt.",
    "look_up": "Look up {known} an item by name. Does not use up an attempt; limited to {look_ups} "
    "per game.",
    "end": "End a game early.",
}
_KNOWN = "the known recipes of"
_LIKELY = "the likely links of"
_COMBINE_SET = (
    "Make an attempt: combine items, each as often as it is needed. Refer to each item by name or "
    "number. Invalid input is rejected and does not use up an attempt."
)
_INSTRUCTIONS = "Call `begin`, then call `combine` until the game is over."
# Hints by which clients decide whether to ask their user before a call. Nothing here reaches beyond
# the game (open_world) or destroys anything.
_READS = ToolAnnotations(read_only_hint=True, open_world_hint=False)
_PLAYS = ToolAnnotations(
    read_only_hint=False, destructive_hint=False, idempotent_hint=False, open_world_hint=False
)
_ENDS = ToolAnnotations(
    read_only_hint=False, destructive_hint=False, idempotent_hint=True, open_world_hint=False
)


class HostedGames:
    """All games on a server, open to anyone with a game's id.

    Players may reconnect by id. The memory is bounded, because anyone can begin games: the least
    recent games are forgotten, and long games are recorded in part.

    Attributes:
        play: the games.
        keep: called with each finished game; by default its messages are forgotten.
    """

    def __init__(self, play: Play, *, most: int = _MOST_GAMES):
        """Prepare to host games; at most ``most`` games are remembered."""
        self.play = copy.copy(play)
        # Tools are prompts as well.
        self.play.settings = msgspec.structs.replace(
            play.settings, prompt_hash=tools_hash(sets=play.has_sets)
        )
        self._most = most
        self.keep: Keep = lambda talk: talk.messages.clear()
        self._begun: set[tuple[int, int]] = set()
        self._numbers = itertools.count()
        self._hosted: OrderedDict[str, Conversation] = OrderedDict()

    def begin(self, task: int = 0, distractor_seed: int = 0) -> Conversation:
        """Begin a game, see :meth:`Play.begin`.

        On a track each game can be begun once; open-ended games come in turn. If there are too
        many games, end and forget a game: finished games first, then the least recent.

        Raises:
            ConfigError: if there is no such task or seed.
            EpisodeError: if the game was begun before on a track.
            OSError: if the forgotten game cannot be recorded.
        """
        settings = self.play.settings
        if settings.is_open_ended:
            distractor_seed = next(self._numbers)
        key = (task, distractor_seed)
        # Who begins a game again knows it, and could pick the better result.
        if settings.track and (key in self._begun or distractor_seed >= settings.distractor_seeds):
            raise EpisodeError(
                f"Each game of {settings.track} is played once, and this game was begun before."
            )
        talk = self.play.begin(task, distractor_seed)
        # The id is the only key to a game, so nobody may guess it: 72 random bits.
        talk.name = secrets.token_urlsafe(9)
        # Tools say by their schemas how to answer.
        talk.messages = [f"{talk.game.rules}\n\n{talk.game.state}"]
        talk.on_end = self.keep
        if settings.track:
            self._begun.add(key)
        if len(self._hosted) >= self._most:
            # `min` takes the first of equals, the least recent one: `game` moves ids to the end.
            oldest = min(self._hosted, key=lambda name: not self._hosted[name].is_over)
            self._hosted[oldest].end()
            del self._hosted[oldest]
        self._hosted[talk.name] = talk
        return talk

    def game(self, name: str) -> Conversation:
        """Return the game with the id ``name``.

        Raises EpisodeError for an unknown or forgotten id.
        """
        if name not in self._hosted:
            raise EpisodeError(
                f"Unknown game id '{name[:40]}': expected an id returned by `begin`; the server "
                "keeps the last "
                f"{self._most:,} games. Start a new game."
            )
        self._hosted.move_to_end(name)
        return self._hosted[name]


# The descriptions of fields are in the tools' schemas, so language models read them too.
class Position(BaseModel, frozen=True):
    """The current state of a game."""

    game: str = Field(description="game id")
    goal: str | None = Field(description="the goal item; null in the open-ended world")
    items: list[str] = Field(
        description="available items, in the order of their numbers, starting at 1"
    )
    attempts_left: int = Field(description="attempts left")
    is_over: bool = Field(description="whether the game is over")
    success: bool | None = Field(
        description="whether the goal was made; null while the game is running or without a goal"
    )

    @classmethod
    def of(cls, talk: Conversation, **fields: Any) -> Self:
        """Return the state of a game; ``fields`` are fields of subclasses, such as ``rules``."""
        game = talk.game
        return cls(
            game=talk.name,
            goal=game.goal,
            items=list(game.labels),
            attempts_left=game.attempts_left,
            is_over=game.is_over,
            success=game.is_made if isinstance(game, TaskGame) and game.is_over else None,
            **fields,
        )


class Begun(Position, frozen=True):
    """A new game."""

    rules: str = Field(description="the rules of the game")


class Combined(Position, frozen=True):
    """The result of an attempt."""

    result: str = Field(description="the attempt and its result, such as 'water + earth -> mud'")
    new: list[str] = Field(description="items added by this attempt")


class Facts(BaseModel, frozen=True):
    """Facts about an item."""

    game: str = Field(description="game id")
    item: str = Field(description="the item")
    facts: list[str] = Field(description="known facts, most relevant to this game first")
    look_ups_left: int = Field(description="look-ups left in this game")


def _as_text(value: Any) -> Any:
    # Models write an item's number as 2 or "2". Python writes no numbers of thousands of digits, so
    # there is a limit; a truth value is no number here, though it is an `int`.
    if type(value) is int and abs(value) < 10**9:
        return str(value)
    return value


_GameName = Annotated[str, Field(max_length=_LONGEST, description="game id returned by `begin`")]
_Item = Annotated[
    str,
    Field(max_length=_LONGEST, description="name or number of an item"),
    BeforeValidator(_as_text),
]
_Label = Annotated[str, Field(max_length=_LONGEST, description="name of an item")]


class _Server(MCPServer[Any]):
    async def call_tool(
        self, name: str, arguments: dict[str, Any], context: Context[Any, Any] | None = None
    ) -> CallToolResult | InputRequiredResult:
        """Call a tool; reject unknown arguments, and reword errors for players.

        Args:
            name: name of the tool.
            arguments: arguments as sent by the client.
            context: the request; None for a call without a client.

        Raises:
            ToolError: with a text that tells a player what to do.
        """
        # The SDK drops unknown arguments, so a misspelled optional one would silently do nothing.
        properties = {
            tool.name: tool.input_schema["properties"] for tool in await self.list_tools()
        }
        names = properties.get(name, arguments)
        for unknown in arguments.keys() - names:
            expected = ", ".join(names) or "no arguments"
            reason = f"unknown argument '{unknown[:_LONGEST]}': expected {expected}."
            raise ToolError(prompt_text("invalid", reason=reason))
        try:
            return await super().call_tool(name, arguments, context)
        except ToolError as error:
            # The SDK wraps what a tool raises; only expected errors are reworded, bugs are not.
            cause = error.__cause__
            if not isinstance(cause, ValidationError | OSError | WordCraftKGError):
                raise
            raise ToolError(_in_words(cause)) from cause


def _in_words(error: ValidationError | OSError | WordCraftKGError) -> str:
    if isinstance(error, ValidationError):
        # Without the input: a player's own text would come back as a part of the prompt.
        details = error.errors(include_url=False, include_context=False, include_input=False)
        problems = (f"'{'.'.join(map(str, detail['loc']))}': {detail['msg']}" for detail in details)
        return prompt_text("invalid", reason="; ".join(problems) + ".")
    if isinstance(error, OSError):
        return (
            "A game is over, but its record could not be saved: "
            f"{error.strerror or error}. Call `state` to see the outcome, or `end` to try saving "
            "again."
        )
    return str(error)


def make_server(hosted: HostedGames) -> MCPServer[Any]:
    """Return an MCP server with tools to play the hosted games.

    The server fits any transport (stdio, HTTP), and can be asked within this process.
    """
    play = hosted.play
    settings = play.settings
    last = None if settings.is_open_ended else len(play.world.tasks) - 1
    known = _LIKELY if settings.knowledge == "scorer" else _KNOWN
    return _server(
        play.game().rules, last, settings.look_ups, hosted, sets=play.has_sets, known=known
    )


@lru_cache(2)
def tools_hash(*, sets: bool = False) -> str:
    """Return the SHA-256 of all prompts by MCP, for recipes of two ingredients or of any number.

    These are the game texts, the instructions, and the lists of tools with their schemas.
    """
    # Two servers have all tools and all wordings between them: tasks with the train recipes, and
    # the open-ended world with a scorer.
    lists = []
    for last, known in ((0, _KNOWN), (None, _LIKELY)):
        server = _server("", last, 2, sets=sets, known=known)
        lists.append([tool.model_dump(mode="json") for tool in anyio.run(server.list_tools)])
    prompts = [prompt_hash(sets=sets), _TOOLS, _INSTRUCTIONS, lists]
    return hashlib.sha256(json.dumps(prompts, sort_keys=True).encode()).hexdigest()


def _server(
    rules: str,
    last: int | None,
    look_ups: int,
    hosted: Any = None,
    *,
    sets: bool = False,
    known: str = _KNOWN,
) -> MCPServer[Any]:
    """Return a server.

    Args:
        rules: the rules of the games, for the instructions.
        last: index of the last task; None in the open-ended world.
        look_ups: look-ups in a game; without any, there is no such tool.
        hosted: the :class:`HostedGames`; None for a server that only lists its tools.
        sets: whether recipes have other sizes than two.
        known: what the tool ``look_up`` tells of an item, in words.
    """
    about_look_ups = _TOOLS["look_up"].format(known=known, look_ups=counted(look_ups, "look-up"))
    instructions = [rules, _INSTRUCTIONS]
    if look_ups:
        instructions.insert(1, about_look_ups)
    server = _Server(
        "wordcraft-kg",
        title="wordcraft-kg crafting games",
        instructions="\n".join(instructions),
        version=__version__,
        log_level="WARNING",
    )
    _add_begin(server, last, hosted)

    @server.tool(title="Get the game state", description=_TOOLS["state"], annotations=_READS)
    async def state(game: _GameName) -> Annotated[CallToolResult, Position]:
        talk = hosted.game(game)
        return _result(talk.game.state, Position.of(talk))

    def combined(game: str, *items: str) -> CallToolResult:
        talk = hosted.game(game)
        labels_before = talk.game.labels
        reply = _accepted(talk, lambda: talk.combine(*items))
        new = [label for label in talk.game.labels if label not in labels_before]
        return _result(reply, Combined.of(talk, result=talk.outcome, new=new))

    if sets:

        @server.tool(
            name="combine", title="Combine items", description=_COMBINE_SET, annotations=_PLAYS
        )
        async def combine_set(
            game: _GameName, items: Annotated[list[_Item], Field(max_length=MOST_ITEMS)]
        ) -> Annotated[CallToolResult, Combined]:
            return combined(game, *items)

    else:

        @server.tool(title="Combine two items", description=_TOOLS["combine"], annotations=_PLAYS)
        async def combine(
            game: _GameName, first: _Item, second: _Item
        ) -> Annotated[CallToolResult, Combined]:
            return combined(game, first, second)

    if look_ups:

        @server.tool(title="Look up an item", description=about_look_ups, annotations=_PLAYS)
        async def look_up(game: _GameName, item: _Label) -> Annotated[CallToolResult, Facts]:
            talk = hosted.game(game)
            _accepted(talk, lambda: talk.look_up_item(item))
            label, facts = talk.facts
            return _result(
                talk.outcome,
                Facts(game=game, item=label, facts=facts, look_ups_left=look_ups - talk.look_ups),
            )

    @server.tool(title="End a game", description=_TOOLS["end"], annotations=_ENDS)
    async def end(game: _GameName) -> Annotated[CallToolResult, Position]:
        talk = hosted.game(game)
        talk.end()
        return _result(talk.game.state, Position.of(talk))

    return server


def _add_begin(server: MCPServer[Any], last: int | None, hosted: Any) -> None:
    """Add the tool ``begin``, which has no arguments in the open-ended world."""
    if last is None:

        @server.tool(title="Start a game", description=_TOOLS["begin_world"], annotations=_PLAYS)
        async def begin() -> Annotated[CallToolResult, Begun]:
            return _begun(hosted.begin())

        return
    number = Field(ge=0, le=last, description=f"task number, 0 to {last}")
    seed = Field(
        ge=0, le=MAX_SIZE, description="distractor seed; selects the other items on the table"
    )

    @server.tool(
        name="begin",
        title="Start a game",
        # The number of tasks belongs to the prompt; `tools_hash` uses a fixed one instead.
        description=_TOOLS["begin"].format(last=last),
        annotations=_PLAYS,
    )
    async def begin_task(
        task: Annotated[int, number], distractor_seed: Annotated[int, seed] = 0
    ) -> Annotated[CallToolResult, Begun]:
        return _begun(hosted.begin(task, distractor_seed))


def _accepted(talk: Conversation, act: Callable[[], str]) -> str:
    """Return the reply to a call.

    Raises:
        ActionError: if the call was invalid, with the prompt that says so.
        EpisodeError: after the end of the game.
    """
    if talk.is_over:
        raise EpisodeError(f"{talk.after_the_end} Start a new game.")
    reply = act()
    if talk.is_invalid:
        raise ActionError(talk.outcome)
    return reply


def _begun(talk: Conversation) -> CallToolResult:
    rules = talk.game.rules
    text = f"Game id: {talk.name}\n{rules}\n\n{talk.game.state}"
    return _result(text, Begun.of(talk, rules=rules))


def _result(text: str, values: BaseModel) -> CallToolResult:
    return CallToolResult(
        content=[TextContent(type="text", text=text)], structured_content=values.model_dump()
    )


def _is_no_disconnection(record: logging.LogRecord) -> bool:
    """Whether a record is about something else than a client that has left.

    The SDK logs a traceback for each such client.
    """
    return not (record.exc_info and isinstance(record.exc_info[1], ClientDisconnect))


def make_http_app(
    server: MCPServer[Any], host: str = LOOPBACK[0], more_hosts: Collection[str] = ()
) -> ASGIApp:
    """Return a server as an ASGI application, behind the guard of all servers of this package.

    Args:
        server: the server.
        host: address on which it listens.
        more_hosts: further names by which clients may ask it, such as a proxy's.
    """
    app = server.streamable_http_app(
        streamable_http_path=PATH,
        # A call has one answer, and games have ids: neither streams nor sessions are needed.
        json_response=True,
        stateless_http=True,
        max_request_body_size=LONGEST_BODY,  # arguments are short; memory is bounded
        transport_security=TransportSecuritySettings(enable_dns_rebinding_protection=False),
    )
    logging.getLogger("mcp.server.streamable_http").addFilter(_is_no_disconnection)
    # POST alone: a GET would open a stream of events, and hold a connection without an end.
    return Guard(
        app, host, more_hosts, lambda _, text: text, methods=("POST",), media_type="text/plain"
    )
