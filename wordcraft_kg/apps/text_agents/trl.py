"""Crafting games to train language models in: an environment and a data set for TRL.

TRL's ``GRPOTrainer(environment_factory=CraftingEnvironment)`` makes an environment for each
rollout, calls ``reset`` with a row of the data set, offers the public methods as tools, and asks
for the reward at the end. The classes are plain: nothing here imports TRL, and any trainer that
calls tools can use them::

    rows = crafting_rows("everyday", part="train", depth=2)
    environment = CraftingEnvironment()
    environment.reset(**rows[0])
    environment.combine("water", "flour")
    environment.get_reward()

A row names a task and its table completely, so all rollouts of a group play the same game, and a
game can be replayed from its row and its pairs.
"""

from collections.abc import Iterable, Mapping, Sequence
from functools import lru_cache
from itertools import chain, product, zip_longest
from typing import TYPE_CHECKING, Any, Literal

from wordcraft_kg.apps.text_agents.conversation import Conversation, Seat
from wordcraft_kg.apps.text_agents.plays import chosen_tasks, open_play, tool_opening
from wordcraft_kg.apps.text_agents.settings import LOOK_UPS, LookUps
from wordcraft_kg.base import ConfigError, whole
from wordcraft_kg.base.extras import missing_extra
from wordcraft_kg.graphs.tasks import TaskPart

if TYPE_CHECKING:
    import datasets


_SETTINGS = (
    "graph",
    "part",
    "depth",
    "distractors",
    "attempts",
    "reward",
    "knowledge",
    "look_ups",
)
"""Columns with the arguments of :func:`~wordcraft_kg.apps.text_agents.plays.open_play`."""
COLUMNS = (*_SETTINGS, "split_hash", "task", "distractor_seed", "goal")
"""The columns of a row that name a game: the rest of a row is for the trainer.

``split_hash`` is the content hash of the graph's split, so that a row never plays another task;
``task`` is the index of the task in its part, ``distractor_seed`` the seed of the distractors, and
``goal`` the label of the entity to make.
"""

_PLAYS_IN_MEMORY = 32
"""Opened graphs with settings: more than a mixture of depths and numbers of distractors needs."""
# Thousands of rollouts share the games.
_shared_play = lru_cache(maxsize=_PLAYS_IN_MEMORY)(open_play)


def begin_row(row: Mapping[str, Any]) -> Conversation:
    """Begin the game that a row of a data set names.

    A row may be years old, and come from elsewhere: each fact that it states is checked.

    Raises:
        ConfigError: if a column is missing, the graph, its split, the task or the name is not that
            of the row, or a value is out of range.
        RecipeFileError: if there is no such graph, or a book cannot be read.
        TaskError: if the graph has no task for these settings.
    """
    missing = [name for name in COLUMNS if row.get(name) is None]
    if missing:
        raise ConfigError(
            f"the row has no column '{missing[0]}'; expected the columns {', '.join(COLUMNS)}. "
            "Make the data set with crafting_dataset."
        )
    play = _shared_play(*(row[name] for name in _SETTINGS))
    talk = play.begin(row["task"], row["distractor_seed"])
    facts = {
        "split_hash": play.settings.split_hash,
        "goal": talk.game.goal,
        "task_id": talk.name,
    }
    for name, value in facts.items():
        # A row may have no name: its columns say everything.
        if row.get(name) not in (None, value):
            raise ConfigError(
                f"the row's {name} is {str(row[name])[:100]!r}, and its game has {value!r}: the "
                f"row was changed, or made for another split of '{row['graph']}', in which its "
                "task may be a test task. Make the data set again with crafting_dataset."
            )
    return talk


class CraftingEnvironment(Seat):
    """A crafting game, played by the tool ``combine``.

    An invalid call costs nothing, but after three in a row the next one costs an attempt, so that
    every game ends. Calls after the end change nothing. The attribute ``talk`` is the game's
    conversation, with counts of invalid calls and look-ups.
    """

    def reset(self, **row: Any) -> str | None:
        """Begin the game of a row from :func:`crafting_rows`.

        Args:
            row: the columns :data:`COLUMNS`; others, such as ``prompt``, are for the trainer.

        Returns:
            None if the row has a prompt, which contains the game's rules and state; else both.

        Raises:
            ConfigError: for a row that names no game, or another than it did when it was made.
        """
        self.talk = begin_row(row)
        return None if row.get("prompt") else tool_opening(self.talk)

    def combine(self, first: str, second: str) -> str:
        """Combine two items on the table. This takes an attempt.

        Args:
            first: name or number of an item on the table.
            second: name or number of an item on the table; it can be the first item again.

        Returns:
            What the pair makes, and the new state of the game.
        """
        talk = self._begun
        return talk.after_the_end or talk.combine(str(first), str(second))

    def get_reward(self) -> float:
        """Return the reward so far: 1 for the goal, and the row's shaped rewards."""
        return self._begun.game.reward


class SetCraftingEnvironment(CraftingEnvironment):
    """A crafting game for rows of a graph whose recipes have other sizes than two."""

    def combine(self, items: list[str]) -> str:  # type: ignore[override] # another tool
        """Combine items on the table. This takes an attempt.

        Args:
            items: names or numbers of items on the table, each as often as it is needed.

        Returns:
            What the items make, and the new state of the game.
        """
        talk = self._begun
        return talk.after_the_end or talk.combine(*map(str, items))


class TableEnvironment(CraftingEnvironment):
    """A crafting game with the tool ``table`` besides, for models that lose sight of the state."""

    def table(self) -> str:
        """Show the goal, the items on the table and the attempts left. This takes no attempt."""
        talk = self._begun
        return talk.after_the_end or talk.game.state


class LookUpEnvironment(CraftingEnvironment):
    """A crafting game with the tool ``look_up`` besides, for rows with ``knowledge`` partial."""

    def look_up(self, item: str) -> str:
        """Look up the known recipes of an item. This takes no attempt.

        Args:
            item: name of any item.

        Returns:
            The recipes that use or make the item, and the state of the game.
        """
        talk = self._begun
        return talk.after_the_end or talk.look_up_item(str(item))


def crafting_rows(  # noqa: PLR0913 - each argument is a keyword of its own for a user
    graph: str = "everyday",
    *,
    part: TaskPart = "train",
    depth: int | Sequence[int] = 1,
    distractors: int | Sequence[int] = 8,
    attempts: int | None = None,
    reward: Literal["sparse", "official"] = "sparse",
    knowledge: LookUps = "none",
    look_ups: int = LOOK_UPS,
    tables: int = 1,
    tasks: int | None = None,
    difficulty: tuple[float, float] | None = None,
) -> list[dict[str, Any]]:
    """Return rows for :class:`CraftingEnvironment`: a game each, with a prompt.

    Args:
        graph: graph folder, recipe book file, or name of a built-in book.
        part: tasks of the split: train, valid, test or all.
        depth: depth or depths, 1 to 5.
        distractors: number or numbers of entities on the table that no plan needs.
        attempts: attempts in a game; None means the depth.
        reward: sparse, or official (shaped as in the paper's released code).
        knowledge: look-ups, with :class:`LookUpEnvironment`: none or partial.
        look_ups: look-ups in a game.
        tables: tables for each task, with other distractors.
        tasks: number of tasks of each depth, evenly spaced over the part; None means all.
        difficulty: least and largest measured difficulty of the tasks, such as ``(.2, .8)``: the
            share of games that nearest words, a learner and a planner lose; None means all.

    Returns:
        dictionaries with the columns :data:`COLUMNS`, ``task_id`` (a name of the game) and
        ``prompt`` (a list with a user's message), grouped by depth and number of distractors.

    Raises:
        ConfigError: for a value out of range.
        TaskError: if the graph has no task for these settings.
        RecipeFileError: if there is no such graph, or a book cannot be read.
    """
    whole("tables", tables, 1)
    rows = []
    depths = (depth,) if isinstance(depth, int) else depth
    numbers = (distractors,) if isinstance(distractors, int) else distractors
    for each_depth, number in product(depths, numbers):
        num_attempts = each_depth if attempts is None else attempts
        play = _shared_play(
            graph, part, each_depth, number, num_attempts, reward, knowledge, look_ups
        )
        task_numbers = chosen_tasks(play.world, tasks, difficulty).tolist()
        for task, seed in product(task_numbers, range(tables)):
            # The game is begun for its goal and first message, and begun again from the row.
            talk = play.begin(task, seed)
            row = {
                "task_id": talk.name,
                "graph": graph,
                "split_hash": play.settings.split_hash,
                "part": part,
                "depth": each_depth,
                "distractors": number,
                "attempts": num_attempts,
                "reward": reward,
                "knowledge": knowledge,
                "look_ups": look_ups,
                "task": task,
                "distractor_seed": seed,
                "goal": str(talk.game.goal),
                "prompt": [{"role": "user", "content": tool_opening(talk)}],
            }
            rows.append(row)
    return rows


def in_turn(rows: Iterable[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return rows with their depths in turn, 1, 2, 3, 1, 2, 3, as long as a depth has rows."""
    by_depth: dict[int, list[dict[str, Any]]] = {}
    for row in rows:
        by_depth.setdefault(row["depth"], []).append(row)
    turns = chain.from_iterable(zip_longest(*by_depth.values()))
    return [row for row in turns if row is not None]


def crafting_dataset(graph: str = "everyday", **settings: Any) -> "datasets.Dataset":
    """Return the rows of :func:`crafting_rows`, with the same arguments, as a data set for TRL.

    Raises:
        MissingExtraError: without the package datasets, which TRL requires itself.
        ConfigError, TaskError, RecipeFileError: as :func:`crafting_rows`.
    """
    rows = crafting_rows(graph, **settings)
    try:
        from datasets import Dataset
    except ModuleNotFoundError:
        raise missing_extra("trl", ["datasets"]) from None
    return Dataset.from_list(rows)
