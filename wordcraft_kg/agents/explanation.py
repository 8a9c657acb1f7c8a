"""Why an agent picked what it picked: every logit of an episode, split into the contributions of the sources."""

import copy
from collections.abc import Sequence
from typing import Annotated, Any

import msgspec
import numpy as np
import torch

from wordcraft_kg.agents.evaluation import EVALUATION_SEED, PolicyPlayer
from wordcraft_kg.agents.states import States, bind_tasks, states_of
from wordcraft_kg.envs.batch import OUTCOMES, BatchEngine
from wordcraft_kg.envs.world import World
from wordcraft_kg.errors import TaskError, UnknownEntityError
from wordcraft_kg.graphs.arrays import Ids
from wordcraft_kg.models.policies.policy import Policy
from wordcraft_kg.models.policies.sources import ALPHA
from wordcraft_kg.models.policies.sources.source import Source
from wordcraft_kg.models.scorers.recipes import Witness
from wordcraft_kg.progress import steps
from wordcraft_kg.records import Record, Share
from wordcraft_kg.settings import nearest

TOLD = 3
"""Pairs of each pick for which the recipes that speak for them are told."""


class SlotEvidence(Record):
    """Which train recipes say that a slot is part of a pair that makes the goal.

    Attributes:
        source: name of the source that says so.
        partner: the entity that it goes with: the one held, or its best partner on the table.
        because: the recipes that speak for the pair, those that say most first. For a train task of a cross-fitted
            scorer they are those of a model that has not seen the task's recipes.
    """

    source: str
    partner: str
    because: tuple[Witness, ...]


class ExplainedSlot(Record):
    """How an entity on the table was valued.

    Attributes:
        entity: its label.
        is_part: whether a plan makes the goal from it.
        sources: value from each source.
        contributions: λ · value for each source; they add up to ``logit``.
        logit: β.
        probability: π.
        evidence: what speaks for it; None unless a source scores recipes and knows something of the task.
    """

    entity: str
    is_part: bool
    sources: dict[str, float]
    contributions: dict[str, float]
    logit: float
    probability: Share
    evidence: SlotEvidence | None = None


class ExplainedStep(Record):
    """A pick: the entity in hand, the state's value, λ by source (empty without mixing), and all slots of the table."""

    held: str | None
    value: float
    lambdas: dict[str, float]
    picked: str
    made: tuple[str, ...]
    slots: Annotated[tuple[ExplainedSlot, ...], msgspec.Meta(min_length=1)]

    def told(self, limit: int = TOLD) -> list[tuple[str, SlotEvidence]]:
        """Return the entities of highest logit with what speaks for them; of two that name each other, the first."""
        pairs: dict[frozenset[str], tuple[str, SlotEvidence]] = {}
        for slot in sorted(self.slots, key=lambda slot: -slot.logit):
            if slot.evidence is not None and slot.evidence.because:
                pairs.setdefault(frozenset((slot.entity, slot.evidence.partner)), (slot.entity, slot.evidence))
        return list(pairs.values())[:limit]


class ExplainedEpisode(Record):
    """An episode, pick by pick; plans are written as recipes, such as "a + b -> c"."""

    goal: str
    start: tuple[str, ...]
    plans: tuple[tuple[str, ...], ...]
    outcome: str
    steps: tuple[ExplainedStep, ...]


def explain_episodes(
    policy: Policy, world: World, *, goal: str | None = None, episodes: int = 3
) -> tuple[ExplainedEpisode, ...]:
    """Play some tasks of a part greedily, on the tables of the evaluation, and record every logit of each pick.

    Everything is computed in double precision, so that the contributions add up to the logit, and the probabilities
    to 1, to 1e-9.

    Args:
        policy: a policy of this graph.
        world: graph, tasks and settings.
        goal: only tasks with this goal; None takes tasks evenly spaced over the part.
        episodes: number of episodes; a goal with fewer tasks is played again with other distractors.

    Raises:
        UnknownEntityError: if there is no such goal.
        TaskError: if no task of the part has it.
    """
    exact = copy.deepcopy(policy).double().eval()
    tasks, draws = _choose_tasks(world, goal, episodes)
    # The distractors depend on the environment's number: environment i plays task i, as in the evaluation.
    engine = BatchEngine(world, len(world.tasks), seed=EVALUATION_SEED)
    bind_tasks([exact], engine)
    found = []
    for task, draw in steps("explaining", list(zip(tasks.tolist(), draws.tolist(), strict=True))):
        engine.pose(np.arange(engine.num_envs), draw)
        found.append(_explain(exact, PolicyPlayer(policy), engine, task))
    return tuple(found)


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
            f"no {config.part} task of depth {config.depth} has the goal '{goal}'. Choose another goal, or `part` all."
        )
    numbers = np.arange(episodes)
    return rows[numbers % len(rows)], numbers // len(rows)


def _explain(exact: Policy, player: PolicyPlayer, engine: BatchEngine, row: int) -> ExplainedEpisode:
    graph, nothing = engine.world.graph, engine.nothing
    task = engine.world.tasks[row]
    parts = {label for plan in task.plans for label in plan[-1][:2]}
    names = [label.name for label in exact.labels]
    steps = []
    rng = np.random.default_rng(EVALUATION_SEED)
    outcome = 0
    while engine.attempts_left[row] > 0:
        state = states_of(engine).rows(row, row + 1)
        # The engine's memory, which the step below changes.
        goal, selection, table = state.goal.clone(), state.selection.clone(), state.table.clone()
        slots = player(engine, rng)
        with torch.no_grad():
            output = exact(goal, selection, table, task=state.task)
            evidence = _evidence(exact, state, graph.entities)
        there = [label for label in table[0].tolist() if label != nothing]
        outcome = int(engine.step_once(slots).outcome[row])
        after = [label for label in engine.table[row].tolist() if label != nothing]
        steps.append(
            ExplainedStep(
                held=graph.entities[selection[0]] if selection[0] != nothing else None,
                value=float(output.value[0]),
                lambdas=dict(zip(names, output.lambdas[0].tolist(), strict=True)) if output.lambdas is not None else {},
                picked=graph.entities[table[0, slots[row]]],
                made=graph.labels(after[len(there) :]),
                slots=_slots(exact, output, graph.labels(there), parts, evidence),
            )
        )
    return ExplainedEpisode(
        goal=task.goal,
        start=tuple(task.start),
        plans=tuple(tuple(f"{one} + {other} -> {result}" for one, other, result in plan) for plan in task.plans),
        outcome=OUTCOMES[outcome],
        steps=tuple(steps),
    )


def _evidence(exact: Policy, state: States, entities: Sequence[str]) -> list[SlotEvidence | None]:
    """Return what speaks for each slot of one state, by the first source that can tell."""
    told: list[SlotEvidence | None] = [None] * state.table.shape[1]
    for name, source in exact.sources.items():
        assert isinstance(source, Source)
        for slot, found in enumerate(source.evidence(*state)):
            if found is not None and told[slot] is None:
                because = tuple(Witness.of(speaking, entities) for speaking in found.speaking)
                told[slot] = SlotEvidence(name, entities[found.partner], because)
    return told


def _slots(
    exact: Policy,
    output: Any,
    labels: tuple[str, ...],
    parts: set[str],
    evidence: Sequence[SlotEvidence | None],
) -> tuple[ExplainedSlot, ...]:
    size = len(labels)
    logits = output.logits[0, :size]
    probabilities = torch.softmax(output.logits[0], dim=0)[:size]
    rows = []
    for i, label in enumerate(labels):
        if output.sources is None:
            sources = {ALPHA.name: float(logits[i])}
            contributions = dict(sources)
        else:
            values, lambdas = output.sources[0, :, i].tolist(), output.lambdas[0].tolist()
            sources = dict(zip((label.name for label in exact.labels), values, strict=True))
            contributions = {
                name: value * weight for (name, value), weight in zip(sources.items(), lambdas, strict=True)
            }
        logit, probability = float(logits[i]), float(probabilities[i])
        rows.append(ExplainedSlot(label, label in parts, sources, contributions, logit, probability, evidence[i]))
    return tuple(rows)
