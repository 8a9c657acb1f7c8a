"""Why an agent picked what it picked: every logit of an episode, split into what the sources contributed."""

import copy
from typing import Any

import numpy as np
import torch

from wordcraft_kg.agents.evaluation import EVALUATION_SEED, PolicyPlayer
from wordcraft_kg.envs.batch import OUTCOMES, BatchEngine
from wordcraft_kg.envs.world import World
from wordcraft_kg.errors import TaskError, UnknownEntityError
from wordcraft_kg.graphs.arrays import Ids
from wordcraft_kg.models.policies.policy import Policy
from wordcraft_kg.settings import nearest


def explain_episodes(
    policy: Policy, world: World, *, goal: str | None = None, episodes: int = 3
) -> list[dict[str, Any]]:
    """Play some tasks of a part greedily, with the tables of the evaluation, and keep what was thought at each pick.

    Everything is computed in double precision, so that the contributions add up to the logit, and the probabilities
    to 1, to 1e-9.

    Args:
        policy: of this graph.
        world: the tasks.
        goal: only tasks with this goal; None takes tasks evenly spaced over the part.
        episodes: how many; a goal with fewer tasks is played again with other distractors.

    Returns:
        a dictionary an episode: ``goal``, ``start``, ``plans``, ``outcome``, ``steps``. A step has ``held``, ``value``,
        ``lambdas`` by source, ``picked``, ``made``, and ``slots``: for each its ``entity``, ``is_part`` of the goal in
        a plan, the sources' values, their ``contributions`` λ·value, ``logit`` (β) and ``probability``.

    Raises:
        UnknownEntityError: if there is no such goal.
        TaskError: if no task of the part has it.
    """
    exact = copy.deepcopy(policy).double().eval()
    tasks, draws = _choose_tasks(world, goal, episodes)
    # The distractors depend on the environment's number: environment i plays task i, as in the evaluation.
    engine = BatchEngine(world, len(world.tasks), seed=EVALUATION_SEED)
    found = []
    for task, draw in zip(tasks.tolist(), draws.tolist(), strict=True):
        engine.pose(np.arange(engine.num_envs), draw)
        found.append(_explain(exact, PolicyPlayer(policy), engine, task))
    return found


def _choose_tasks(world: World, goal: str | None, episodes: int) -> tuple[Ids, Ids]:
    graph, tasks, config = world.graph, world.tasks, world.config
    if goal is None:
        rows = np.linspace(0, len(tasks) - 1, min(episodes, len(tasks))).astype(np.int64)
        return rows, np.zeros_like(rows)
    if goal not in graph.entities:
        raise UnknownEntityError(f"no entity '{goal}' in {graph.name}.{nearest(goal, graph.entities)}")
    rows = np.flatnonzero(tasks.goals == graph.entities.index(goal))
    if not len(rows):
        raise TaskError(
            f"no {config.part} task of depth {config.depth} has the goal '{goal}'. Choose another goal, or --part all."
        )
    numbers = np.arange(episodes)
    return rows[numbers % len(rows)], numbers // len(rows)


def _explain(exact: Policy, player: PolicyPlayer, engine: BatchEngine, row: int) -> dict[str, Any]:
    graph, nothing = engine.world.graph, engine.nothing
    task = engine.world.tasks[row]
    parts = {label for plan in task.plans for label in plan[-1][:2]}
    steps: list[dict[str, Any]] = []
    rng = np.random.default_rng(EVALUATION_SEED)
    outcome = 0
    while engine.attempts_left[row] > 0:
        state = [np.array(getattr(engine, name)[row : row + 1]) for name in ("goal", "selection", "table")]
        _, selection, table = state
        slots = player(engine, rng)
        with torch.no_grad():
            output = exact(*map(torch.from_numpy, state))
        there = [label for label in table[0].tolist() if label != nothing]
        outcome = int(engine.step_once(slots).outcome[row])
        after = [label for label in engine.table[row].tolist() if label != nothing]
        steps.append(
            {
                "held": graph.entities[selection[0]] if selection[0] != nothing else None,
                "value": float(output.value[0]),
                "lambdas": dict(zip(exact.source_names, output.lambdas[0].tolist(), strict=True))
                if output.lambdas is not None
                else {},
                "picked": graph.entities[table[0, slots[row]]],
                "made": [graph.entities[entity] for entity in after[len(there) :]],
                "slots": _slots(exact, output, [graph.entities[entity] for entity in there], parts),
            }
        )
    return {
        "goal": task.goal,
        "start": list(task.start),
        "plans": [[f"{one} + {other} -> {result}" for one, other, result in plan] for plan in task.plans],
        "outcome": OUTCOMES[outcome],
        "steps": steps,
    }


def _slots(exact: Policy, output: Any, labels: list[str], parts: set[str]) -> list[dict[str, Any]]:
    size = len(labels)
    logits = output.logits[0, :size]
    probabilities = torch.softmax(output.logits[0], dim=0)[:size]
    rows = []
    for i, label in enumerate(labels):
        row: dict[str, Any] = {"entity": label, "is_part": label in parts}
        if output.sources is None:
            sources = {"alpha": float(logits[i])}
            contributions = dict(sources)
        else:
            values, lambdas = output.sources[0, :, i].tolist(), output.lambdas[0].tolist()
            sources = dict(zip(exact.source_names, values, strict=True))
            contributions = {
                name: value * weight for (name, value), weight in zip(sources.items(), lambdas, strict=True)
            }
        row |= {"sources": sources, "contributions": contributions}
        rows.append(row | {"logit": float(logits[i]), "probability": float(probabilities[i])})
    return rows
