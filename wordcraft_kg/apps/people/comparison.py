"""Agents at the tables of people, for comparison."""

from collections.abc import Iterable, Sequence

import numpy as np
import torch

from wordcraft_kg.agents.agent_folder import OpenedAgent
from wordcraft_kg.agents.evaluation import ROWS
from wordcraft_kg.agents.states import States, bind_tasks, has_train_recipes
from wordcraft_kg.apps.people.protocol import HumanProtocol, PosedTask, Session, TableKey
from wordcraft_kg.base.errors import ArtefactError, GraphMismatchError
from wordcraft_kg.base.tensors import as_tensor
from wordcraft_kg.envs.world import World
from wordcraft_kg.graphs.arrays import Ids
from wordcraft_kg.models.policies.policy import Policy
from wordcraft_kg.models.policies.sources.source import Attempts


def agent_successes(agent: OpenedAgent, sessions: Iterable[Session]) -> dict[TableKey, bool]:
    """Return whether an agent, acting greedily, makes the goal at each answered table.

    As in training, the model without a task's recipes scores a train task if the scorer is cross-fitted. Another graph
    or split is a GraphMismatchError, a table size that the agent cannot play a ConfigError.
    """
    protocols: dict[tuple[int, int], HumanProtocol] = {}
    posed: dict[TableKey, PosedTask] = {}
    world: World | None = None
    for session in sessions:
        _check_graph(agent, session)
        distractors, seed = session.distractors, session.header.seed
        if (distractors, seed) not in protocols:
            protocols[distractors, seed] = HumanProtocol(world or agent.opened, distractors, seed, tasks=session.tasks)
            world = protocols[distractors, seed].world
        for answer in session.answers:
            key = session.table_of(answer)
            if key not in posed:
                posed[key] = protocols[distractors, seed].task(answer.part, answer.number)
            if not posed[key].is_of(answer):
                raise ArtefactError(
                    f"{answer.part} task {answer.number} of seed {seed}, {distractors} distractors: "
                    "this version poses another task than the answered task."
                )
    successes: dict[TableKey, bool] = {}
    for distractors, part in sorted({(key[0], key[2]) for key in posed}):
        assert world is not None
        keys = [key for key in posed if (key[0], key[2]) == (distractors, part)]
        variant = world.variant(num_distractors=distractors, part=part)
        slots = greedy_slots(agent.policy, variant, [posed[key] for key in keys])
        for key, pair in zip(keys, slots.tolist(), strict=True):
            one, other = sorted(variant.graph.id_of(posed[key].table[slot]) for slot in pair)
            successes[key] = variant.graph.id_of(posed[key].goal) in variant.outcomes.get((one, other), ())
    return successes


def _check_graph(agent: OpenedAgent, session: Session) -> None:
    opened, header = agent.opened, session.header
    hashes = {"graph": (header.graph_hash, opened.graph.hash), "split": (header.split_hash, opened.split.hash)}
    for name, (answered, trained) in hashes.items():
        if answered != trained:
            raise GraphMismatchError(
                f"the answered tasks belong to {name} {answered[:12]}, but '{agent.name}' was trained on {name} "
                f"{trained[:12]}. Give an agent with the same graph and split."
            )


@torch.no_grad()
def greedy_slots(policy: Policy, world: World, tasks: Sequence[PosedTask]) -> Ids:
    """Return the two greedy actions of a policy at each table (N, depth 1), shape (N, 2); ties: the first slot."""
    bind_tasks([policy], world)
    table = np.full((len(tasks), world.num_slots), world.nothing)
    for row, task in enumerate(tasks):
        table[row, : len(task.table)] = [world.graph.id_of(label) for label in task.table]
    goal = as_tensor(np.array([world.graph.id_of(task.goal) for task in tasks]))
    number = as_tensor(np.array([task.index for task in tasks])) if has_train_recipes(world) else None
    selection = torch.full_like(goal, world.nothing)
    weights, device = policy.weights(), next(policy.parameters()).device
    attempts = Attempts(torch.ones_like(goal))
    actions = []
    for _ in range(2):
        states = States(goal, selection, as_tensor(table), number, attempts)
        batches = (states.rows(start, start + ROWS, device) for start in range(0, len(tasks), ROWS))
        slots = [
            policy(*batch[:3], weights, batch.task, attempts=batch.attempts).logits.argmax(1).cpu() for batch in batches
        ]
        actions.append(torch.cat(slots))
        selection = states.table.gather(1, actions[-1][:, None])[:, 0]
    return torch.stack(actions, dim=1).numpy()
