"""Agents at the tables of people, for comparison."""

from collections.abc import Iterable, Sequence

import numpy as np

from wordcraft_kg.agents.agent_folder import OpenedAgent
from wordcraft_kg.agents.evaluation import PolicyPlayer
from wordcraft_kg.apps.people.protocol import HumanProtocol, PosedTask
from wordcraft_kg.apps.people.study import Session, TableKey, check_equal
from wordcraft_kg.apps.people.summary import AgentGame
from wordcraft_kg.base.errors import ArtefactError
from wordcraft_kg.envs.batch import GOAL, BatchEngine
from wordcraft_kg.envs.world import World
from wordcraft_kg.graphs.arrays import padded
from wordcraft_kg.models.policies.policy import Policy


def agent_successes(agent: OpenedAgent, sessions: Iterable[Session]) -> dict[TableKey, AgentGame]:
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
    games: dict[TableKey, AgentGame] = {}
    posed = _posed_tasks(agent, sessions)
    if posed is None:
        return games
    world, tasks = posed
    conditions = sorted({(distractors, part) for distractors, _, part, _ in tasks})
    for condition in conditions:
        distractors, part = condition
        # All tables of a condition and part are played at once: they have the same size.
        keys = [key for key in tasks if (key[0], key[2]) == condition]
        variant = world.variant(num_distractors=distractors, part=part)
        successes = _greedy_successes(agent.policy, variant, [tasks[key] for key in keys])
        groups = variant.groups[[tasks[key].index for key in keys]].tolist()
        # Groups are numbered within a condition and part, over which rates are taken.
        for key, success, group in zip(keys, successes, groups, strict=True):
            games[key] = AgentGame(success, group)
    return games


def _posed_tasks(
    agent: OpenedAgent, sessions: Iterable[Session]
) -> tuple[World, dict[TableKey, PosedTask]] | None:
    """Pose all answered tasks again, and check them; None without a session."""
    protocols: dict[int, HumanProtocol] = {}
    posed: dict[TableKey, PosedTask] = {}
    world: World | None = None
    for session in sessions:
        record = session.record
        check_equal(
            "the study has",
            {"graph_hash": record.graph_hash, "split_hash": record.split_hash},
            f"'{agent.name}' was trained on",
            {"graph_hash": agent.opened.graph.hash, "split_hash": agent.opened.split.hash},
        )
        distractors = session.cell.distractors
        if distractors not in protocols:
            # One world for all protocols: the graph is the same, and a world takes long to make.
            protocols[distractors] = HumanProtocol(world or agent.opened, distractors)
            world = protocols[distractors].world
        for answer in session.answers:
            key = session.table_of(answer)
            if key not in posed:
                posed[key] = protocols[distractors].task(*key[1:])
            if not posed[key].is_of(answer):
                raise ArtefactError(
                    f"{answer.part} task {answer.number} of seed {key[1]}, {distractors} "
                    "distractors: this version poses another task than the answered task."
                )
    return None if world is None else (world, posed)


def _greedy_successes(policy: Policy, world: World, tasks: Sequence[PosedTask]) -> list[bool]:
    """Return whether a policy makes the goal at each table, with greedy actions (depth 1).

    Ties are decided for the first slot.
    """
    engine = BatchEngine(world, len(tasks))
    tables = []
    for task in tasks:
        tables.append([world.graph.id_of(label) for label in task.table])
    indices = np.array([task.index for task in tasks])
    state = engine.pose(indices, tables=padded(tables, world.nothing))
    player = PolicyPlayer(policy)
    rng = np.random.default_rng(0)  # required by players in general; greedy actions use no chance
    success = np.zeros(len(tasks), dtype=bool)
    while (state.attempts_left > 0).any():
        state, step = engine.step_once(state, player(state, rng))
        success |= step.outcome == GOAL
    return success.tolist()
