"""Agents at the tables of people, for comparison."""

from collections.abc import Iterable, Sequence

import numpy as np

from wordcraft_kg.agents.agent_folder import OpenedAgent
from wordcraft_kg.agents.evaluation import PolicyPlayer
from wordcraft_kg.apps.people.protocol import AgentGame, HumanProtocol, PosedTask, Session, TableKey
from wordcraft_kg.base.errors import ArtefactError, GraphMismatchError
from wordcraft_kg.envs.batch import GOAL, BatchEngine
from wordcraft_kg.envs.world import World
from wordcraft_kg.graphs.arrays import padded
from wordcraft_kg.models.policies.policy import Policy


def agent_successes(agent: OpenedAgent, sessions: Iterable[Session]) -> dict[TableKey, AgentGame]:
    """Return whether an agent, acting greedily, makes the goal at each answered table, and each task's group.

    As in training, the model without a task's recipes scores a train task if the scorer is
    cross-fitted. Another graph or split is a GraphMismatchError, a table size that the agent cannot
    play a ConfigError."""
    protocols: dict[tuple[int, int], HumanProtocol] = {}
    posed: dict[TableKey, PosedTask] = {}
    world: World | None = None
    for session in sessions:
        _check_graph(agent, session)
        distractors, seed = session.distractors, session.header.seed
        if (distractors, seed) not in protocols:
            protocols[distractors, seed] = HumanProtocol(
                world or agent.opened, distractors, seed, tasks=session.tasks
            )
            world = protocols[distractors, seed].world
        for answer in session.answers:
            key = session.table_of(answer)
            if key not in posed:
                posed[key] = protocols[distractors, seed].task(answer.part, answer.number)
            if not posed[key].is_of(answer):
                raise ArtefactError(
                    f"{answer.part} task {answer.number} of seed {seed}, {distractors} "
                    "distractors: "
                    "this version poses another task than the answered task."
                )
    games: dict[TableKey, AgentGame] = {}
    for distractors, part in sorted({(key[0], key[2]) for key in posed}):
        assert world is not None
        keys = [key for key in posed if (key[0], key[2]) == (distractors, part)]
        variant = world.variant(num_distractors=distractors, part=part)
        made = _greedy_successes(agent.policy, variant, [posed[key] for key in keys])
        groups = variant.groups[[posed[key].index for key in keys]].tolist()
        games.update(zip(keys, map(AgentGame, made, groups), strict=True))
    return games


def _check_graph(agent: OpenedAgent, session: Session) -> None:
    opened, header = agent.opened, session.header
    hashes = {
        "graph": (header.graph_hash, opened.graph.hash),
        "split": (header.split_hash, opened.split.hash),
    }
    for name, (answered, trained) in hashes.items():
        if answered != trained:
            raise GraphMismatchError(
                f"the answered tasks belong to {name} {answered[:12]}, but '{agent.name}' was "
                f"trained on {name} "
                f"{trained[:12]}. Give an agent with the same graph and split."
            )


def _greedy_successes(policy: Policy, world: World, tasks: Sequence[PosedTask]) -> list[bool]:
    """Return whether a policy's two greedy actions at each table (depth 1) make the goal; ties: the first slot."""
    engine = BatchEngine(world, len(tasks))
    tables = padded(
        [[world.graph.id_of(label) for label in task.table] for task in tasks], world.nothing
    )
    state = engine.pose(np.array([task.index for task in tasks]), tables=tables)
    player, rng = PolicyPlayer(policy), np.random.default_rng(0)
    state, _ = engine.step_once(state, player(state, rng))
    _, step = engine.step_once(state, player(state, rng))
    return (step.outcome == GOAL).tolist()
