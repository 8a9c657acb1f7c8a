"""The protocol of the paper for people: tasks in order, answers, and sessions that are comparable."""

import copy
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import msgspec
import numpy as np

from wordcraft_kg.apps.people.config import MOST_TASKS, TASKS_PER_PART
from wordcraft_kg.base.errors import ArtefactError, ConfigError, GraphMismatchError
from wordcraft_kg.base.records import Hash, Record, as_values
from wordcraft_kg.base.settings import whole
from wordcraft_kg.envs.config import WordCraftConfig
from wordcraft_kg.envs.wordcraft import Observation, WordCraftEnv
from wordcraft_kg.envs.words import results_of, table_labels
from wordcraft_kg.envs.world import GraphLike, World
from wordcraft_kg.graphs.recipes import Recipe

HUMAN_PARTS = ("train", "test")
"""Parts in order. The solution follows each train task, but no test task."""
Turn = tuple[str, int]
"""Part of a task, and its number there, from 1."""
_SEED_KEYS = (
    "all",
    "train",
    "valid",
    "test",
)  # the index is part of the seeds and must never change


def schedule(tasks: int = TASKS_PER_PART) -> tuple[Turn, ...]:
    """Return part and number for all tasks in a session, with ``tasks`` tasks per part."""
    return tuple((part, number) for part in HUMAN_PARTS for number in range(1, tasks + 1))


def episode_seed(seed: int, part: str, number: int) -> int:
    """Return the seed for an episode, independent from earlier episodes; a negative seed is a ConfigError."""
    whole("seed", seed, 0)
    return int(
        np.random.SeedSequence(seed, spawn_key=(_SEED_KEYS.index(part), number)).generate_state(1)[
            0
        ]
    )


class Header(Record):
    """The properties that comparable sessions share: graph, split, settings and seed."""

    graph: str
    graph_hash: Hash
    split_hash: Hash
    settings: dict[str, int | str]
    seed: int


class Answer(Record):
    """An answer to a task, without data about person or machine; seconds are from page load to second action."""

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
        """Whether the actions are on the table, and ``success`` and ``seconds`` are possible."""
        is_right = self.success == (self.goal in self.made)
        return (
            set(self.actions) <= set(self.table) and is_right and 0 <= self.seconds < float("inf")
        )


@dataclass(frozen=True)
class PosedTask:
    """A task as a participant sees it; ``plans`` are recipes for the goal, ``index`` is the task number for agents."""

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
    """The protocol of the paper: 40 train tasks with feedback, then 40 test tasks; depth 1, one attempt.

    Tasks and tables are sampled as for agents and depend only on graph, split, distractor condition
    and seed. A shorter protocol is the start of a longer protocol."""

    def __init__(
        self,
        graph: GraphLike | World,
        num_distractors: int = 8,
        seed: int = 0,
        *,
        tasks: int = TASKS_PER_PART,
    ):
        """Prepare environments for both parts, with a shared world; a part without tasks is a TaskError."""
        episode_seed(seed, "train", 1)  # rejects negative seeds
        self.seed = seed
        self.turns = schedule(whole("tasks", tasks, 1, MOST_TASKS))
        self.world = World(graph, WordCraftConfig(num_distractors=num_distractors))
        self._envs = {part: WordCraftEnv(self.world.variant(part=part)) for part in HUMAN_PARTS}
        kept = (
            "depth",
            "num_distractors",
            "attempts",
            "distractor_weighting",
            "distractor_policy",
            "task_weighting",
        )
        settings = {"tasks_per_part": tasks} | {
            name: getattr(self.world.config, name) for name in (*kept, "ambiguity")
        }
        graph = self.world.graph
        self.header = Header(graph.name, graph.hash, self.world.split.hash, settings, seed)

    def with_seed(self, seed: int) -> "HumanProtocol":
        """Return a copy that samples tasks with another seed; the copies share environments: use one at a time."""
        other = copy.copy(self)
        other.seed, other.header = seed, msgspec.structs.replace(self.header, seed=seed)
        return other

    def pose(self, part: str, number: int) -> tuple[WordCraftEnv, Observation]:
        """Start the episode for a task; return environment and observation."""
        env = self._envs[part]
        observation, _ = env.reset(seed=episode_seed(self.seed, part, number))
        return env, observation

    def task(self, part: str, number: int) -> PosedTask:
        """Return a task for a part and number."""
        env, observation = self.pose(part, number)
        plans = tuple(plan[0] for plan in env.task.plans)
        return PosedTask(
            part, number, env.task.goal, table_labels(env, observation), plans, env.state.task
        )

    def answer(self, task: PosedTask, slots: tuple[int, int], seconds: float) -> Answer:
        """Return the answer for two slots and a time in seconds, rounded to hundredths."""
        actions = (task.table[slots[0]], task.table[slots[1]])
        made = results_of(self._envs[task.part], *actions)
        return Answer(
            task.part,
            task.number,
            task.goal,
            task.table,
            actions,
            made,
            task.goal in made,
            round(seconds, 2),
        )


TableKey = tuple[int, int, str, int]
"""Distractor count, seed, part, task number."""


class AgentGame(NamedTuple):
    """An agent's game at a table of people: whether the goal was made, and the task's resampling group."""

    success: bool
    group: int


@dataclass(frozen=True)
class Session:
    """One participant's answers in task order."""

    header: Header
    answers: tuple[Answer, ...]

    @property
    def tasks(self) -> int:
        """Number of tasks per part."""
        return int(self.header.settings["tasks_per_part"])

    @property
    def distractors(self) -> int:
        """Distractors per table."""
        return int(self.header.settings["num_distractors"])

    @property
    def is_finished(self) -> bool:
        """Whether all tasks are answered."""
        return len(self.answers) == len(schedule(self.tasks))

    def table_of(self, answer: Answer) -> TableKey:
        """Return distractor count, seed, part and task number, which determine an answer's table."""
        return self.distractors, self.header.seed, answer.part, answer.number


def check_number(
    settings: dict[str, int | str], name: str, least: int, most: int, where: str
) -> None:
    """Check that a recorded setting is a whole number in the range."""
    value = settings.get(name)
    if not isinstance(value, int) or not least <= value <= most:
        raise ArtefactError(
            f"{where} is damaged: '{name}' is not a whole number, {least} to {most:,}."
        )


def check_alike(path: Path, header: Header, other: str, reference: Header) -> None:
    """Check that a header equals the reference, with the errors of :func:`check_equal`."""
    have, want = (as_values(entry) | entry.settings for entry in (header, reference))
    del have["settings"], want["settings"]
    check_equal(f"'{path}' has", have, f"{other} has", want)


def check_equal(
    subject: str, have: Mapping[str, object], other: str, want: Mapping[str, object]
) -> None:
    """Check that settings except the graph name are equal: GraphMismatchError for a hash, else ConfigError."""
    for name in {**want, **have}:
        if name != "graph" and have.get(name) != want.get(name):
            is_hash = name.endswith("_hash")
            kind = GraphMismatchError if is_hash else ConfigError
            is_, should = (
                str(values.get(name))[: 12 if is_hash else None] for values in (have, want)
            )
            graph = f" (graph {have['graph']})" if name == "graph_hash" else ""
            raise kind(f"{subject} {name} {is_}{graph}, but {other} {should}. Nothing was changed.")
