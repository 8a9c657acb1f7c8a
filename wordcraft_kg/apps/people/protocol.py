"""The paper's protocol for people: tasks in order, answers, and comparable sessions."""

import copy
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import msgspec
import numpy as np

from wordcraft_kg.apps.people.config import MOST_TASKS, TASKS_PER_PART
from wordcraft_kg.base import (
    ArtefactError,
    ConfigError,
    GraphMismatchError,
    Hash,
    Record,
    as_values,
    whole,
)
from wordcraft_kg.envs.config import WordCraftConfig
from wordcraft_kg.envs.wordcraft import Observation, WordCraftEnv
from wordcraft_kg.envs.words import results_of, table_labels
from wordcraft_kg.envs.world import World
from wordcraft_kg.graphs.folder import GraphLike
from wordcraft_kg.graphs.recipes import Recipe

HUMAN_PARTS = ("train", "test")
"""Parts in order. The solution follows each train task, but no test task."""
Turn = tuple[str, int]
"""Part of a task, and its number there, from 1."""
# The index is part of the seeds and must never change: begun studies would pose other tasks.
_SEED_KEYS = ("all", "train", "valid", "test")


def schedule(tasks: int = TASKS_PER_PART) -> tuple[Turn, ...]:
    """Return part and number for all tasks in a session, with ``tasks`` tasks per part."""
    turns: list[Turn] = []
    for part in HUMAN_PARTS:
        turns += [(part, number) for number in range(1, tasks + 1)]
    return tuple(turns)


def episode_seed(seed: int, part: str, number: int) -> int:
    """Return the seed for an episode, independent of the episodes played before it.

    Args:
        seed: seed of the session, from 0.
        part: all, train, valid or test.
        number: number of the task in its part, from 1.

    Raises:
        ConfigError: if the seed is negative.
    """
    whole("seed", seed, 0)
    sequence = np.random.SeedSequence(seed, spawn_key=(_SEED_KEYS.index(part), number))
    return int(sequence.generate_state(1)[0])


class Header(Record):
    """The properties that comparable sessions share.

    Attributes:
        graph: name of the graph; sessions with different names are still comparable.
        graph_hash: hash of the graph.
        split_hash: hash of the split.
        settings: settings of the tasks, by name, with the tasks per part.
        seed: seed for tasks and tables.
    """

    graph: str
    graph_hash: Hash
    split_hash: Hash
    settings: dict[str, int | str]
    seed: int


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
    """

    part: str
    number: int
    goal: str
    table: tuple[str, ...]
    actions: tuple[str, ...]
    made: tuple[str, ...]
    success: bool
    seconds: float

    @property
    def is_sound(self) -> bool:
        """Whether the actions are on the table, and ``success`` and ``seconds`` are possible."""
        is_on_table = bool(self.actions) and set(self.actions) <= set(self.table)
        is_right = self.success == (self.goal in self.made)
        return is_on_table and is_right and 0 <= self.seconds < float("inf")


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
    on graph, split, distractor condition and seed. A shorter protocol is the start of a longer
    protocol.

    Attributes:
        seed: seed for tasks and tables.
        turns: part and number of each task, in order.
        world: graph, split and settings, shared by the environments of both parts.
        header: the properties that comparable sessions share.

    Source: Jiang et al. 2020, human evaluation (one person with 1 distractor, another with 8).
    """

    def __init__(
        self,
        graph: GraphLike | World,
        num_distractors: int = 8,
        seed: int = 0,
        *,
        tasks: int = TASKS_PER_PART,
    ):
        """Prepare environments for both parts, with a shared world.

        Args:
            graph: the graph with its split; a world shares what does not depend on the settings.
            num_distractors: entities on each table that the goal does not need.
            seed: seed for tasks and tables, from 0.
            tasks: tasks per part, 1 to 1,000.

        Raises:
            ConfigError: if a setting is out of range.
            TaskError: if a part has no tasks.
            RecipeFileError: if there is no such graph, or a book cannot be read.
            ArtefactError: if a graph folder is damaged.
        """
        episode_seed(seed, "train", 1)  # rejects negative seeds
        self.seed = seed
        self.turns = schedule(whole("tasks", tasks, 1, MOST_TASKS))
        self.world = World.open(graph, WordCraftConfig(num_distractors=num_distractors))
        # Environments of both parts share the world: graph, split and tables of recipes.
        self._envs = {part: WordCraftEnv(self.world.variant(part=part)) for part in HUMAN_PARTS}
        # Settings that change tasks or results; two sessions with equal values are comparable.
        setting_names = (
            "depth",
            "num_distractors",
            "attempts",
            "distractor_weighting",
            "distractor_policy",
            "task_weighting",
            "ambiguity",
        )
        settings: dict[str, int | str] = {"tasks_per_part": tasks}
        settings |= {name: getattr(self.world.config, name) for name in setting_names}
        graph = self.world.graph
        self.header = Header(graph.name, graph.hash, self.world.split.hash, settings, seed)

    def with_seed(self, seed: int) -> "HumanProtocol":
        """Return a copy that samples tasks with another seed.

        The copies share environments, which have the state of one episode: use one at a time.
        """
        protocol = copy.copy(self)
        protocol.seed = seed
        protocol.header = msgspec.structs.replace(self.header, seed=seed)
        return protocol

    def pose(self, part: str, number: int) -> tuple[WordCraftEnv, Observation]:
        """Start the episode for a task; return environment and observation."""
        # A seed for each episode: a task does not depend on how many were posed before it.
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
        results = results_of(self._envs[task.part], *actions)
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


TableKey = tuple[int, int, str, int]
"""Distractor count, seed, part, task number."""


class AgentGame(NamedTuple):
    """An agent's game at a table of people.

    Attributes:
        success: whether the agent made the goal.
        group: number of the group of tasks that the split holds out together, for resampling.
    """

    success: bool
    group: int


@dataclass(frozen=True)
class Session:
    """One participant's answers.

    Attributes:
        header: graph, split, settings and seed.
        answers: answers so far, in task order.
    """

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
        """Return the key of an answer's table: the table follows from it, graph and split."""
        return self.distractors, self.header.seed, answer.part, answer.number


def check_number(
    settings: dict[str, int | str], name: str, least: int, most: int, where: str
) -> None:
    """Check that a recorded setting is a whole number in the range.

    Args:
        settings: recorded settings by name.
        name: name of the setting.
        least: smallest permitted value.
        most: largest permitted value.
        where: file of the settings, for the error.

    Raises:
        ArtefactError: if the setting is missing, not a whole number or out of range.
    """
    value = settings.get(name)
    if not isinstance(value, int) or not least <= value <= most:
        raise ArtefactError(
            f"{where} is damaged: '{name}' is not a whole number, {least} to {most:,}."
        )


def check_alike(path: Path, header: Header, other: str, reference: Header) -> None:
    """Check that a header equals the reference.

    Args:
        path: origin of the header, for the error.
        header: the header to check.
        other: origin of the reference, for the error.
        reference: the expected header.

    Raises:
        GraphMismatchError: if the graph or split is another.
        ConfigError: if another setting differs.
    """
    have = as_values(header) | header.settings
    want = as_values(reference) | reference.settings
    del have["settings"], want["settings"]
    check_equal(f"'{path}' has", have, f"{other} has", want)


def check_equal(
    subject: str, have: Mapping[str, object], other: str, want: Mapping[str, object]
) -> None:
    """Check that two sets of settings are equal, apart from the name of the graph.

    Args:
        subject: begin of the error message, such as ``'study' has``.
        have: settings to check, by name.
        other: end of the error message, such as ``this command has``.
        want: expected settings, by name.

    Raises:
        GraphMismatchError: if a hash differs.
        ConfigError: if another setting differs.
    """
    for name in {**want, **have}:
        if name == "graph" or have.get(name) == want.get(name):
            continue
        value = str(have.get(name))
        expected = str(want.get(name))
        if name.endswith("_hash"):
            graph = f" (graph {have['graph']})" if name == "graph_hash" else ""
            raise GraphMismatchError(
                f"{subject} {name} {value[:12]}{graph}, but {other} {expected[:12]}. "
                "Nothing was changed."
            )
        raise ConfigError(f"{subject} {name} {value}, but {other} {expected}. Nothing was changed.")
