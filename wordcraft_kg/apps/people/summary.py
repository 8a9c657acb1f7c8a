"""Success rates of people in the protocol of the paper, and of agents at the same tables."""

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from functools import cache, partial
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from wordcraft_kg.apps.people.protocol import HUMAN_PARTS, Answer, HumanProtocol, PosedTask
from wordcraft_kg.apps.people.study import (
    Session,
    StudyRecord,
    TableKey,
    check_equal,
)
from wordcraft_kg.base import ArtefactError, ConfigError, Count, Record, Share
from wordcraft_kg.base.statistics import bootstrap, interval, wilson_interval
from wordcraft_kg.envs.batch import GOAL, BatchEngine
from wordcraft_kg.envs.world import World
from wordcraft_kg.envs.world_config import WordCraftConfig
from wordcraft_kg.graphs import padded

if TYPE_CHECKING:
    from wordcraft_kg.agents.agent_folder import OpenedAgent
    from wordcraft_kg.models.policies.policy import Policy


class AgentGame(NamedTuple):
    """An agent's game at a table of people.

    Attributes:
        success: whether the agent made the goal.
        group: number of the group of tasks that the split holds out together, for resampling.
    """

    success: bool
    group: int


class AgentRate(Record):
    """An agent's results on people's tables, once per answer.

    Attributes:
        successes: answers at whose table the agent makes the goal.
        rate: their share.
        tables: number of different tables.
        interval: 95 % interval of the rate, a bootstrap over groups of tasks, or Wilson's if all
            results are equal; None for a single group.
    """

    successes: Count
    rate: Share
    tables: Count
    interval: tuple[Share, Share] | None


class AnswerRate(Record):
    """Number and share of correct answers.

    Attributes:
        answered: number of answers.
        successes: number of correct answers.
        rate: their share; None without answers.
        interval: 95 % Wilson interval of the rate, for independent answers, and so for these people
            only; None without answers.
        people: number of people who gave the answers.
        people_interval: 95 % interval by bootstrap over people, who differ, or Wilson's with people
            as trials if all answers are equal; None for a single person.
        agents: agents at the same tables, by name.
    """

    answered: Count
    successes: Count
    rate: Share | None
    interval: tuple[Share, Share] | None
    people: Count
    people_interval: tuple[Share, Share] | None
    agents: dict[str, AgentRate]


class PeopleCondition(Record):
    """People in one distractor condition.

    Attributes:
        distractors: distractors on each table.
        sessions: number of people who have begun.
        finished: number of people who have answered all tasks.
        parts: correct answers by part, train and test.
    """

    distractors: Count
    sessions: Count
    finished: Count
    parts: dict[str, AnswerRate]


class HumanSummary(Record):
    """Sessions with equal graph, split and settings, by distractor condition.

    Attributes:
        graph: name of the graph.
        graph_hash: hash of the graph.
        settings: settings that the sessions share, by name.
        conditions: results by number of distractors, ascending.
    """

    graph: str
    graph_hash: str
    settings: dict[str, int | str]
    conditions: tuple[PeopleCondition, ...]


def view_people(
    studies: Mapping[Path, Sequence[Session]],
    agents: Mapping[str, Mapping[TableKey, AgentGame]],
) -> HumanSummary:
    """Return success rates over the sessions of one or several studies.

    Args:
        studies: sessions of each study by its folder.
        agents: games of each agent at people's tables, by name and table.

    Raises:
        ArtefactError: if two studies have the same answers, which would count twice.
        GraphMismatchError: if the graphs or splits differ.
        ConfigError: if settings of the tasks differ, or there is no session.
    """
    sessions = list(chain.from_iterable(studies.values()))
    if not sessions:
        raise ConfigError("no session: expected a study with participants.")
    record = sessions[0].record
    # Studies may differ in conditions and forms, that is, in distractors and seeds.
    shared = _task_settings(record)
    folders: dict[tuple[tuple[Answer, ...], ...], Path] = {}
    for path, of_study in studies.items():
        for session in of_study:
            check_equal(
                f"'{path}' has", _task_settings(session.record), "another study has", shared
            )
        answers = tuple(session.answers for session in of_study)
        if answers in folders:
            raise ArtefactError(
                f"{path} has the same answers as {folders[answers]}; give each study once."
            )
        if any(answers):  # studies without answers are equal without being the same
            folders[answers] = path
    by_amount = defaultdict[int, list[Session]](list)
    for session in sessions:
        by_amount[session.person.cell.distractors].append(session)
    return HumanSummary(
        graph=record.graph,
        graph_hash=record.graph_hash,
        settings=record.settings,
        conditions=tuple(
            PeopleCondition(
                distractors=amount,
                sessions=len(by_amount[amount]),
                finished=sum(session.is_finished for session in by_amount[amount]),
                parts={part: _rate(part, by_amount[amount], agents) for part in HUMAN_PARTS},
            )
            for amount in sorted(by_amount)
        ),
    )


def _task_settings(record: StudyRecord) -> dict[str, int | str]:
    return {
        "graph": record.graph,
        "graph_hash": record.graph_hash,
        "split_hash": record.split_hash,
        **record.settings,
    }


def _rate(
    part: str, sessions: Sequence[Session], agents: Mapping[str, Mapping[TableKey, AgentGame]]
) -> AnswerRate:
    """Return the rate of correct answers in a part, and of agents at the same tables."""
    people: list[int] = []
    keys: list[TableKey] = []
    correct: list[bool] = []
    # People are numbered anew over all studies, since numbers of two studies overlap.
    for person, session in enumerate(sessions):
        for answer in session.answers:
            if answer.part == part:
                people.append(person)
                keys.append(session.table_of(answer))
                correct.append(answer.success)
    number = len(correct)
    successes = sum(correct)
    return AnswerRate(
        answered=number,
        successes=successes,
        rate=successes / number if number else None,
        interval=wilson_interval(successes, number) if number else None,
        people=len(set(people)),
        people_interval=_resampled(
            np.array(correct, dtype=float), np.array(people, dtype=np.int64)
        ),
        agents={name: _agent_rate(games, keys) for name, games in agents.items() if keys},
    )


def _agent_rate(games: Mapping[TableKey, AgentGame], keys: Sequence[TableKey]) -> AgentRate:
    won = np.array([games[key].success for key in keys], dtype=float)
    groups = np.array([games[key].group for key in keys], dtype=np.int64)
    return AgentRate(
        successes=int(won.sum()),
        rate=float(won.mean()),
        tables=len(set(keys)),
        interval=_resampled(won, groups),
    )


def _resampled(
    correct: NDArray[np.float64], clusters: NDArray[np.int64]
) -> tuple[float, float] | None:
    """Return the interval of a mean over people or groups of tasks; None if there is only one.

    If all answers are equal, all resamples are equal too, and the bootstrap interval would be a
    point. Wilson's interval has a width; its trials are the clusters, not the answers, since the
    answers of a person (or the tasks of a group) resemble each other.
    """
    number = len(np.unique(clusters))
    if number < 2:
        return None
    if correct.min() == correct.max():
        return wilson_interval(int(correct[0]) * number, number)
    return interval(bootstrap(correct, clusters))


def agent_successes(agent: "OpenedAgent", sessions: Iterable[Session]) -> dict[TableKey, AgentGame]:
    """Return an agent's games at the tables that people have answered; the agent acts greedily.

    If the agent's scorer is cross-fitted, a train task is scored by the model without the task's
    recipes, as in training. Otherwise the agent would know the solutions of the train tasks.

    Args:
        agent: an opened agent.
        sessions: people's sessions, of any number of conditions and seeds.

    Returns:
        For each answered table whether the agent makes the goal, and the task's resampling group.

    Raises:
        GraphMismatchError: if the agent was trained on another graph or split.
        ArtefactError: if this version poses another task than the answered task.
        ConfigError: if the agent cannot play at tables of that size.
    """
    # One world for all conditions: the graph is the same, and a world takes long to make. Any
    # graph has room for its tables.
    world = World.open(agent.opened, WordCraftConfig(num_distractors=0))
    tasks = _posed_tasks(agent, world, sessions)
    games: dict[TableKey, AgentGame] = {}
    for distractors, part in sorted({(distractors, part) for distractors, _, part, _ in tasks}):
        # All tables of a condition and part are played at once: they have the same size.
        keys = [key for key in tasks if (key[0], key[2]) == (distractors, part)]
        variant = world.variant(num_distractors=distractors, part=part)
        successes = _greedy_successes(agent.policy, variant, [tasks[key] for key in keys])
        groups = variant.groups[[tasks[key].index for key in keys]].tolist()
        # Groups are numbered within a condition and part, over which rates are taken.
        for key, success, group in zip(keys, successes, groups, strict=True):
            games[key] = AgentGame(success, group)
    return games


def _posed_tasks(
    agent: "OpenedAgent", world: World, sessions: Iterable[Session]
) -> dict[TableKey, PosedTask]:
    """Pose all answered tasks again, and check them."""
    protocol_of = cache(partial(HumanProtocol, world))
    posed: dict[TableKey, PosedTask] = {}
    for session in sessions:
        record = session.record
        check_equal(
            "the study has",
            {"graph_hash": record.graph_hash, "split_hash": record.split_hash},
            f"'{agent.name}' was trained on",
            {"graph_hash": agent.opened.graph.hash, "split_hash": agent.opened.split.hash},
        )
        distractors = session.person.cell.distractors
        for answer in session.answers:
            key = session.table_of(answer)
            if key not in posed:
                posed[key] = protocol_of(distractors).task(*key[1:])
            if not posed[key].is_of(answer):
                raise ArtefactError(
                    f"{answer.part} task {answer.number} of seed {key[1]}, {distractors} "
                    "distractors: this version poses another task than the answered task."
                )
    return posed


def _greedy_successes(policy: "Policy", world: World, tasks: Sequence[PosedTask]) -> list[bool]:
    """Return whether a policy makes the goal at each table, with greedy actions (depth 1).

    Ties are decided for the first slot.
    """
    from wordcraft_kg.agents.evaluation import PolicyPlayer  # loads torch

    engine = BatchEngine(world, len(tasks))
    tables = [world.graph.ids_of(task.table).tolist() for task in tasks]
    indices = np.array([task.index for task in tasks])
    state = engine.pose(indices, tables=padded(tables, world.nothing))
    player = PolicyPlayer(policy)
    rng = np.random.default_rng(0)  # required by players in general; greedy actions use no chance
    success = np.zeros(len(tasks), dtype=bool)
    while (state.attempts_left > 0).any():
        state, step = engine.step_once(state, player(state, rng))
        success |= step.outcome == GOAL
    return success.tolist()
