"""The paper's protocol for people: tasks in order, and answers."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from wordcraft_kg.apps.people.study_config import TASKS_PER_PART
from wordcraft_kg.base import Record
from wordcraft_kg.envs.words import results_of
from wordcraft_kg.envs.world import World
from wordcraft_kg.envs.world_config import WordCraftConfig
from wordcraft_kg.graphs import GraphLike, Recipe

HUMAN_PARTS = ("train", "test")
"""Parts in order. The solution follows each train task, but no test task."""
Turn = tuple[str, int]
"""Part of a task, and its number there, from 1."""
# The index is part of the seeds and must never change: begun studies would pose other tasks.
_SEED_KEYS = ("all", "train", "valid", "test")


def schedule(tasks: int = TASKS_PER_PART) -> tuple[Turn, ...]:
    """Return part and number for all tasks in a session, with ``tasks`` tasks per part."""
    return tuple(product(HUMAN_PARTS, range(1, tasks + 1)))


def episode_seed(seed: int, part: str, number: int) -> int:
    """Return the seed for an episode, independent of the episodes played before it.

    Args:
        seed: seed of the session, from 0.
        part: all, train, valid or test.
        number: number of the task in its part, from 1.
    """
    sequence = np.random.SeedSequence(seed, spawn_key=(_SEED_KEYS.index(part), number))
    return int(sequence.generate_state(1)[0])


def _drawn(world: World, seed: int) -> tuple[int, list[int]]:
    """Draw the index of a task and the ids on its table, in the order of the slots.

    Not by :mod:`wordcraft_kg.envs.draws`, though of the same distribution: a study stores its seed
    alone, and these draws must never change.
    """
    uniform = _uniform(seed)
    task = int(next(uniform) * len(world.tasks))
    table = world.without_nothing(world.tasks.starts[task].tolist())
    size = len(table) + int(world.num_drawn[task])
    taken = {int(world.tasks.goals[task]), *table}
    weight_ends = np.cumsum(world.distractor_weights)
    while len(table) < size:
        share = int(next(uniform) * weight_ends[-1])
        entity = int(np.searchsorted(weight_ends, share, side="right"))
        if entity not in taken:
            taken.add(entity)
            table.append(entity)
    # The shuffle of Fisher and Yates.
    for last in range(size - 1, 0, -1):
        place = int(next(uniform) * (last + 1))
        table[last], table[place] = table[place], table[last]
    return task, table


def _uniform(seed: int) -> Iterator[float]:
    """Yield the uniform numbers of a seed."""
    rng = np.random.default_rng(seed)
    while True:
        yield from reversed(rng.random(1_024).tolist())


class Answer(Record):
    """An answer to a task, without data about person or machine.

    Attributes:
        part: train or test.
        number: number of the task in its part, from 1.
        goal: entity to make.
        table: entities on the table, in the order of the slots.
        actions: the entities that the person combined, two or a set.
        made: results of these entities; empty if they have no recipe.
        success: whether the goal is among the results.
        seconds: time from the first page load to the last action, by the server's clock.
        loads: number of page loads for the task, more than 1 after a reload or a return; 0 for an
            answer that is not stored yet.
    """

    part: str
    number: int
    goal: str
    table: tuple[str, ...]
    actions: tuple[str, ...]
    made: tuple[str, ...]
    success: bool
    seconds: float
    loads: int = 0

    @property
    def is_sound(self) -> bool:
        """Whether the actions of a stored answer are on the table, and its figures are possible."""
        is_on_table = bool(self.actions) and set(self.actions) <= set(self.table)
        is_right = self.success == (self.goal in self.made)
        is_timed = 0 <= self.seconds < float("inf") and self.loads >= 1
        return is_on_table and is_right and is_timed


@dataclass(frozen=True)
class PosedTask:
    """A task as a participant sees it.

    Attributes:
        part: train or test.
        number: number of the task in its part, from 1.
        goal: entity to make.
        table: entities on the table, in the order of the slots.
        plans: recipes, each of which makes the goal.
        index: number of the task among all tasks of its part, as agents know it.
    """

    part: str
    number: int
    goal: str
    table: tuple[str, ...]
    plans: tuple[Recipe, ...]
    index: int

    def is_of(self, answer: Answer) -> bool:
        """Return whether an answer has the goal and table."""
        return (self.goal, self.table) == (answer.goal, answer.table)


class HumanProtocol:
    """The protocol of the paper: 40 train tasks with feedback, then 40 test tasks.

    Tasks have depth 1 and one attempt. Tasks and tables are sampled as for agents and depend only
    on graph, split, number of distractors and seed. A shorter protocol is the start of a longer
    protocol.

    Attributes:
        world: graph, split and settings, shared by the worlds of both parts.

    Source: Jiang et al. 2020, human evaluation (one person with 1 distractor, another with 8).
    """

    def __init__(self, graph: GraphLike | World, num_distractors: int = 8):
        """Prepare the tasks of both parts.

        Args:
            graph: the graph with its split; a world shares what does not depend on the settings.
            num_distractors: entities on each table that the goal does not need.

        Raises:
            ConfigError: if the number is out of range.
            TaskError: if a part has no tasks.
            RecipeFileError: if there is no such graph, or a book cannot be read.
            ArtefactError: if a graph folder is damaged.
        """
        self.world = World.open(graph, WordCraftConfig(num_distractors=num_distractors))
        self._worlds = {part: self.world.variant(part=part) for part in HUMAN_PARTS}

    @property
    def settings(self) -> dict[str, int | str]:
        """Settings that change tasks or results, without the number of distractors."""
        names = ("depth", "attempts", "distractor_weighting")
        return {name: getattr(self.world.config, name) for name in names}

    def task(self, seed: int, part: str, number: int) -> PosedTask:
        """Return a task.

        Args:
            seed: seed of the session, from 0.
            part: train or test.
            number: number of the task in its part, from 1.
        """
        # A seed for each episode: a task does not depend on how many were posed before it.
        world = self._worlds[part]
        index, table = _drawn(world, episode_seed(seed, part, number))
        task = world.tasks[index]
        plans = tuple(plan[0] for plan in task.plans)
        return PosedTask(part, number, task.goal, world.graph.labels(table), plans, index)

    @property
    def most_picks(self) -> int:
        """Most entities of an answer if recipes have other sizes than two; 0 for pairs."""
        return self.world.graph.most_ingredients if self.world.has_combine else 0

    def answer(self, task: PosedTask, slots: Sequence[int], seconds: float) -> Answer:
        """Return the answer of a person who selects slots of a task.

        Args:
            task: a task of this protocol.
            slots: two slots, or as many as a set has, from 0; they may be equal.
            seconds: time for the answer, rounded to hundredths.

        Raises:
            IndexError: for a slot beyond the table.
        """
        actions = tuple(map(task.table.__getitem__, slots))
        results = results_of(self._worlds[task.part], *actions)
        return Answer(
            part=task.part,
            number=task.number,
            goal=task.goal,
            table=task.table,
            actions=actions,
            made=results,
            success=task.goal in results,
            seconds=round(seconds, 2),
        )
