"""Evaluation of trained agents over all training seeds, on the same tasks."""

import re
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import chain, product
from typing import Annotated, Any, Literal

import msgspec

from wordcraft_kg.agents import players
from wordcraft_kg.agents.agent_folder import OpenedAgent
from wordcraft_kg.agents.evaluation import Evaluation, Evaluator, PolicyPlayer
from wordcraft_kg.agents.explanation import ExplainedEpisode, explain_episodes
from wordcraft_kg.agents.records import TerminationReason
from wordcraft_kg.base import ConfigError, Count, GraphMismatchError, Hash, Record, Share, steps
from wordcraft_kg.envs.world import World
from wordcraft_kg.evaluation import agent_metrics
from wordcraft_kg.evaluation.agent_metrics import EvaluatedGraph, SourceGain, source_gains
from wordcraft_kg.graphs import TaskPart, TrainedOn
from wordcraft_kg.models.policies.sources import shown_setting
from wordcraft_kg.models.scorers.neighbours.knowledge import RecipeKnowledge

_RULES = ("depth", "max_attempts", "distractor_weighting", "distractor_policy", "ambiguity")
"""Task settings that must be equal in all compared agents."""
# Enumerated tasks are equal for all agents, sampled ones only if they are sampled in the same way.
_DRAWN_BY = ("task_weighting",)
"""Further settings if tasks are sampled instead of enumerated."""
# The fewest and the most distractors of the paper.
DISTRACTORS = (1, 8)


class SharedSplit(Record):
    """The recipe split (train, valid, test) that all compared agents share.

    Attributes:
        kind: kind of the split.
        seed: seed of the split.
        hash: content hash of the split.
        unit: recipes, goals, slots or kinds: the split holds these out together, and intervals
            resample them.
    """

    kind: str
    seed: int
    hash: Hash
    unit: str


class AgentEntry(Record):
    """An agent's metrics; an agent is a group of training runs that differ only in the seed.

    Attributes:
        name: the agent's name: that of the runs without the seed, or of the first run.
        runs: names of the run folders.
        seeds: training seed of each run.
        checkpoints: checkpoint of each run that was evaluated, such as the last one.
        settings: training settings that differ from the defaults, without graph and seed.
        kg: training graph of the agent's scorer (full or partial); None for an agent without a
            scorer.
        cross_fitted: number of cross-fitting folds of the scorer; 0 if train tasks have in-sample
            scores.
        trained_with: number of distractors in training.
        steps: environment steps of each run's training.
        seconds: duration of each run's training in seconds; None if a run has no metrics.
        steps_per_second: environment steps per second of each training; None if a run is
            unfinished.
        success: success rate by distractor count.
        outcomes: share of episodes by termination reason, by distractor count.
        sources: what each source adds, with the report's `headline` count; empty without a scorer,
            or if the agent cannot play with it.
        slices: success on groups of tasks with the report's `headline` count; empty if the agent
            cannot play with it.
        curves: success during training, by task part (train or test).
        lambdas: mixing weights of the score sources during training.
        training: logged statistics of each run's training.
        provenance: facts about each run, such as command and versions, by the run's name.
    """

    name: str
    runs: tuple[str, ...]
    seeds: tuple[int, ...]
    checkpoints: tuple[str, ...]
    settings: dict[str, str]
    kg: TrainedOn | None
    cross_fitted: Count
    trained_with: Count
    steps: tuple[int, ...]
    seconds: tuple[float | None, ...]
    steps_per_second: tuple[float | None, ...]
    success: dict[str, agent_metrics.AgentSuccess]
    outcomes: dict[str, dict[TerminationReason, Share]]
    sources: dict[str, SourceGain]
    slices: dict[agent_metrics.Slice, tuple[agent_metrics.SliceSuccess, ...]]
    curves: dict[str, tuple[agent_metrics.CurvePoint, ...]]
    lambdas: tuple[agent_metrics.LambdaCurve, ...]
    training: dict[agent_metrics.TrainingMetric, tuple[agent_metrics.SeedCurve, ...]]
    provenance: dict[str, dict[str, str]]


class BaselineSuccess(Record):
    """Success of a scripted player, or of a scorer alone, at the agents' tables.

    Attributes:
        name: the player's name.
        success: success rate by distractor count.
        by_plan: share of episodes that make the goal by one of the task's plans, by distractor
            count.
    """

    name: str
    success: dict[str, Share]
    by_plan: dict[str, Share]


class AgentEpisodes(Record):
    """Example episodes of an agent, with the scores and logits for each action.

    Attributes:
        agent: the agent's name.
        run: the run that played, the agent's first.
        episodes: the episodes.
    """

    agent: str
    run: str
    episodes: tuple[ExplainedEpisode, ...]


class AgentsView(Record):
    """All numbers in a report on agents (``report.json``).

    Attributes:
        format: name and version of the format.
        graph: graph that all agents were trained on.
        split: split that all agents share.
        part: split part with the tasks.
        depth: fewest attempts that solve a task.
        distractors: distractor counts that were played.
        headline: distractor count of the report's main results.
        distractor_seeds: tables per task, with different random distractors.
        tasks: number of played tasks.
        sampled_from: number of tasks that the played ones are a sample of; None if all were played.
        agents: the agents; the first is the reference of all differences.
        baselines: scripted players, and the agents' scorers alone.
        episodes: example episodes of each agent.

    """

    format: Literal["wordcraft-kg agent report 1"]
    graph: EvaluatedGraph
    split: SharedSplit
    part: TaskPart
    depth: Annotated[int, msgspec.Meta(ge=1)]
    distractors: tuple[Count, ...]
    headline: Count
    distractor_seeds: Annotated[int, msgspec.Meta(ge=1)]
    tasks: Annotated[int, msgspec.Meta(ge=1)]
    sampled_from: Count | None
    agents: Annotated[tuple[AgentEntry, ...], msgspec.Meta(min_length=1)]
    baselines: tuple[BaselineSuccess, ...]
    episodes: tuple[AgentEpisodes, ...]


def by_success(view: AgentsView, amount: int) -> list[AgentEntry]:
    """Return the agents by success, best first; those that cannot play with so many last.

    Args:
        view: the results.
        amount: a distractor count.
    """

    def success(agent: AgentEntry) -> float:
        played = agent.success.get(str(amount))
        return -1.0 if played is None else played.mean

    return sorted(view.agents, key=success, reverse=True)


Groups = dict[str, list[OpenedAgent]]
"""Training runs by agent name; the runs of an agent differ only in the seed."""
_Results = dict[int, list[Evaluation]]
_ScorersAlone = dict[tuple[object, ...], tuple[str, dict[str, dict[int, Evaluation]]]]
"""By scorer and settings: an agent, and evaluations of the scorer alone by sources and count."""


def group_agents(agents: Sequence[OpenedAgent]) -> Groups:
    """Group runs that differ only in the seed into agents, in the order of the first runs.

    An agent has its runs' name without the seed at the end, if the runs share this name, and else
    the first run's name. A prime marks a name that is taken.

    Raises:
        ConfigError: if two runs have the same settings and seed, as when a run is given twice.
    """
    by_settings: dict[Any, list[OpenedAgent]] = {}
    for agent in agents:
        inputs = tuple(agent.run.inputs.get(name) for name in ("graph", "split", "scorer"))
        config = agent.config
        # Device and threads change the speed, so runs on two machines are seeds of one agent.
        trainer = replace(config.trainer, seed=0, device="cpu", threads=1)
        key = (inputs, config.tasks, config.policy, trainer)
        by_settings.setdefault(key, []).append(agent)
    groups: Groups = {}
    for members in by_settings.values():
        seeds = [agent.config.trainer.seed for agent in members]
        if len(set(seeds)) < len(seeds):
            names = ", ".join(agent.name for agent in members)
            raise ConfigError(
                f"{names}: two of these runs have the same settings and seed; remove the duplicate."
            )
        # Without the seed at the end, such as "-seed-3", "_s3" or "3"; a bare seed stays.
        stems = {
            re.sub(r"[-_.]?(seed|s)?[-_]?\d+$", "", agent.name) or agent.name for agent in members
        }
        has_shared_stem = len(members) > 1 and len(stems) == 1
        name = stems.pop() if has_shared_stem else members[0].name
        while name in groups:
            name += "′"
        groups[name] = members
    return groups


def view_agents(
    groups: Groups,
    *,
    part: TaskPart = "test",
    distractors: Sequence[int] | None = None,
    distractor_seeds: int | None = None,
    episodes: int = 2,
) -> AgentsView:
    """Evaluate agents greedily on all tasks of a split part, with the same tables for all agents.

    Args:
        groups: runs by agent, see :func:`group_agents`; the first agent is the reference of
            differences.
        part: split part with the tasks.
        distractors: distractor counts; None for 1, 8 and the numbers in the agents' training.
        distractor_seeds: tables per task; None as for
            :class:`~wordcraft_kg.agents.evaluation.Evaluator`.
        episodes: number of example episodes for each agent.

    Returns:
        All numbers of the report.

    Raises:
        GraphMismatchError: if the agents were trained on different graphs or splits.
        ConfigError: if their task settings differ, no agent can play with these distractors, or the
            graph has too few entities for them.
        TaskError: if the part has no tasks of the agents' depth.
    """
    everyone = list(chain.from_iterable(groups.values()))
    first = everyone[0]
    world, played = _conditions(everyone, part, distractors)
    headline = world.config.num_distractors
    evaluators = {
        amount: Evaluator(world.variant(num_distractors=amount), distractor_seeds=distractor_seeds)
        for amount in played
    }
    results: dict[str, _Results] = {name: {} for name in groups}
    # Listed before playing, so that the progress has a total.
    pairs = product(groups, played)
    plays = [(name, amount) for name, amount in pairs if can_play(groups[name][0], amount)]
    for name, amount in steps("evaluating agents", plays):
        results[name][amount] = [
            evaluators[amount](PolicyPlayer(agent.policy)) for agent in groups[name]
        ]
    scorer_results = _scorers_alone(groups, evaluators)
    gains = {}
    for name, played_by in results.items():
        # An agent that cannot play with the headline's distractors has no gains.
        if headline in played_by:
            policies = [agent.policy for agent in groups[name]]
            gains[name] = source_gains(policies, evaluators[headline], played_by[headline])
    other_labels = _made_by_other_books(everyone)
    reference = next(iter(results.values()))
    graph = first.opened.graph
    split = first.opened.split
    tasks = len(evaluators[headline].tasks)
    return AgentsView(
        format="wordcraft-kg agent report 1",
        graph=EvaluatedGraph.of(graph),
        split=SharedSplit(
            kind=split.config.kind,
            seed=split.config.seed,
            hash=split.hash,
            unit=split.unit,
        ),
        part=part,
        depth=first.config.tasks.depth,
        distractors=tuple(played),
        headline=headline,
        distractor_seeds=evaluators[headline].distractor_seeds,
        tasks=tasks,
        sampled_from=len(world.tasks) if tasks < len(world.tasks) else None,
        agents=tuple(
            _entry(
                name,
                members,
                world,
                results[name],
                # The first agent has no difference to itself.
                {} if results[name] is reference else reference,
                scorer_results,
                gains.get(name, {}),
                other_labels,
            )
            for name, members in groups.items()
        ),
        baselines=tuple(_baselines(groups, evaluators, scorer_results)),
        episodes=tuple(
            AgentEpisodes(name, of[0].name, _episodes(of[0], world, episodes))
            for name, of in groups.items()
        ),
    )


def summarise_agents(view: AgentsView, report: str) -> dict[str, Any]:
    """Return the main results in an agent report: success by agent, and the path to the report."""
    agents = {
        agent.name: {"runs": agent.runs, "seeds": agent.seeds, "success": agent.success}
        for agent in view.agents
    }
    return {
        "report": report,
        "part": view.part,
        "depth": view.depth,
        "agents": agents,
        "baselines": view.baselines,
    }


def _made_by_other_books(agents: Sequence[OpenedAgent]) -> frozenset[str] | None:
    """Return the labels that other books of any scorer make; None if no scorer has another book."""
    # One set for all agents: success is compared on the same groups of goals.
    labels_by_agent = [agent.made_by_other_books for agent in agents]
    label_sets = [labels for labels in labels_by_agent if labels is not None]
    return frozenset().union(*label_sets) if label_sets else None


def _scorers_alone(groups: Groups, evaluators: dict[int, Evaluator]) -> _ScorersAlone:
    played: _ScorersAlone = {}
    for name, members in groups.items():
        # Runs of an agent share the scorer, and so may agents: each scorer plays once.
        agent = members[0]
        if agent.policy.sources and _scores_of(agent) not in played:
            players_by_sources = players.scorer_alone(agent.policy.sources)
            results = {
                sources: _play(player, evaluators) for sources, player in players_by_sources.items()
            }
            played[_scores_of(agent)] = name, results
    return played


def _scores_of(agent: OpenedAgent) -> tuple[object, ...]:
    policy = agent.config.policy
    scorer = agent.run.inputs.get("scorer")
    return scorer, policy.use, policy.scale, policy.self_edges, policy.plan_width, policy.in_sample


def _play(player: players.Player, evaluators: dict[int, Evaluator]) -> dict[int, Evaluation]:
    return {amount: play(player) for amount, play in evaluators.items()}


def _baselines(
    groups: Groups, evaluators: dict[int, Evaluator], scorers: _ScorersAlone
) -> Iterator[BaselineSuccess]:
    first = next(iter(groups.values()))[0]
    results = {
        "random": _play(players.random_entity, evaluators),
        players.FEWEST_USES: _play(players.fewest_uses(first.opened.split), evaluators),
    }
    # Words as strong as those of each scorer; equal vectors have equal names.
    words: dict[str, players.Player] = {}
    for members in groups.values():
        words |= _words_beside(members[0])
    results |= {name: _play(player, evaluators) for name, player in words.items()}
    for agent, results_by_sources in scorers.values():
        for sources, played in results_by_sources.items():
            results[f"scorer of {agent} alone, {sources}"] = played
    # Last, as the upper bound.
    results["recipe oracle"] = _play(players.recipe_oracle, evaluators)
    for name, played in results.items():
        success = {str(amount): float(result.success.mean()) for amount, result in played.items()}
        by_plan = {str(amount): float(result.by_plan.mean()) for amount, result in played.items()}
        yield BaselineSuccess(name, success, by_plan)


def _words_beside(agent: OpenedAgent) -> dict[str, players.Player]:
    """Return the player by nearest words with the vectors of an agent's scorer, by its name."""
    knowledge = [getattr(source, "knowledge", None) for source in agent.policy.sources.values()]
    recipe_knowledge = [source for source in knowledge if isinstance(source, RecipeKnowledge)]
    return players.words_player(
        agent.opened.graph, recipe_knowledge[0] if recipe_knowledge else None
    )


def _conditions(
    agents: Sequence[OpenedAgent], part: TaskPart, distractors: Sequence[int] | None
) -> tuple[World, list[int]]:
    _check_alike(agents, _RULES)
    first = agents[0]
    headline = first.config.tasks.distractors
    world = World(first.opened, first.config.tasks.environment(part, headline))
    if not world.tasks.is_complete:
        _check_alike(agents, _DRAWN_BY)
    if distractors is None:
        # A small graph may have too few entities for eight distractors.
        usual = (amount for amount in DISTRACTORS if amount <= world.max_distractors)
        distractors = sorted({*usual, *(agent.config.tasks.distractors for agent in agents)})
    played = []
    for amount in distractors:
        if any(can_play(agent, amount) for agent in agents):
            played.append(amount)
    if not played:
        raise ConfigError(
            f"`distractors` {list(distractors)}: an mlp plays with as many as in training, "
            f"{headline}."
        )
    if headline not in played:
        world = world.variant(num_distractors=played[-1])
    return world, played


def _check_alike(agents: Sequence[OpenedAgent], rules: Sequence[str]) -> None:
    first = agents[0]
    for agent in agents[1:]:
        if agent.opened.split.hash != first.opened.split.hash:
            raise GraphMismatchError(
                f"'{agent.name}' and '{first.name}' were trained on different graphs or splits: "
                "their tasks differ, so their results cannot be compared. Train all runs on the "
                "same graph folder."
            )
        for rule in rules:
            value = getattr(agent.config.tasks, rule)
            expected = getattr(first.config.tasks, rule)
            if value != expected:
                raise ConfigError(
                    f"'{agent.name}' plays with {rule} {value} and '{first.name}' with "
                    f"{expected}: their results cannot be compared."
                )


def can_play(agent: OpenedAgent, distractors: int) -> bool:
    """Return whether an agent can play with this distractor count.

    An MLP reads slots in fixed places, so it needs the number of slots from training.
    """
    return agent.config.policy.policy != "mlp" or distractors == agent.config.tasks.distractors


def _entry(
    name: str,
    members: list[OpenedAgent],
    world: World,
    results: _Results,
    reference: _Results,
    scorers: _ScorersAlone,
    gains: dict[str, SourceGain],
    made_by_other_books: frozenset[str] | None,
) -> AgentEntry:
    headline = results.get(world.config.num_distractors, [])
    config = members[0].config
    against_scorer: dict[int, agent_metrics.AgainstScorer] = {}
    if members[0].policy.sources:
        _, scorer_results = scorers[_scores_of(members[0])]
        # The last one is p alone if the agent has it, else w alone, else all sources.
        sources, played = list(scorer_results.items())[-1]
        against_scorer = {
            amount: agent_metrics.compare_with_scorer(runs, sources, played[amount])
            for amount, runs in results.items()
        }
    return AgentEntry(
        name=name,
        runs=tuple(agent.name for agent in members),
        seeds=tuple(agent.config.trainer.seed for agent in members),
        checkpoints=tuple(agent.checkpoint for agent in members),
        settings={
            key: shown_setting(key, value)
            for key, value in config.differing().items()
            if key not in ("seed", "graph")
        },
        kg=members[0].run.kg,
        cross_fitted=members[0].run.cross_fitted,
        trained_with=config.tasks.distractors,
        steps=tuple(agent.metrics[-1].step if agent.metrics else 0 for agent in members),
        seconds=tuple(agent.metrics[-1].seconds if agent.metrics else None for agent in members),
        steps_per_second=tuple(
            agent.evaluation.steps_per_second if agent.evaluation else None for agent in members
        ),
        success={
            str(amount): agent_metrics.success_of(
                runs, reference.get(amount), against_scorer.get(amount)
            )
            for amount, runs in results.items()
        },
        outcomes={str(amount): agent_metrics.outcomes_of(runs) for amount, runs in results.items()},
        sources=gains,
        slices=agent_metrics.slices_of(members[0], world.tasks, headline, made_by_other_books),
        curves=agent_metrics.success_curves(members),
        lambdas=tuple(agent_metrics.lambda_curves(members)),
        training=agent_metrics.training_metrics(members),
        provenance={agent.name: agent.provenance for agent in members},
    )


def _episodes(agent: OpenedAgent, world: World, episodes: int) -> tuple[ExplainedEpisode, ...]:
    if agent.config.policy.policy == "mlp":
        # The headline count may be another than that of training.
        world = world.variant(num_distractors=agent.config.tasks.distractors)
    return explain_episodes(agent.policy, world, episodes=episodes, outside=agent.outside)
