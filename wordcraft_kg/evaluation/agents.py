"""The figures of agents: one run, several seeds of it, or several agents with all their seeds."""

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from typing import Annotated, Any, Literal

import msgspec
import numpy as np
import torch
from numpy.typing import NDArray

from wordcraft_kg.agents.agent_folder import OpenedAgent
from wordcraft_kg.agents.evaluation import Evaluation, Evaluator, PolicyPlayer
from wordcraft_kg.agents.explanation import ExplainedEpisode, explain_episodes
from wordcraft_kg.agents.outcomes import ENDINGS, Ending
from wordcraft_kg.agents.players import random_entity, recipe_oracle
from wordcraft_kg.base.errors import ConfigError, GraphMismatchError
from wordcraft_kg.base.progress import steps
from wordcraft_kg.base.records import Count, Hash, Record, Share
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
from wordcraft_kg.evaluation.reference import ReferenceRow, pack_of, play_of
from wordcraft_kg.evaluation.training_curves import (
    CurvePoint,
    Figure,
    LambdaCurve,
    SeedCurve,
    lambda_curves,
    success_curves,
    training_figures,
)
from wordcraft_kg.graphs.arrays import Ids
from wordcraft_kg.graphs.folder import Taught
from wordcraft_kg.graphs.planner import layers
from wordcraft_kg.graphs.tasks import TaskPart, TaskSet
from wordcraft_kg.models.policies.sources.pairs import ComponentOf

_RULES = ("depth", "max_attempts", "distractor_weighting", "distractor_policy", "ambiguity")
"""Settings of the tasks that must be equal in all agents that are compared."""
_DRAWN_BY = ("task_weighting",)
"""Further ones where tasks are drawn instead of enumerated: they decide which there are."""
DISTRACTORS = (1, 8)
"""Numbers of distractors in every report, besides those trained with."""
_TRAIN_RECIPES = ((0, 0), (1, 1), (2, 2), (3, 4), (5, 8), (9, OPEN_END))
LAYERS = ((0, 3), (4, 6), (7, 9), (10, OPEN_END))
_CONFUSIONS = 10
"""Most confusions that are listed for an agent."""
NEVER = "never"
"""Layer of a goal that cannot be made from the base."""
_LINK_RANKS = ((1, 3), (4, 10), (11, 30), (31, 100), (101, OPEN_END))

_BASELINES = {"random": random_entity, "recipe oracle": recipe_oracle}
"""Scripted players at the same tables as the agents."""

Interval = tuple[float, float]
Slice = Literal["train_recipes", "layer", "link_rank"]


class SharedGraph(Record):
    """The graph that all agents play on."""

    name: str
    hash: Hash
    entities: Count
    recipes: Count


class SharedSplit(Record):
    """The split of its recipes."""

    kind: str
    seed: int
    hash: Hash


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


class AgentEntry(Record):
    """The figures of runs that differ only in the seed.

    Attributes:
        settings: settings that differ from the defaults.
        kg: knowledge graph of its scorer; None without a scorer.
        cross_fitted: number of folds of its scorer; 0 if a model that has seen them scored train tasks.
        trained_with: number of distractors in training.
        success: by the number of distractors, as ``outcomes``, the share of each ending.
        confusions: the most frequent ones with the headline's number of distractors, as ``slices`` of the tasks.
        curves: success during training, by part of the tasks.
        provenance: facts about each run, by its name.
    """

    name: str
    runs: tuple[str, ...]
    seeds: tuple[int, ...]
    checkpoints: tuple[str, ...]
    settings: dict[str, str]
    kg: Taught | None
    cross_fitted: Count
    trained_with: Count
    steps: tuple[int, ...]
    seconds: tuple[float | None, ...]
    steps_per_second: tuple[float | None, ...]
    success: dict[str, AgentSuccess]
    outcomes: dict[str, dict[Ending, Share]]
    confusions: tuple[Confusion, ...]
    slices: dict[Slice, tuple[SliceSuccess, ...]]
    curves: dict[str, tuple[CurvePoint, ...]]
    lambdas: tuple[LambdaCurve, ...]
    training: dict[Figure, tuple[SeedCurve, ...]]
    provenance: dict[str, dict[str, str]]


class BaselineSuccess(Record):
    """Success of a scripted player, by the number of distractors."""

    name: str
    success: dict[str, Share]


class AgentEpisodes(Record):
    """Explained episodes of an agent's first run."""

    agent: str
    run: str
    episodes: tuple[ExplainedEpisode, ...]


class AgentsView(Record):
    """The agent report (``report.json``).

    Attributes:
        headline: the number of distractors of the headline.
        draws: draws of distractors for each task.
        sampled_from: number of tasks of which those played are an even sample; None if all were played.
        agents: the first is the reference of comparisons.
        references: other players of the reference pack under these conditions, if it has this graph and split.
    """

    format: Literal["wordcraft-kg agent report 1"]
    graph: SharedGraph
    split: SharedSplit
    part: TaskPart
    depth: Annotated[int, msgspec.Meta(ge=1)]
    distractors: tuple[Count, ...]
    headline: Count
    draws: Annotated[int, msgspec.Meta(ge=1)]
    tasks: Annotated[int, msgspec.Meta(ge=1)]
    sampled_from: Count | None
    agents: Annotated[tuple[AgentEntry, ...], msgspec.Meta(min_length=1)]
    baselines: tuple[BaselineSuccess, ...]
    episodes: tuple[AgentEpisodes, ...]
    references: tuple[ReferenceRow, ...] = ()


class AgentSummary(Record):
    """Success of an agent, and its runs."""

    runs: tuple[str, ...]
    seeds: tuple[int, ...]
    success: dict[str, AgentSuccess]


class AgentsSummary(Record):
    """The headline of a report, and where it is."""

    report: str
    part: TaskPart
    depth: int
    agents: dict[str, AgentSummary]
    baselines: tuple[BaselineSuccess, ...]


Groups = dict[str, list[OpenedAgent]]
"""Runs by agent."""
_Found = dict[int, list[Evaluation]]
"""Evaluations of an agent's runs, by the number of distractors."""


def group_agents(agents: Sequence[OpenedAgent]) -> Groups:
    """Return runs by agent, named after its runs without their seed; runs that differ only in the seed are one agent.

    Raises:
        ConfigError: if two runs of an agent have the same seed.
    """
    by_settings: dict[Any, list[OpenedAgent]] = {}
    for agent in agents:
        inputs = tuple(agent.run.inputs.get(name) for name in ("graph", "split", "scorer"))
        config = agent.config
        key = (inputs, config.tasks, config.policy, replace(config.trainer, seed=0, device="cpu", threads=1))
        by_settings.setdefault(key, []).append(agent)
    groups: Groups = {}
    for members in by_settings.values():
        seeds = [agent.config.trainer.seed for agent in members]
        if len(set(seeds)) < len(seeds):
            names = ", ".join(agent.name for agent in members)
            raise ConfigError(f"{names}: two of these runs are the same agent with the same seed; give each once.")
        stems = {re.sub(r"[-_.]?(seed|s)?[-_]?\d+$", "", agent.name) or agent.name for agent in members}
        name = stems.pop() if len(members) > 1 and len(stems) == 1 else members[0].name
        while name in groups:
            name += "′"
        groups[name] = members
    return groups


def view_agents(
    groups: Groups,
    *,
    part: TaskPart = "test",
    distractors: Sequence[int] | None = None,
    draws: int = 5,
    episodes: int = 2,
) -> AgentsView:
    """Evaluate agents greedily on all tasks of a part, with the same tables for all agents.

    Args:
        groups: runs by agent, see :func:`group_agents`; the first agent is the reference of comparisons.
        part: part of the tasks.
        distractors: numbers of distractors. Default: 1, 8 and those trained with.
        draws: draws of distractors for each task.
        episodes: number of episodes to explain for each agent.

    Raises:
        GraphMismatchError: for runs on different graphs or splits.
        ConfigError: for runs by different rules, or if no agent can play with these distractors.
    """
    everyone = [agent for members in groups.values() for agent in members]
    first = everyone[0]
    world, played = _conditions(everyone, part, distractors)
    headline = world.config.num_distractors
    evaluators = {amount: Evaluator(world.variant(num_distractors=amount), draws=draws) for amount in played}
    plays = [(name, amount) for name, members in groups.items() for amount in played if can_play(members[0], amount)]
    found: dict[str, _Found] = {name: {} for name in groups}
    for name, amount in steps("evaluating agents", plays):
        found[name][amount] = [evaluators[amount](PolicyPlayer(agent.policy)) for agent in groups[name]]
    reference = next(iter(found.values()))
    graph, split, tasks = first.opened.graph, first.opened.split, len(evaluators[headline].tasks)
    return AgentsView(
        format="wordcraft-kg agent report 1",
        graph=SharedGraph(graph.name, graph.hash, graph.num_entities, graph.num_recipes),
        split=SharedSplit(split.config.kind, split.config.seed, split.hash),
        part=part,
        depth=first.config.tasks.depth,
        distractors=tuple(played),
        headline=headline,
        draws=draws,
        tasks=tasks,
        sampled_from=len(world.tasks) if tasks < len(world.tasks) else None,
        agents=tuple(
            _entry(name, members, world, found[name], {} if found[name] is reference else reference)
            for name, members in groups.items()
        ),
        baselines=_baselines(evaluators),
        episodes=tuple(
            AgentEpisodes(name, members[0].name, _episodes(members[0], world, episodes))
            for name, members in groups.items()
        ),
        references=_references(first, part, played),
    )


def summarise_agents(view: AgentsView, report: str) -> AgentsSummary:
    """Return the headline of a view, and where its report is."""
    agents = {agent.name: AgentSummary(agent.runs, agent.seeds, agent.success) for agent in view.agents}
    return AgentsSummary(report, view.part, view.depth, agents, view.baselines)


def _baselines(evaluators: dict[int, Evaluator]) -> tuple[BaselineSuccess, ...]:
    return tuple(
        BaselineSuccess(name, {str(amount): float(play(player).success.mean()) for amount, play in evaluators.items()})
        for name, player in _BASELINES.items()
    )


def _references(agent: OpenedAgent, part: TaskPart, played: Sequence[int]) -> tuple[ReferenceRow, ...]:
    """Return what the reference pack has under an agent's conditions, without those who play at the same tables."""
    play = play_of(agent.config.tasks, part)
    pack = pack_of(agent.opened.graph.hash, agent.opened.split.hash)
    if play is None or pack is None:
        return ()
    return tuple(row for row in pack.rows_of(play, played) if row.player not in _BASELINES)


def _conditions(
    agents: Sequence[OpenedAgent], part: TaskPart, distractors: Sequence[int] | None
) -> tuple[World, list[int]]:
    """Return the world of the headline, and the numbers of distractors that at least one agent can play with."""
    _check_alike(agents, _RULES)
    first = agents[0]
    headline = first.config.tasks.distractors
    world = World(first.opened, first.config.tasks.environment(part, headline))
    if not world.tasks.is_complete:
        _check_alike(agents, _DRAWN_BY)
    if distractors is None:
        usual = (amount for amount in DISTRACTORS if amount <= world.max_distractors)
        distractors = sorted({*usual, *(agent.config.tasks.distractors for agent in agents)})
    played = [amount for amount in distractors if any(can_play(agent, amount) for agent in agents)]
    if not played:
        raise ConfigError(f"`distractors` {list(distractors)}: an mlp plays with as many as in training, {headline}.")
    return world if headline in played else world.variant(num_distractors=played[-1]), played


def _check_alike(agents: Sequence[OpenedAgent], rules: Sequence[str]) -> None:
    """Refuse agents with different graphs, splits or rules."""
    first = agents[0]
    for agent in agents[1:]:
        if agent.opened.split.hash != first.opened.split.hash:
            raise GraphMismatchError(
                f"'{agent.name}' and '{first.name}' were trained on different graphs or splits: their tasks are not "
                "the same, and their figures cannot be compared. Train them on one graph folder."
            )
        for rule in rules:
            found, expected = getattr(agent.config.tasks, rule), getattr(first.config.tasks, rule)
            if found != expected:
                raise ConfigError(
                    f"'{agent.name}' plays with {rule} {found} and '{first.name}' with {expected}: their figures "
                    "cannot be compared."
                )


def can_play(agent: OpenedAgent, distractors: int) -> bool:
    """Whether a policy takes tables of this size; an mlp takes one size only."""
    return agent.config.policy.policy != "mlp" or distractors == agent.config.tasks.distractors


def _entry(name: str, members: list[OpenedAgent], world: World, found: _Found, reference: _Found) -> AgentEntry:
    headline = found.get(world.config.num_distractors, [])
    config = members[0].config
    return AgentEntry(
        name=name,
        runs=tuple(agent.name for agent in members),
        seeds=tuple(agent.config.trainer.seed for agent in members),
        checkpoints=tuple(agent.checkpoint for agent in members),
        settings={key: str(value) for key, value in config.differing().items() if key not in ("seed", "graph")},
        kg=members[0].run.kg,
        cross_fitted=members[0].run.cross_fitted,
        trained_with=config.tasks.distractors,
        steps=tuple(agent.metrics[-1].step if agent.metrics else 0 for agent in members),
        seconds=tuple(agent.metrics[-1].seconds if agent.metrics else None for agent in members),
        steps_per_second=tuple(agent.evaluation.steps_per_second if agent.evaluation else None for agent in members),
        success={str(amount): _success(results, reference.get(amount)) for amount, results in found.items()},
        outcomes={str(amount): _outcomes(results) for amount, results in found.items()},
        confusions=_confusions(world, headline),
        slices=_slices(members[0], world.tasks, headline),
        curves=success_curves(members),
        lambdas=tuple(lambda_curves(members)),
        training=training_figures(members),
        provenance={agent.name: agent.provenance for agent in members},
    )


def _means(found: Sequence[Evaluation]) -> list[float]:
    return [float(result.success.mean()) for result in found]


def _every(found: Sequence[Evaluation]) -> NDArray[np.bool_]:
    """Successes of all runs, shape (N tasks, runs · draws)."""
    return np.concatenate([result.success for result in found], axis=1)


def _success(found: Sequence[Evaluation], reference: Sequence[Evaluation] | None) -> AgentSuccess:
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


def _outcomes(found: Sequence[Evaluation]) -> dict[Ending, Share]:
    shares = [result.shares() for result in found]
    return {ending: float(np.mean([share[ending] for share in shares])) for ending in ENDINGS}


def _confusions(world: World, found: Sequence[Evaluation]) -> tuple[Confusion, ...]:
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


def _slices(agent: OpenedAgent, tasks: TaskSet, found: Sequence[Evaluation]) -> dict[Slice, tuple[SliceSuccess, ...]]:
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


def _episodes(agent: OpenedAgent, world: World, episodes: int) -> tuple[ExplainedEpisode, ...]:
    if agent.config.policy.policy == "mlp":
        world = world.variant(num_distractors=agent.config.tasks.distractors)
    return explain_episodes(agent.policy, world, episodes=episodes)
