"""The tasks of Inspect AI: crafting tasks at the tables of the evaluation, and the open-ended world.

``inspect eval wordcraft_kg/crafting`` finds them by the package's entry point. What a model is told and what its words
mean is that of :mod:`wordcraft_kg.apps.text_agents`, for all players that use words alike.
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from wordcraft_kg.apps.text_agents.config import ATTEMPTS, LOOK_UPS, REFUSALS
from wordcraft_kg.apps.text_agents.conversation import Conversation
from wordcraft_kg.apps.text_agents.inspect_games import conversation, goal_made, things_known
from wordcraft_kg.apps.text_agents.inspect_log import METADATA, LoggedTask
from wordcraft_kg.apps.text_agents.records import WordsSettings
from wordcraft_kg.base.errors import ConfigError, UnknownSettingError, WordCraftKGError
from wordcraft_kg.base.extras import missing_extra
from wordcraft_kg.base.records import as_values
from wordcraft_kg.base.settings import MAX_SIZE, nearest, refuse, whole

try:
    from inspect_ai import Task, task

    # Its name is private, but it is the error that Inspect shows to users without a traceback.
    from inspect_ai._util.error import PrerequisiteError
    from inspect_ai.dataset import MemoryDataset, Sample
    from inspect_ai.model import ChatMessage, ChatMessageSystem, ChatMessageUser
except ModuleNotFoundError:
    raise missing_extra("inspect", ["Inspect AI"]) from None

if TYPE_CHECKING:
    from wordcraft_kg.graphs.folder import OpenedGraph

_CRAFTING = (
    *("graph", "part", "depth", "distractors", "attempts", "draws", "tasks"),
    *("knowledge", "scorer", "look_ups", "refusals"),
)
_DISCOVERY = ("graph", "attempts", "base", "games", "knowledge", "scorer", "look_ups", "refusals")
_NAMES = {"num_distractors": "distractors", "max_attempts": "attempts"}
"""Settings of ours by the names of the tasks' parameters."""


class InspectTaskError(ConfigError, PrerequisiteError):
    """A parameter of a task is wrong; Inspect shows the message without a traceback."""

    def __init__(self, message: str):
        """Take the message."""
        from rich.markup import escape

        ValueError.__init__(self, message)
        self.message = escape(message)


@task
def crafting(
    graph: str = "everyday",
    part: str = "test",
    depth: int = 1,
    distractors: int = 8,
    attempts: int | None = None,
    draws: int = 1,
    tasks: int | None = None,
    knowledge: str = "none",
    scorer: str | None = None,
    look_ups: int = LOOK_UPS,
    refusals: int = REFUSALS,
    **unknown: Any,
) -> Task:
    """Make the goal from what is on the table: the tasks on which agents are evaluated, at the same tables.

    Args:
        graph: a graph folder, a recipe book's file, or the name of a known book.
        part: tasks of train, valid, test or all.
        depth: fewest attempts that make the goal, 1 to 5.
        distractors: things on the table that no plan needs.
        attempts: attempts in a game; as many as the depth if left out.
        draws: draws of distractors; each task is played once with each.
        tasks: the most tasks to play, evenly spaced; all if left out.
        knowledge: what may be looked up: none, partial (the train recipes), or scorer (what a scorer believes).
        scorer: model folder of the scorer, with ``knowledge`` scorer.
        look_ups: how often something may be looked up in a game.
        refusals: how often in a row an answer that is not understood costs nothing.
        unknown: nothing; a parameter that there is not is an error, not a warning.

    Raises:
        InspectTaskError: for a wrong parameter, or a graph or scorer that cannot be read.
    """
    from wordcraft_kg.apps.text_agents.evaluation import chosen_tasks
    from wordcraft_kg.apps.text_agents.games import TaskGames
    from wordcraft_kg.apps.text_agents.knowledge import open_knowledge
    from wordcraft_kg.envs.config import WordCraftConfig
    from wordcraft_kg.envs.world import World

    with _readable():
        _check_names(unknown, _CRAFTING)
        config = WordCraftConfig(
            part=part,  # type: ignore[arg-type]
            depth=depth,
            num_distractors=distractors,
            max_attempts=attempts,
        )
        whole("draws", draws, 1, MAX_SIZE)
        opened = _opened(graph)
        games = TaskGames(World(opened, config))
        numbers = chosen_tasks(games.world, tasks).tolist()
        known, asked, kg = open_knowledge(knowledge, opened, scorer and Path(str(scorer)))  # type: ignore[arg-type]
        if known is not None:
            # A scorer that has seen the tasks' recipes is refused now, not in the middle of the first game.
            known.facts(0, games.begin(numbers[0]))
        settings = WordsSettings.of_tasks(
            games.world,
            draws=draws,
            tasks=tasks,
            knowledge=knowledge,
            scorer=asked,
            kg=kg,
            look_ups=whole("look_ups", look_ups, 0, MAX_SIZE),
            refusals=whole("refusals", refusals, 0, MAX_SIZE),
        )

        def begin(about: Mapping[str, Any]) -> Conversation:
            return Conversation(games.begin(about["task"], about["draw"]), known, refusals=refusals, look_ups=look_ups)

        samples = []
        for draw in range(draws):
            for number in numbers:
                talk = begin({"task": number, "draw": draw})
                about = {"task": number, "draw": draw, "goal": games.world.tasks[number].goal, **_hashes(settings)}
                samples.append(
                    Sample(id=f"{part}-{number}-{draw}", input=_opening(talk), target=about["goal"], metadata=about)
                )
    return Task(
        dataset=MemoryDataset(samples, name=f"{settings.graph}, {part}"),
        solver=conversation(begin),
        scorer=goal_made(),
        version=settings.texts[:12],
        metadata=_metadata(settings, len(samples)),
    )


@task
def discovery(
    graph: str = "everyday",
    attempts: int = ATTEMPTS,
    base: str | Sequence[str] | None = None,
    games: int = 1,
    knowledge: str = "none",
    scorer: str | None = None,
    look_ups: int = LOOK_UPS,
    refusals: int = REFUSALS,
    **unknown: Any,
) -> Task:
    """Discover as much as possible in the open-ended world, from a few things at the start.

    Args:
        graph: a graph folder, a recipe book's file, or the name of a known book.
        attempts: attempts in a game.
        base: what is known at the start; the base entities of the graph if left out.
        games: how often the game is played; Inspect's ``--epochs`` replaces it.
        knowledge: what may be looked up: none, partial (the train recipes), or scorer (what a scorer believes).
        scorer: model folder of the scorer, with ``knowledge`` scorer.
        look_ups: how often something may be looked up in a game.
        refusals: how often in a row an answer that is not understood costs nothing.
        unknown: nothing; a parameter that there is not is an error, not a warning.

    Raises:
        InspectTaskError: for a wrong parameter, or a graph or scorer that cannot be read.
    """
    from wordcraft_kg.agents.discovery import HUMAN_CURVE, HUMAN_SOURCE
    from wordcraft_kg.apps.text_agents.games import DiscoveryGames
    from wordcraft_kg.apps.text_agents.knowledge import open_knowledge

    with _readable():
        _check_names(unknown, _DISCOVERY)
        whole("games", games, 1, MAX_SIZE)
        opened = _opened(graph)
        # Inspect reads a number or a truth value from what may be the name of a thing.
        named = base if isinstance(base, list | tuple) else [base]
        start = None if base is None else [str(entity) for entity in named]
        worlds = DiscoveryGames(opened, attempts=attempts, base=start)
        known, asked, kg = open_knowledge(knowledge, opened, scorer and Path(str(scorer)))  # type: ignore[arg-type]
        settings = WordsSettings.of_world(
            worlds.env,
            opened.split,
            draws=games,
            knowledge=knowledge,
            scorer=asked,
            kg=kg,
            look_ups=whole("look_ups", look_ups, 0, MAX_SIZE),
            refusals=whole("refusals", refusals, 0, MAX_SIZE),
        )

        def begin(about: Mapping[str, Any]) -> Conversation:
            return Conversation(worlds.begin(), known, refusals=refusals, look_ups=look_ups)

        about = {"attempts": attempts, "known_at_start": len(settings.base), **_hashes(settings)}
        sample = Sample(id="world", input=_opening(begin(about)), metadata=about)
    people = {"known": {str(after): known for after, known in HUMAN_CURVE.items()}, "source": HUMAN_SOURCE}
    return Task(
        dataset=MemoryDataset([sample], name=settings.graph),
        solver=conversation(begin),
        scorer=things_known(),
        epochs=games,
        version=settings.texts[:12],
        metadata=_metadata(settings, 1, people=people),
    )


def _opening(talk: Conversation) -> list[ChatMessage]:
    return [ChatMessageSystem(content=talk.rules), ChatMessageUser(content=talk.game.state)]


def _opened(graph: str) -> "OpenedGraph":
    from wordcraft_kg.graphs.folder import open_graph

    if not isinstance(graph, str) or not graph:
        raise refuse("graph", graph, "a graph folder, a recipe book's file, or the name of a known book")
    return open_graph(graph)


def _hashes(settings: WordsSettings) -> dict[str, str]:
    return {name: getattr(settings, name) for name in ("graph_hash", "split_hash", "texts")}


def _metadata(settings: WordsSettings, games: int, people: dict[str, Any] | None = None) -> dict[str, Any]:
    return {METADATA: as_values(LoggedTask(settings=settings, games=games, people=people))}


def _check_names(unknown: Mapping[str, Any], known: Sequence[str]) -> None:
    for name in unknown:
        raise UnknownSettingError(
            f"there is no parameter `{name}`; expected one of {', '.join(known)}.{nearest(name, known)}"
        )


@contextmanager
def _readable() -> Iterator[None]:
    """Turn errors of ours into those that Inspect shows without a traceback, with the parameters' names."""
    try:
        yield
    except WordCraftKGError as error:
        message = re.sub(r"`(\w+)`", lambda match: f"`{_NAMES.get(match[1], match[1])}`", str(error))
        raise InspectTaskError(message) from error
