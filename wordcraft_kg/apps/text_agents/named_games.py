"""Games with names, shared by the interfaces for training: TRL, OpenEnv and conversations.

A name such as ``everyday-train-2-8-17-0`` says everything that a game depends on: graph, part,
depth, number of distractors, task and distractor seed. So a game of a data set, of a server and of
a file of conversations is the same game if its name is the same.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import chain
from typing import Any

from wordcraft_kg.apps.text_agents.conversation import Conversation, Play
from wordcraft_kg.apps.text_agents.games import TaskGames
from wordcraft_kg.apps.text_agents.settings import LOOK_UPS, EvaluationSettings, LookUps
from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.base.settings import one_of
from wordcraft_kg.base.wording import counted
from wordcraft_kg.envs.config import REWARDS
from wordcraft_kg.graphs.tasks import TaskPart

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
        reward: a name in :data:`~wordcraft_kg.envs.config.REWARDS`.
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
    settings = EvaluationSettings(
        part=part,
        depth=depth,
        distractors=distractors,
        attempts=attempts,
        knowledge=knowledge,
        look_ups=look_ups,
    )
    return Play.open(graph, settings, reward=reward)


def name_of(play: Play, task: int, distractor_seed: int) -> str:
    """Return the name of a game on a task, such as ``everyday-train-2-8-17-0``.

    Args:
        play: the games: graph, part, depth and number of distractors, or a benchmark's track.
        task: number of the task among those of the part or track, from 0.
        distractor_seed: seed of the distractors, from 0.
    """
    return f"{_name_of_games(play)}-{task}-{distractor_seed}"


def _name_of_games(play: Play) -> str:
    settings = play.settings
    # A track numbers its tasks anew: its third task is another than the third task of the part.
    return (
        settings.track
        or f"{settings.graph}-{settings.part}-{settings.depth}-{settings.distractors}"
    )


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
    def name(self) -> str:
        """The game's name."""
        return name_of(self.play, self.task, self.distractor_seed)

    def begin(self) -> Conversation:
        """Begin the game; raises ConfigError for a seed out of range."""
        return self.play.begin(self.task, self.distractor_seed)


class GameList:
    """The games that a server offers: for each part its tasks in order, counted from 0.

    Attributes:
        plays: for each offered part the games, one :class:`Play` for each depth and number of
            distractors. The tasks of a part are numbered through all of them.

    Example:
        >>> games = GameList({"train": [open_play("kitchen", "train", 1, 2, None)]})
        >>> games.at("train", 5).name, games.named("kitchen-train-1-2-5-7").distractor_seed
        ('kitchen-train-1-2-5-0', 7)
    """

    def __init__(self, plays: Mapping[str, Sequence[Play]]):
        self.plays = plays

    def count(self, part: str) -> int:
        """Return the number of tasks of a part; raises ConfigError for a part that is not there."""
        return sum(_size(play) for play in self._plays_of(part))

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
        task = index
        for play in self._plays_of(part):
            if task < _size(play):
                break
            task -= _size(play)
        return NamedGame(play, task, distractor_seed)

    def named(self, name: Any) -> NamedGame:
        """Return the game with a name.

        Raises:
            ConfigError: for another text, or a game that is not offered; a game of a part that is
                not offered is refused by the name of the part.
        """
        offered = chain.from_iterable(self.plays.values())
        by_name = {_name_of_games(play): play for play in offered}
        match = _NAME.fullmatch(name) if isinstance(name, str) else None
        games = match["games"] if match else ""
        if match and games in by_name:
            game = NamedGame(by_name[games], int(match["task"]), int(match["seed"]))
            if game.task < _size(game.play):
                return game
        part = _PART.search(games)
        if part and part["part"] not in self.plays:
            # This raises the error for the part.
            self._plays_of(part["part"])
        example = self.at(next(iter(self.plays)), 0).name
        raise ConfigError(
            f"`task_id` {_shown(name)} is no game of this server; expected a graph, a depth, a "
            f"number of distractors and a task that it has, such as '{example}'."
        )

    def _plays_of(self, part: Any) -> Sequence[Play]:
        if not isinstance(part, str) or part not in self.plays:
            raise ConfigError(
                f"the part {_shown(part)} is not offered here; expected {', '.join(self.plays)}. "
                "Tasks of another part are for another use: those of the part test measure what "
                "was learned on the part train."
            )
        return self.plays[part]


def _size(play: Play) -> int:
    assert isinstance(play.games, TaskGames)
    return len(play.games.world.tasks)


def _shown(value: object) -> str:
    """Return a value from outside, which may be of any length, for a message."""
    return repr(value)[:60]
