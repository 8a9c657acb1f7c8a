"""The paper's protocol for people: tasks in order, and records for answers."""

import copy
from dataclasses import dataclass
from typing import Literal

import msgspec
import numpy as np

from wordcraft_kg.apps.people.config import MOST_TASKS, TASKS_PER_PART
from wordcraft_kg.base.records import Hash, Record
from wordcraft_kg.base.settings import whole
from wordcraft_kg.envs.config import WordCraftConfig
from wordcraft_kg.envs.wordcraft import Observation, WordCraftEnv
from wordcraft_kg.envs.words import results_of, table_labels
from wordcraft_kg.envs.world import GraphLike, World
from wordcraft_kg.graphs.recipes import Recipe

HUMAN_FORMAT: Literal["wordcraft-kg human protocol 1"] = "wordcraft-kg human protocol 1"
HUMAN_PARTS = ("train", "test")
"""Parts in their order. The answer is shown after each train task, and after no test task."""
Turn = tuple[str, int]
"""Part of a task, and its number there, from 1."""
_SEED_KEYS = ("all", "train", "valid", "test")  # a part's place goes into the seeds, so it must never change


def schedule(tasks: int = TASKS_PER_PART) -> tuple[Turn, ...]:
    """Return part and number for all tasks in a session with ``tasks`` tasks in each part."""
    return tuple((part, number) for part in HUMAN_PARTS for number in range(1, tasks + 1))


def episode_seed(seed: int, part: str, number: int) -> int:
    """Return an episode's seed, independent from earlier episodes.

    Raises:
        ConfigError: if the seed is negative.
    """
    whole("seed", seed, 0)
    return int(np.random.SeedSequence(seed, spawn_key=(_SEED_KEYS.index(part), number)).generate_state(1)[0])


class Header(Record):
    """The first line in a session's file: properties that comparable sessions share."""

    format: Literal["wordcraft-kg human protocol 1"]
    graph: str
    graph_hash: Hash
    split_hash: Hash
    settings: dict[str, int | str]
    seed: int


class Answer(Record):
    """A further line in a session's file, with nothing about the person or the machine.

    Attributes:
        part: ``train`` or ``test``.
        number: number of the task in the part, from 1.
        table: entities on the table, slot by slot.
        made: results of the picks.
        seconds: time from showing the task to the second pick.
    """

    part: str
    number: int
    goal: str
    table: tuple[str, ...]
    actions: tuple[str, str]
    made: tuple[str, ...]
    success: bool
    seconds: float

    @property
    def is_sound(self) -> bool:
        """Whether the fields agree."""
        is_right = self.success == (self.goal in self.made)
        return set(self.actions) <= set(self.table) and is_right and 0 <= self.seconds < float("inf")


@dataclass(frozen=True)
class PosedTask:
    """A person's task, see :class:`Answer`; plans are recipes for the goal, ``index`` is the number for agents."""

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
    """The paper's protocol: 40 train tasks with answers, then 40 test tasks; depth 1, single attempts.

    Tasks and tables are drawn as for agents and depend only on graph, split, number of distractors and seed; fewer
    tasks a part are the first of more tasks.

    Attributes:
        turns: part and number of each task, in order.
        header: the first line of a session's file.
    """

    def __init__(
        self, graph: GraphLike | World, num_distractors: int = 8, seed: int = 0, *, tasks: int = TASKS_PER_PART
    ):
        """Prepare the environments for both parts, sharing a given world; a part without tasks is a TaskError."""
        episode_seed(seed, "train", 1)  # refuses a negative one
        self.seed = seed
        self.turns = schedule(whole("tasks", tasks, 1, MOST_TASKS))
        self.world = World(graph, WordCraftConfig(num_distractors=num_distractors))
        self._envs = {part: WordCraftEnv(self.world.variant(part=part)) for part in HUMAN_PARTS}
        kept = ("depth", "num_distractors", "attempts", "distractor_weighting", "distractor_policy", "task_weighting")
        settings = {"tasks_per_part": tasks} | {name: getattr(self.world.config, name) for name in (*kept, "ambiguity")}
        graph = self.world.graph
        self.header = Header(HUMAN_FORMAT, graph.name, graph.hash, self.world.split.hash, settings, seed)

    def with_seed(self, seed: int) -> "HumanProtocol":
        """Return the protocol with another seed; both share environments and must not be used at once."""
        other = copy.copy(self)
        other.seed, other.header = seed, msgspec.structs.replace(self.header, seed=seed)
        return other

    def pose(self, part: str, number: int) -> tuple[WordCraftEnv, Observation]:
        """Begin a task's episode; return environment and observation."""
        env = self._envs[part]
        observation, _ = env.reset(seed=episode_seed(self.seed, part, number))
        return env, observation

    def task(self, part: str, number: int) -> PosedTask:
        """Return a task."""
        env, observation = self.pose(part, number)
        plans = tuple(plan[0] for plan in env.task.plans)
        return PosedTask(part, number, env.task.goal, table_labels(env, observation), plans, env.state.task)

    def answer(self, task: PosedTask, slots: tuple[int, int], seconds: float) -> Answer:
        """Return the answer for two slots of a task and a time in seconds, rounded to hundredths."""
        actions = (task.table[slots[0]], task.table[slots[1]])
        made = results_of(self._envs[task.part], *actions)
        return Answer(
            task.part, task.number, task.goal, task.table, actions, made, task.goal in made, round(seconds, 2)
        )
