"""Games that servers and trainers offer: with ids, with names, and the file of finished games.

Players of :class:`HostedGames` may reconnect by id. The memory is bounded, because anyone can begin
games: the least recent games are forgotten, and long games are recorded in part.

A name such as ``everyday-train-2-8-17-0`` says everything that a game depends on: graph, part,
depth, number of distractors, task and distractor seed. So a game of a data set, of a server and of
a file of conversations is the same game if its name is the same.
"""

import logging
import re
import secrets
from collections import OrderedDict
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

from wordcraft_kg.apps.text_agents.conversation import Conversation, Play
from wordcraft_kg.apps.text_agents.game_records import GameRecord, GamesHeader
from wordcraft_kg.apps.text_agents.results import (
    append_game,
    chosen_tasks,
    open_games,
    record_of,
)
from wordcraft_kg.apps.text_agents.settings import LOOK_UPS, GameSettings, LookUps
from wordcraft_kg.base import (
    ConfigError,
    EpisodeError,
    check_file,
    counted,
    made_folder,
    one_of,
)
from wordcraft_kg.envs.world_config import REWARDS
from wordcraft_kg.graphs.tasks import TaskPart
from wordcraft_kg.runs.run_folder import locked

_MOST_GAMES = 1_000
"""Remembered games: ten per player for a hundred players."""


class HostedGames:
    """All games on a server, open to anyone with a game's id.

    Attributes:
        play: the games.
        keep: called with each finished game; by default its messages are forgotten.
    """

    def __init__(self, play: Play, *, most: int = _MOST_GAMES):
        """Prepare to host games; at most ``most`` games are remembered."""
        self.play = play
        self._most = most
        self.keep: Callable[[Conversation], None] = lambda talk: talk.messages.clear()
        self._begun: set[tuple[int, int]] = set()
        self._hosted: OrderedDict[str, Conversation] = OrderedDict()

    def begin(self, task: int = 0, distractor_seed: int = 0) -> Conversation:
        """Begin a game, see :meth:`Play.begin`.

        On a track each game can be begun once, and open-ended games come in turn. If there are too
        many games, end and forget a game: finished games first, then the least recent.

        Raises:
            ConfigError: if there is no such task or seed.
            EpisodeError: if the game was begun before on a track, or if the forgotten game cannot
                be recorded.
        """
        settings = self.play.settings
        if settings.track and settings.is_open_ended:
            distractor_seed = len(self._begun)
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
        self._begun.add(key)
        if len(self._hosted) >= self._most:
            # `min` takes the first of equals, the least recent one: `game` moves ids to the end.
            oldest = min(self._hosted, key=lambda name: not self._hosted[name].is_over)
            try:
                self._hosted[oldest].end()
            except OSError as error:
                raise EpisodeError(
                    f"The server has no room for a game ({error.strerror}). Try again later."
                ) from None
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


class GamesWriter:
    """A file to which a server appends finished games, in the order in which they end."""

    def __init__(self, path: Path, count: int):
        """Bind the file, which is locked and has ``count`` games."""
        self._path = path
        self._count = count
        self._waiting: list[GameRecord] = []

    def __call__(self, talk: Conversation) -> None:
        """Record a finished game, and save it; a further call only tries to save it again.

        Raises:
            OSError: as :meth:`save`.
        """
        if not talk.is_recorded:
            self._waiting.append(record_of(talk, self._count))
            self._count += 1
            talk.is_recorded = True
            talk.messages.clear()
        self.save()

    def save(self) -> None:
        """Write the games that could not be written before, such as on a full disk.

        They come before all later games, so a game that went wrong is never the second of its task.

        Raises:
            OSError: if a game cannot be written; it still waits.
        """
        while self._waiting:
            append_game(self._path, self._waiting[0])
            del self._waiting[0]


@contextmanager
def games_writer(path: Path, header: GamesHeader) -> Iterator[GamesWriter]:
    """Lock a games file, and yield a function that appends a finished game with its messages.

    Args:
        path: the file; it is created if it does not exist, and continued if it does.
        header: player and settings of the games.

    Raises:
        ArtefactError: if the file is damaged, no plain file, or in use by another process.
        GraphMismatchError: if its games are of another graph or split.
        ConfigError: if its games are of another player or other settings.
    """
    with made_folder(path.parent):
        if not path.exists():
            path.touch()  # the lock needs a file
        # No device, folder or broken link: records are appended for as long as the server runs.
        check_file(path)
        with locked(path, "written"):
            writer = GamesWriter(path, len(open_games(path, header)))
            try:
                yield writer
            finally:
                try:
                    writer.save()
                except OSError as error:
                    logging.getLogger(__name__).error("games were not saved: %s", error)


_PLAYS_IN_MEMORY = 32
"""Opened graphs with settings: more than a mixture of depths and numbers of distractors needs."""
# At most nine digits: a text of digits could be a number of any size.
_NAME = re.compile(r"(?P<games>.{1,1000})-(?P<task>[0-9]{1,9})-(?P<seed>[0-9]{1,9})", re.DOTALL)
_PART = re.compile(r"-(?P<part>train|valid|test|all)-[0-9]+-[0-9]+$")


@lru_cache(maxsize=_PLAYS_IN_MEMORY)
def open_play(
    graph: str,
    part: TaskPart,
    depth: int,
    distractors: int,
    attempts: int | None,
    reward: str = "sparse",
    knowledge: LookUps = "none",
    look_ups: int = LOOK_UPS,
) -> Play:
    """Open the games with these settings, once: thousands of rollouts share them.

    Args:
        graph: graph folder, recipe book file, or name of a built-in book.
        part: tasks of the split: train, valid, test or all.
        depth: fewest attempts that solve a task.
        distractors: entities on the table that no plan needs.
        attempts: attempts in a game; None for the depth.
        reward: a name in :data:`~wordcraft_kg.envs.world_config.REWARDS`.
        knowledge: what can be looked up.
        look_ups: look-ups in a game.

    Returns:
        The games.

    Raises:
        ConfigError: for a value out of range.
        LeakError: if look-ups would leak train recipes on train tasks.
        TaskError: if the graph has no task for these settings.
        RecipeFileError: if there is no such graph, or a book cannot be read.
        ArtefactError: if a graph folder is damaged.
    """
    one_of("reward", reward, tuple(REWARDS))
    settings = GameSettings(
        part=part,
        depth=depth,
        distractors=distractors,
        attempts=attempts,
        knowledge=knowledge,
        look_ups=look_ups,
    )
    return Play.open(graph, settings, reward=reward)


def tool_opening(talk: Conversation) -> str:
    """Return the first message to a player with tools: rules, the offer of look-ups, the state."""
    lines = [talk.game.rules, "Use the tool `combine` for each attempt."]
    if talk.offers_look_ups:
        limit = counted(talk.offers_look_ups, "look-up")
        lines.append(f"The tool `look_up` shows known recipes; there are {limit}.")
    return "\n".join([*lines, "", talk.game.state])


@dataclass(frozen=True)
class NamedGame:
    """A game that a name or an index chose.

    Attributes:
        play: the games of its part, depth and number of distractors.
        task: index of the task in ``play``.
        distractor_seed: seed of the distractors on the table.
    """

    play: Play
    task: int
    distractor_seed: int = 0

    @property
    def of_task(self) -> str:
        """The game's name without the distractor seed, which all games of its task share."""
        settings = self.play.settings
        # A track numbers its tasks anew: its third task is another than the third of the part.
        games = settings.track or (
            f"{settings.graph}-{settings.part}-{settings.depth}-{settings.distractors}"
        )
        return f"{games}-{self.task}"

    @property
    def name(self) -> str:
        """The game's name, such as ``everyday-train-2-8-17-0``."""
        return f"{self.of_task}-{self.distractor_seed}"

    def begin(self) -> Conversation:
        """Begin the game; raises ConfigError for a seed out of range."""
        return self.play.begin(self.task, self.distractor_seed)


class GameList:
    """The games that a server offers: for each part its tasks in order, counted from 0.

    Attributes:
        plays: for each offered part the games, one :class:`Play` for each depth and number of
            distractors. The offered tasks of a part are numbered through all of them.

    Example:
        >>> games = GameList({"train": [open_play("kitchen", "train", 1, 2, None)]})
        >>> games.at("train", 5).name, games.named("kitchen-train-1-2-5-7").distractor_seed
        ('kitchen-train-1-2-5-0', 7)
    """

    def __init__(
        self, plays: Mapping[str, Sequence[Play]], difficulty: tuple[float, float] | None = None
    ):
        """Take the games, or those of them whose tasks have a measured difficulty in a range."""
        self.plays = plays
        self._games: dict[str, list[NamedGame]] = {}
        self._by_task: dict[str, NamedGame] = {}
        for part, of_part in plays.items():
            games = self._games[part] = []
            for play in of_part:
                for task in chosen_tasks(play.world, None, difficulty).tolist():
                    game = NamedGame(play, task)
                    games.append(game)
                    self._by_task[game.of_task] = game

    def count(self, part: str) -> int:
        """Return the number of tasks of a part; raises ConfigError for a part that is not there."""
        return len(self._of_part(part))

    def at(self, part: str, index: int, distractor_seed: int = 0) -> NamedGame:
        """Return the game with an index in a part.

        Args:
            part: the part of the tasks.
            index: number of the task in this part, from 0.
            distractor_seed: seed of the distractors on the table.

        Raises:
            ConfigError: for a part that is not offered, or an index out of range.
        """
        count = self.count(part)
        if type(index) is not int or not 0 <= index < count:
            raise ConfigError(
                f"`index` {_shown(index)}: expected a whole number from 0 to {count - 1}, a task "
                f"of the part {part}."
            )
        return replace(self._of_part(part)[index], distractor_seed=distractor_seed)

    def named(self, name: Any) -> NamedGame:
        """Return the game with a name.

        Raises:
            ConfigError: for another text, or a game that is not offered; a game of a part that is
                not offered is refused by the name of the part.
        """
        match = _NAME.fullmatch(name) if isinstance(name, str) else None
        games = match["games"] if match else ""
        if match and (game := self._by_task.get(f"{games}-{int(match['task'])}")):
            return replace(game, distractor_seed=int(match["seed"]))
        part = _PART.search(games)
        if part and part["part"] not in self.plays:
            # This raises the error for the part.
            self._of_part(part["part"])
        example = self.at(next(iter(self.plays)), 0).name
        raise ConfigError(
            f"`task_id` {_shown(name)} is no game of this server; expected a graph, a depth, a "
            f"number of distractors and a task that it has, such as '{example}'."
        )

    def _of_part(self, part: Any) -> list[NamedGame]:
        if not isinstance(part, str) or part not in self.plays:
            raise ConfigError(
                f"the part {_shown(part)} is not offered here; expected {', '.join(self.plays)}. "
                "Tasks of another part are for another use: those of the part test measure what "
                "was learned on the part train."
            )
        return self._games[part]


def _shown(value: object) -> str:
    """Return a value from outside, which may be of any length, for a message."""
    return repr(value)[:60]
