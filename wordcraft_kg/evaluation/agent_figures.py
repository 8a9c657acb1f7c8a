"""Figures of evaluated agents: success with intervals, endings, confusions, and slices of the tasks."""

from collections import Counter
from collections.abc import Sequence
from typing import Annotated, Literal

import msgspec
import numpy as np
import torch
from numpy.typing import NDArray

from wordcraft_kg.agents.agent_folder import OpenedAgent
from wordcraft_kg.agents.evaluation import Evaluation
from wordcraft_kg.agents.outcomes import ENDINGS, Ending
from wordcraft_kg.base.records import Count, Record, Share
from wordcraft_kg.base.statistics import (
    interquartile_mean,
    paired_difference,
    probability_of_improvement,
    probability_of_improvement_interval,
    stratified_bootstrap,
    task_bootstrap,
)
from wordcraft_kg.envs.world import World
from wordcraft_kg.evaluation.bins import OPEN_END, binned
from wordcraft_kg.graphs.arrays import Ids
from wordcraft_kg.graphs.planner import layers
from wordcraft_kg.graphs.tasks import TaskSet
from wordcraft_kg.models.policies.sources.pairs import ComponentOf

_TRAIN_RECIPES = ((0, 0), (1, 1), (2, 2), (3, 4), (5, 8), (9, OPEN_END))
LAYERS = ((0, 3), (4, 6), (7, 9), (10, OPEN_END))
_CONFUSIONS = 10
"""Most confusions that are listed for an agent."""
NEVER = "never"
"""Layer of a goal that cannot be made from the base."""
_LINK_RANKS = ((1, 3), (4, 10), (11, 30), (31, 100), (101, OPEN_END))


Interval = tuple[float, float]
Slice = Literal["train_recipes", "layer", "link_rank"]


class AgentSuccess(Record):
    """An agent's success with a number of distractors; intervals are of 95 %.

    Attributes:
        iqm: mean of the middle half of the runs.
        seed_ci: interval of the mean over seeds; None for a single run.
        task_ci: interval over tasks.
        seeds: mean of each run.
        by_plan: share of episodes in which the last pair of a plan made the goal.
        difference: to the first agent on the same tasks, with an interval over tasks; None for the first agent.
        p_better: probability that a run of this agent is better than one of the first; None if both have one run.
    """

    mean: Share
    iqm: Share
    seed_ci: Interval | None
    task_ci: Interval
    seeds: Annotated[tuple[Share, ...], msgspec.Meta(min_length=1)]
    by_plan: Share
    picks: Annotated[float, msgspec.Meta(ge=0)]
    difference: Annotated[float, msgspec.Meta(ge=-1, le=1)] | None = None
    difference_ci: Interval | None = None
    p_better: Share | None = None
    p_better_ci: Interval | None = None


class SliceSuccess(Record):
    """Success on a named part of the tasks, with its 95 % interval over them."""

    slice: str
    tasks: Annotated[int, msgspec.Meta(ge=1)]
    success: Share
    ci: Interval


class Confusion(Record):
    """How many episodes ended with one right part and ``picked``, where a plan has ``wanted`` beside that part."""

    wanted: str
    picked: str
    episodes: Count


def _means(found: Sequence[Evaluation]) -> list[float]:
    return [float(result.success.mean()) for result in found]


def _every(found: Sequence[Evaluation]) -> NDArray[np.bool_]:
    """Successes of all runs, shape (N tasks, runs · draws)."""
    return np.concatenate([result.success for result in found], axis=1)


def success_of(found: Sequence[Evaluation], reference: Sequence[Evaluation] | None) -> AgentSuccess:
    """Return the success of an agent's runs, and against those of the first agent, if it is another."""
    means = _means(found)
    success = AgentSuccess(
        mean=float(np.mean(means)),
        iqm=float(interquartile_mean(means)),
        seed_ci=stratified_bootstrap(means, np.mean),
        task_ci=task_bootstrap(_every(found)),
        seeds=tuple(means),
        by_plan=float(np.mean([result.by_plan.mean() for result in found])),
        picks=float(np.mean([result.picks.mean() for result in found])),
    )
    if reference is None:
        return success
    difference, low, high = paired_difference(_every(found), _every(reference))
    success = msgspec.structs.replace(success, difference=difference, difference_ci=(low, high))
    seeds = means, _means(reference)
    if max(map(len, seeds)) == 1:  # with one run each it would be 0 or 1
        return success
    interval = probability_of_improvement_interval(*seeds)
    return msgspec.structs.replace(success, p_better=probability_of_improvement(*seeds), p_better_ci=interval)


def outcomes_of(found: Sequence[Evaluation]) -> dict[Ending, Share]:
    """Return the mean share of each ending."""
    shares = [result.shares() for result in found]
    return {ending: float(np.mean([share[ending] for share in shares])) for ending in ENDINGS}


def confusions_of(world: World, found: Sequence[Evaluation]) -> tuple[Confusion, ...]:
    """Count which entity was picked where another one was needed, in episodes that ended with one right part."""
    graph, code = world.graph, ENDINGS.index("one_right_part")
    pairs = graph.recipes[:, :2].tolist()
    counts: Counter[tuple[int, int]] = Counter()
    for result in found:
        for row, draw in np.argwhere(result.endings == code).tolist():
            plans = world.tasks.plans[int(result.tasks[row])]
            counts.update(_confused(result.last[row, draw].tolist(), [pairs[plan[-1]] for plan in plans]))
    # Ties in the order of the ids, so that the same episodes give the same list.
    most = sorted(counts.items(), key=lambda item: (-item[1], item[0]))[:_CONFUSIONS]
    return tuple(Confusion(graph.entities[wanted], graph.entities[picked], times) for (wanted, picked), times in most)


def _confused(last: list[int], plans: list[list[int]]) -> list[tuple[int, int]]:
    """Return (wanted, picked) for the first plan of which the last pair has one part; none if it has no other."""
    for a, b in plans:
        for right, wanted in ((a, b), (b, a)):
            if right in last:
                picked = last[1 - last.index(right)]
                return [(wanted, picked)] if picked != wanted else []
    return []


def slices_of(agent: OpenedAgent, tasks: TaskSet, found: Sequence[Evaluation]) -> dict[Slice, tuple[SliceSuccess, ...]]:
    """Return success by the goal's number of train recipes and layer, and by the scorer's ranks of its links."""
    if not found:
        return {}
    played, success = found[0].tasks, _every(found)
    graph, split, goals = agent.opened.graph, agent.opened.split, tasks.goals[played]
    made = np.bincount(graph.recipes[split.is_in("train"), 2], minlength=graph.num_entities)[goals]
    layer = layers(graph)[goals]
    groups: dict[Slice, list[tuple[str, NDArray[np.bool_]]]] = {
        "train_recipes": list(binned(made, _TRAIN_RECIPES)),
        "layer": [(NEVER, layer < 0), *binned(layer, LAYERS)],
    }
    ranks = _link_ranks(agent, tasks, played)
    if ranks is not None:
        groups["link_rank"] = list(binned(ranks, _LINK_RANKS))
    rows = {
        name: tuple(
            SliceSuccess(part, int(mask.sum()), float(success[mask].mean()), task_bootstrap(success[mask]))
            for part, mask in masks
            if mask.any()
        )
        for name, masks in groups.items()
    }
    return {name: slices for name, slices in rows.items() if slices}


def _link_ranks(agent: OpenedAgent, tasks: TaskSet, played: Ids) -> Ids | None:
    """Return for each task the rank by v, as the agent saw it, of the worse ingredient, the best over its plans."""
    if ComponentOf.label.name not in agent.policy.sources:
        return None
    source = agent.policy.sources[ComponentOf.label.name]
    assert isinstance(source, ComponentOf)
    recipes, size, goals = agent.opened.graph.recipes, agent.opened.graph.num_entities, tasks.goals[played]
    models = np.zeros_like(goals)
    by_task = source.reads_task and tasks.part in ("train", "all")
    if by_task:
        source.bind(tasks)
        models = source.model_of_task.cpu().numpy()[played]
    everything, nothing = torch.arange(size)[None], torch.tensor([size])
    ranks = np.empty(len(goals))
    questions = goals * (int(models.max(initial=0)) + 1) + models
    order = np.argsort(questions, kind="stable")
    # Goal by goal: the scores of all goals at once would not fit where they are computed from embeddings.
    for rows in np.split(order, np.flatnonzero(np.diff(questions[order])) + 1):
        goal, task = (torch.from_numpy(ids[rows[:1]]) for ids in (goals, played))
        scores = source(goal, nothing, everything, task if by_task else None)[0].numpy()
        for row in rows.tolist():
            parts = (recipes[plan[-1], :2] for plan in tasks.plans[played[row]])
            ranks[row] = min(max(_mean_rank(scores, scores[part]) for part in pair) for pair in parts)
    return np.ceil(ranks).astype(np.int64)


def _mean_rank(scores: NDArray[np.float32], score: np.float32) -> float:
    """Return the rank of a score; ties share their mean rank."""
    return float((scores > score).sum() + ((scores == score).sum() + 1) / 2)
