"""The crafting worlds as a server of the Model Context Protocol: tools to play, resources with rules and facts.

In the protocol's present version a connection has no memory: each call stands alone. So a game has an id, which
``begin`` returns and every other tool takes.
"""

import hashlib
import json
from collections.abc import Callable, Sequence
from typing import Annotated, Any

from mcp.server import MCPServer
from mcp.server.mcpserver import Context
from mcp.server.mcpserver.exceptions import ToolError
from mcp.server.mcpserver.resources import TextResource
from mcp_types import CallToolResult, InputRequiredResult, TextContent, ToolAnnotations
from pydantic import BaseModel, BeforeValidator, Field, ValidationError

from wordcraft_kg import __version__
from wordcraft_kg.apps.text_agents.games import TaskGame, TaskGames
from wordcraft_kg.apps.text_agents.hosted_games import HostedGame, HostedGames
from wordcraft_kg.apps.text_agents.mcp_results import Begun, Combined, Facts, Known, Position
from wordcraft_kg.base.errors import ActionError, WordCraftKGError
from wordcraft_kg.base.records import Count, Hash, Record, as_values
from wordcraft_kg.base.settings import MAX_SIZE
from wordcraft_kg.envs.words import numbered, texts_hash, told
from wordcraft_kg.graphs.recipe_graph import RecipeGraph

NAME = "wordcraft-kg"
LONGEST = 200
"""Characters of a thing's name or a game's id."""
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
"""What language models are told of the tools, together with :data:`~wordcraft_kg.envs.words.TEXTS`."""
PROMPTS = {
    "task": "Play a game of crafting. Begin task {task} and play until the game is over, with as few attempts as you "
    "can.",
    "world": "Play a game of crafting. Begin a game and play until it is over; discover as many things as you can.",
    "instructions": "Call begin, then combine until the game is over.",
}
"""What language models are told of playing as a whole."""
_READS = ToolAnnotations(read_only_hint=True, open_world_hint=False)
_PLAYS = ToolAnnotations(read_only_hint=False, destructive_hint=False, idempotent_hint=False, open_world_hint=False)
_ENDS = ToolAnnotations(read_only_hint=False, destructive_hint=False, idempotent_hint=True, open_world_hint=False)


class HostedBook(Record, frozen=True, kw_only=True):
    """Facts of the book that is played; no recipes.

    Attributes:
        name: its name.
        entities: number of its things.
        recipes: number of its recipes.
        base: what everything else is made from.
        graph_hash: content hash of the graph.
        split_hash: that of its split.
        part: part of the tasks; None in the open-ended world.
        depth: fewest attempts that solve a task; None in the open-ended world.
        tasks: number of tasks, which are numbered from 0; None in the open-ended world.
        distractors: things on each table that the goal does not need; None in the open-ended world.
        attempts: attempts in a game.
        knowledge: what can be looked up.
        look_ups: how often in a game.
        texts: hash of all that players are told.
    """

    name: str
    entities: Count
    recipes: Count
    base: tuple[str, ...]
    graph_hash: Hash
    split_hash: Hash
    part: str | None
    depth: Count | None
    tasks: Count | None
    distractors: Count | None
    attempts: Count
    knowledge: str
    look_ups: Count
    texts: Hash


def tools_hash() -> str:
    """Return the hash of all that players are told here: what others are told, the tools' descriptions, the prompts."""
    return hashlib.sha256(json.dumps([texts_hash(), TOOLS, PROMPTS], sort_keys=True).encode()).hexdigest()


def _as_text(value: Any) -> Any:
    """Take a number for its digits: language models write either."""
    if isinstance(value, int) and not isinstance(value, bool) and abs(value) < 10**9:
        return str(value)
    return value


def _no_truth_value(value: Any) -> Any:
    if isinstance(value, bool):
        raise ValueError("a truth value is no number")
    return value


GameName = Annotated[str, Field(max_length=LONGEST, description="id of the game, from begin")]
Thing = Annotated[str, Field(max_length=LONGEST, description="word or number of a thing"), BeforeValidator(_as_text)]
Word = Annotated[str, Field(max_length=LONGEST, description="word of a thing")]


class _Server(MCPServer[Any]):
    """Says what is wrong with a tool's arguments without the words of the library that checks them."""

    async def call_tool(
        self, name: str, arguments: dict[str, Any], context: Context[Any, Any] | None = None
    ) -> CallToolResult | InputRequiredResult:
        """Call a tool; see the base class."""
        try:
            return await super().call_tool(name, arguments, context)
        except ToolError as error:
            if not isinstance(error.__cause__, ValidationError):
                raise
            found = error.__cause__.errors(include_url=False, include_context=False, include_input=False)
            wrong = (f"'{'.'.join(map(str, one['loc']))}': {one['msg'].removeprefix('Value error, ')}" for one in found)
            raise ToolError(told("refused", why="; ".join(wrong) + ".")) from error.__cause__


def make_server(hosted: HostedGames) -> MCPServer[Any]:
    """Return a server of games; it can be served on any transport, and be asked in this process."""
    book = book_of(hosted)
    rules = rules_of(hosted)
    server = _Server(
        NAME,
        title="Crafting worlds of wordcraft-kg",
        instructions=f"{rules}\n{PROMPTS['instructions']}",
        version=__version__,
        log_level="WARNING",
    )
    if book.tasks is not None:
        _add_begin(server, hosted, book.tasks)
    else:

        @server.tool(title="Begin a game", description=TOOLS["begin_world"], annotations=_PLAYS)
        async def begin() -> Annotated[CallToolResult, Begun]:
            return _answered(lambda: _begun(hosted.begin()))

    @server.tool(title="State of a game", description=TOOLS["state"], annotations=_READS)
    async def state(game: GameName) -> Annotated[CallToolResult, Position]:
        def shown() -> CallToolResult:
            found = hosted.game(game)
            return _result(found.talk.game.state, Position(**_position(found)))

        return _answered(shown)

    @server.tool(title="Combine two things", description=TOOLS["combine"], annotations=_PLAYS)
    async def combine(game: GameName, first: Thing, second: Thing) -> Annotated[CallToolResult, Combined]:
        def made() -> CallToolResult:
            before = set(hosted.game(game).talk.game.labels)
            came = hosted.combine(game, first, second)
            found = hosted.game(game)
            new = [label for label in found.talk.game.labels if label not in before]
            position = Combined(**_position(found), result=came, new=new)
            return _result(f"{came}\n\n{found.talk.game.state}", position)

        return _answered(made)

    @server.tool(title="What is known in a game", description=TOOLS["known"], annotations=_READS)
    async def known(game: GameName) -> Annotated[CallToolResult, Known]:
        def listed() -> CallToolResult:
            found = hosted.game(game)
            text = "\n".join([numbered(found.talk.game.labels), *found.attempts])
            return _result(text, Known(**_position(found), attempts=[*found.attempts]))

        return _answered(listed)

    if hosted.has_look_ups:
        about = TOOLS["look_up"].format(look_ups=hosted.settings.look_ups)

        @server.tool(title="Look a thing up", description=about, annotations=_PLAYS)
        async def look_up(game: GameName, thing: Word) -> Annotated[CallToolResult, Facts]:
            def found() -> CallToolResult:
                label, facts = hosted.look_up(game, thing)
                left = hosted.settings.look_ups - hosted.game(game).talk.look_ups
                text = told("found", entity=label, facts="\n".join(facts))
                values = Facts(game=game, thing=label, facts=facts, look_ups_left=left)
                return _result(text if facts else told("nothing_found", entity=label), values)

            return _answered(found)

    @server.tool(title="End a game", description=TOOLS["end"], annotations=_ENDS)
    async def end(game: GameName) -> Annotated[CallToolResult, Position]:
        def ended() -> CallToolResult:
            found = hosted.end(game)
            return _result(found.talk.game.state, Position(**_position(found)))

        return _answered(ended)

    _add_resources(server, rules, book, _graph(hosted).entities)
    _add_prompt(server, book)
    return server


def rules_of(hosted: HostedGames) -> str:
    """Return the rules of what is played."""
    rules = [told("rules") + " " + told("discover" if hosted.settings.is_open_ended else "goal")]
    if hosted.has_look_ups:
        rules.append(TOOLS["look_up"].format(look_ups=hosted.settings.look_ups))
    return "\n".join(rules)


def book_of(hosted: HostedGames) -> HostedBook:
    """Return the facts of the book that is played."""
    graph, settings = _graph(hosted), hosted.settings
    return HostedBook(
        name=graph.name,
        entities=graph.num_entities,
        recipes=len(graph.recipes),
        base=settings.base or graph.labels(graph.base_ids),
        graph_hash=settings.graph_hash,
        split_hash=settings.split_hash,
        part=settings.part,
        depth=settings.depth,
        tasks=len(hosted.games.world.tasks) if isinstance(hosted.games, TaskGames) else None,
        distractors=settings.distractors,
        attempts=settings.attempts,
        knowledge=settings.knowledge,
        look_ups=settings.look_ups,
        texts=settings.texts,
    )


def _add_begin(server: MCPServer[Any], hosted: HostedGames, tasks: int) -> None:
    about = TOOLS["begin"].format(first=0, last=tasks - 1)
    which = Field(ge=0, le=tasks - 1, description=f"number of the task, 0 to {tasks - 1}")
    what = Field(ge=0, le=MAX_SIZE, description="number of the draw of what else is on the table")

    async def begin(
        task: Annotated[int, which, BeforeValidator(_no_truth_value)],
        draw: Annotated[int, what, BeforeValidator(_no_truth_value)] = 0,
    ) -> Annotated[CallToolResult, Begun]:
        return _answered(lambda: _begun(hosted.begin(task, draw)))

    server.add_tool(begin, title="Begin a game", description=about, annotations=_PLAYS)


def _add_resources(server: MCPServer[Any], rules: str, book: HostedBook, things: Sequence[str]) -> None:
    facts = json.dumps(as_values(book), ensure_ascii=False, indent=2)
    for name, about, text, kind in (
        ("rules", "What is played, and how.", rules, "text/plain"),
        ("book", "Facts of the book that is played.", facts, "application/json"),
        ("things", "All things that there are, a line each.", "\n".join(things), "text/plain"),
    ):
        server.add_resource(
            TextResource(
                uri=f"wordcraft://{name}", name=name, title=name.title(), description=about, text=text, mime_type=kind
            )
        )


def _add_prompt(server: MCPServer[Any], book: HostedBook) -> None:
    about = "Play a game to its end."
    if book.tasks is None:

        @server.prompt(title="Play", description=about)
        async def play() -> str:
            return PROMPTS["world"]
    else:

        @server.prompt(name="play", title="Play", description=about)
        async def play_task(
            task: Annotated[str, Field(description=f"number of the task, 0 to {book.tasks - 1}; 0 if left out")] = "0",
        ) -> str:
            return PROMPTS["task"].format(task=task[:LONGEST])


def _begun(found: HostedGame) -> CallToolResult:
    game = found.talk.game
    text = f"Game {found.name}\n{game.rules}\n\n{game.state}"
    return _result(text, Begun(**_position(found), rules=game.rules))


def _position(found: HostedGame) -> dict[str, Any]:
    game = found.talk.game
    success = game.is_made if isinstance(game, TaskGame) and game.is_over else None
    return {
        "game": found.name,
        "goal": game.goal if isinstance(game, TaskGame) else None,
        "things": list(game.labels),
        "attempts_left": game.attempts_left,
        "is_over": game.is_over,
        "success": success,
    }


def _result(text: str, values: BaseModel) -> CallToolResult:
    return CallToolResult(content=[TextContent(type="text", text=text)], structured_content=values.model_dump())


def _answered(answer: Callable[[], CallToolResult]) -> CallToolResult:
    """Return an answer, or the error that a player can do something about."""
    try:
        return answer()
    except ActionError as error:
        text = told("refused", why=str(error))
    except WordCraftKGError as error:
        text = str(error)
    except OSError as error:
        text = (
            f"The game is over, but its record could not be written: {error.strerror or error}. `state` tells how it "
            "ended, and `end` tries again to write it."
        )
    return CallToolResult(content=[TextContent(type="text", text=text)], is_error=True)


def _graph(hosted: HostedGames) -> RecipeGraph:
    games = hosted.games
    return games.world.graph if isinstance(games, TaskGames) else games.env.graph
