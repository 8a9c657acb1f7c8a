"""Success of trained agents and of scripted players on the tasks of a split part.

:func:`view_agents` compares agents over all training seeds, :func:`view_evaluation` evaluates one,
:func:`view_baselines` scripted players, all on the same tables.
"""

import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain, product
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
import numpy as np
from numpy.typing import NDArray

from wordcraft_kg.agents import players
from wordcraft_kg.agents.agent_folder import OpenedAgent
from wordcraft_kg.agents.agent_records import Success, TerminationReason
from wordcraft_kg.agents.evaluation import (
    Evaluation,
    Evaluator,
    PlayerSuccess,
    PolicyPlayer,
    play_all,
    success_rows,
)
from wordcraft_kg.base import (
    ConfigError,
    Count,
    GraphMismatchError,
    Record,
    Share,
    counted,
    steps,
)
from wordcraft_kg.base.registry import Registry
from wordcraft_kg.envs.draws import MOST_TASKS, default_seeds, sampled_tasks
from wordcraft_kg.envs.world import World
from wordcraft_kg.envs.world_config import WordCraftConfig
from wordcraft_kg.evaluation.agent_metrics import (
    AgainstScorer,
    AgentSuccess,
    CurvePoint,
    LambdaCurve,
    SeedCurve,
    Slice,
    SliceSuccess,
    SourceGain,
    TrainingMetric,
    compare_with_scorer,
    goal_groups,
    lambda_curves,
    outcomes_of,
    slices_of,
    source_gains,
    success_curves,
    success_of,
    training_metrics,
)
from wordcraft_kg.graphs import OpenedGraph, PlayedGraph, TaskPart, TrainedOn
from wordcraft_kg.models.model import Model
from wordcraft_kg.models.policies.sources import shown_setting
from wordcraft_kg.models.scorers.neighbours.knowledge import RecipeKnowledge

_RULES = ("depth", "max_attempts", "distractor_weighting")
"""Task settings that must be equal in all compared agents."""
# The fewest and the most distractors of the paper.
DISTRACTORS = (1, 8)


class AgentEntry(Record):
    """An agent's metrics; an agent is a group of training runs that differ only in the seed.

    Attributes:
        name: the agent's name: that of the runs without the seed, or of the first run.
        runs: names of the run folders.
        seeds: training seed of each run.
        settings: training settings that differ from the defaults, without graph and seed.
        kg: training graph of the agent's scorer (full or partial); None for an agent without a
            scorer.
        cross_fitted: number of cross-fitting folds of the scorer; 0 if train tasks have in-sample
            scores.
        trained_with: number of distractors in training.
        steps: environment steps of each run's training.
        seconds: duration of each run's training in seconds; None if a run has no metrics.
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
    settings: dict[str, str]
    kg: TrainedOn | None
    cross_fitted: Count
    trained_with: Count
    steps: tuple[int, ...]
    seconds: tuple[float | None, ...]
    success: dict[str, AgentSuccess]
    outcomes: dict[str, dict[TerminationReason, Share]]
    sources: dict[str, SourceGain]
    slices: dict[Slice, tuple[SliceSuccess, ...]]
    curves: dict[str, tuple[CurvePoint, ...]]
    lambdas: tuple[LambdaCurve, ...]
    training: dict[TrainingMetric, tuple[SeedCurve, ...]]
    provenance: dict[str, dict[str, str]]


class AgentsView(Record):
    """All numbers in a report on agents (``report.json``).

    Attributes:
        format: name and version of the format.
        graph: graph and split that all agents were trained on.
        unit: recipes, goals, slots or kinds: the split holds these out together, and intervals
            resample them.
        part: split part with the tasks.
        depth: fewest attempts that solve a task.
        distractors: distractor counts that were played.
        headline: distractor count of the report's main results.
        distractor_seeds: tables per task, with different random distractors.
        tasks: number of played tasks.
        sampled_from: number of tasks that the played ones are a sample of; None if all were played.
        agents: the agents; the first is the reference of all differences.
        baselines: scripted players, and the agents' scorers alone, with each distractor count.
    """

    format: Literal["wordcraft-kg agent report 1"]
    graph: PlayedGraph
    unit: str
    part: TaskPart
    depth: Annotated[int, msgspec.Meta(ge=1)]
    distractors: tuple[Count, ...]
    headline: Count
    distractor_seeds: Annotated[int, msgspec.Meta(ge=1)]
    tasks: Annotated[int, msgspec.Meta(ge=1)]
    sampled_from: Count | None
    agents: Annotated[tuple[AgentEntry, ...], msgspec.Meta(min_length=1)]
    baselines: tuple[PlayerSuccess, ...]


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
) -> AgentsView:
    """Evaluate agents greedily on all tasks of a split part, with the same tables for all agents.

    Args:
        groups: runs by agent, see :func:`group_agents`; the first agent is the reference of
            differences.
        part: split part with the tasks.
        distractors: distractor counts; None for 1, 8 and the numbers in the agents' training.
        distractor_seeds: tables per task; None as for
            :class:`~wordcraft_kg.agents.evaluation.Evaluator`.

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
    evaluators = _evaluators(world, played, distractor_seeds)
    results: dict[str, _Results] = {name: {} for name in groups}
    # Listed before playing, so that the progress has a total.
    pairs = product(groups, played)
    plays = [(name, amount) for name, amount in pairs if can_play(groups[name][0], amount)]
    for name, amount in steps("evaluating agents", plays):
        results[name][amount] = [
            evaluators[amount](PolicyPlayer(agent.policy)) for agent in groups[name]
        ]
    scorer_results = _scorers_alone(groups, evaluators)
    other_labels = _made_by_other_books(everyone)
    reference = next(iter(results.values()))
    tasks = len(evaluators[headline].tasks)
    return AgentsView(
        format="wordcraft-kg agent report 1",
        graph=PlayedGraph.of(first.opened),
        unit=first.opened.split.unit,
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
                evaluators[headline],
                results[name],
                # The first agent has no difference to itself.
                {} if results[name] is reference else reference,
                scorer_results,
                other_labels,
            )
            for name, members in groups.items()
        ),
        baselines=tuple(_baselines(groups, evaluators, scorer_results)),
    )


def _made_by_other_books(agents: Sequence[OpenedAgent]) -> frozenset[str] | None:
    """Return the labels that other books of any scorer make; None if no scorer has another book."""
    # One set for all agents: success is compared on the same groups of goals.
    label_sets = [
        agent.made_by_other_books for agent in agents if agent.made_by_other_books is not None
    ]
    return frozenset().union(*label_sets) if label_sets else None


def _scorers_alone(groups: Groups, evaluators: dict[int, Evaluator]) -> _ScorersAlone:
    played: _ScorersAlone = {}
    for name, members in groups.items():
        # Runs of an agent share the scorer, and so may agents: each scorer plays once.
        agent = members[0]
        if agent.policy.sources and _scores_of(agent) not in played:
            results = {
                sources: _play(player, evaluators)
                for sources, player in players.scorer_alone(agent.policy.sources).items()
            }
            played[_scores_of(agent)] = name, results
    return played


def _scores_of(agent: OpenedAgent) -> tuple[object, ...]:
    policy = agent.config.policy
    scorer = agent.run.inputs.get("scorer")
    return scorer, policy.use, policy.scale, policy.self_edges, policy.plan_width, policy.in_sample


def _evaluators(
    world: World, distractors: Iterable[int], tables: int | None, limit: int = MOST_TASKS
) -> dict[int, Evaluator]:
    """Return evaluators by number of distractors, on the same tasks in the same order."""
    return {
        amount: Evaluator(
            world.variant(num_distractors=amount), distractor_seeds=tables, limit=limit
        )
        for amount in distractors
    }


def _play(player: players.Player, evaluators: dict[int, Evaluator]) -> dict[int, Evaluation]:
    return {amount: play(player) for amount, play in evaluators.items()}


def _baselines(
    groups: Groups, evaluators: dict[int, Evaluator], scorers: _ScorersAlone
) -> Iterator[PlayerSuccess]:
    first = next(iter(groups.values()))[0]
    results = {
        "random": _play(players.random_entity, evaluators),
        players.FEWEST_USES: _play(players.fewest_uses(first.opened.split), evaluators),
    }
    # Words as strong as those of each scorer; equal vectors have equal names.
    words: dict[str, players.Player] = {}
    for members in groups.values():
        knowledge = [
            getattr(source, "knowledge", None) for source in members[0].policy.sources.values()
        ]
        of_recipes = [each for each in knowledge if isinstance(each, RecipeKnowledge)]
        words |= players.words_player(first.opened.graph, of_recipes[0] if of_recipes else None)
    results |= {name: _play(player, evaluators) for name, player in words.items()}
    for agent, results_by_sources in scorers.values():
        results |= {
            f"scorer of {agent} alone, {sources}": played
            for sources, played in results_by_sources.items()
        }
    # Last, as the upper bound.
    results["recipe oracle"] = _play(players.recipe_oracle, evaluators)
    for name, played in results.items():
        for amount, result in played.items():
            yield from success_rows(name, amount, result, {})


def _conditions(
    agents: Sequence[OpenedAgent], part: TaskPart, distractors: Sequence[int] | None
) -> tuple[World, list[int]]:
    _check_alike(agents)
    first = agents[0]
    headline = first.config.tasks.distractors
    world = World(first.opened, first.config.tasks.environment(part, headline))
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


def _check_alike(agents: Sequence[OpenedAgent]) -> None:
    first = agents[0]
    for agent in agents[1:]:
        if agent.opened.split.hash != first.opened.split.hash:
            raise GraphMismatchError(
                f"'{agent.name}' and '{first.name}' were trained on different graphs or splits: "
                "their tasks differ, so their results cannot be compared. Train all runs on the "
                "same graph folder."
            )
        for rule in _RULES:
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
    evaluator: Evaluator,
    results: _Results,
    reference: _Results,
    scorers: _ScorersAlone,
    made_by_other_books: frozenset[str] | None,
) -> AgentEntry:
    world = evaluator.engine.world
    # An agent that cannot play with the headline's distractors has neither gains nor slices.
    headline = results.get(world.config.num_distractors, [])
    policies = [agent.policy for agent in members]
    config = members[0].config
    against_scorer: dict[int, AgainstScorer] = {}
    if members[0].policy.sources:
        _, scorer_results = scorers[_scores_of(members[0])]
        # The last one is p alone if the agent has it, else w alone, else all sources.
        sources, played = list(scorer_results.items())[-1]
        against_scorer = {
            amount: compare_with_scorer(runs, sources, played[amount])
            for amount, runs in results.items()
        }
    return AgentEntry(
        name=name,
        runs=tuple(agent.name for agent in members),
        seeds=tuple(agent.config.trainer.seed for agent in members),
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
        success={
            str(amount): success_of(runs, reference.get(amount), against_scorer.get(amount))
            for amount, runs in results.items()
        },
        outcomes={str(amount): outcomes_of(runs) for amount, runs in results.items()},
        sources=source_gains(policies, evaluator, headline) if headline else {},
        slices=slices_of(members[0], world.tasks, headline, made_by_other_books),
        curves=success_curves(members),
        lambdas=tuple(lambda_curves(members)),
        training=training_metrics(members),
        provenance={agent.name: agent.provenance for agent in members},
    )


@dataclass(frozen=True)
class ExternalPlayer:
    """A player outside of this process, such as a program that plays by text.

    Attributes:
        name: ``KIND:ARGUMENT``, such as ``program:python my_player.py``.
        out: folder for its games; None for a folder named after the player.
        timeout: seconds for an answer.
    """

    name: str
    out: Path | None
    timeout: float


PlayGames = Callable[[ExternalPlayer, Sequence[World], int, int], tuple[str, list[Evaluation]]]
"""Plays games: ``(player, worlds, tables for each task, most tasks)``; returns the player's name in
tables and its results in each world.
"""
EXTERNAL: Registry[PlayGames] = Registry("wordcraft_kg.external_players")
"""How players outside of this process play, by kind; apps add kinds."""


class AgentEvaluation(Record):
    """Success of a trained agent on its tasks.

    Attributes:
        run: folder of the run.
        checkpoint: checkpoint of the agent's weights.
        part: split part with the tasks.
        depth: fewest attempts that solve a task.
        success: success rate by distractor count.
        outcomes: share of episodes by termination reason, by distractor count.
        against_scorer: comparison of the agent with its scorer alone, by distractor count; None
            without a scorer.
        sources: what each source adds to the agent, by distractor count; None without a scorer.
        by_goal: success on goals that another book in the scorer's training makes, and on all other
            goals, by distractor count; None if the scorer learned from no other book.
    """

    run: str
    checkpoint: str
    part: TaskPart
    depth: int
    success: dict[str, Success]
    outcomes: dict[str, dict[TerminationReason, Share]]
    against_scorer: dict[str, AgainstScorer] | None
    sources: dict[str, dict[str, SourceGain]] | None
    by_goal: dict[str, tuple[SliceSuccess, ...]] | None = None

    def notes(self) -> Iterator[str]:
        """Yield a sentence for each source that adds nothing."""
        for amount, gains in (self.sources or {}).items():
            tables = counted(int(amount), "distractor")
            for source, gain in gains.items():
                if gain.adds_nothing:
                    yield f"{tables}: {source} {gain.sentence}"


def view_evaluation(
    run: Path,
    agent: OpenedAgent,
    part: TaskPart,
    distractors: Sequence[int],
    distractor_seeds: int | None,
    limit: int = MOST_TASKS,
) -> AgentEvaluation:
    """Evaluate an agent on its tasks.

    Args:
        run: folder of ``agent``.
        agent: the trained agent.
        part: split part with the tasks.
        distractors: distractor counts.
        distractor_seeds: tables per task; None as for
            :class:`~wordcraft_kg.agents.evaluation.Evaluator`.
        limit: most tasks; of more, evenly spaced ones are played.

    Returns:
        Success and outcomes by distractor count.

    Raises:
        ConfigError: if a value is out of range, or the graph has too few entities for so many
            distractors.
        TaskError: if the part has no tasks of the agent's depth.
    """
    policy = agent.policy
    tasks = agent.config.tasks
    world = World(agent.opened, tasks.environment(part, distractors[0]))
    evaluators = _evaluators(world, distractors, distractor_seeds, limit)
    results = _play(PolicyPlayer(policy), evaluators)
    against_scorer = None
    sources = None
    if policy.sources:
        # The last one is p alone if the agent has it, else w alone, else all sources.
        name, scorer_player = list(players.scorer_alone(policy.sources).items())[-1]
        against_scorer = {
            str(amount): compare_with_scorer([results[amount]], name, scorer_result)
            for amount, scorer_result in _play(scorer_player, evaluators).items()
        }
        sources = {
            str(amount): source_gains([policy], evaluator, [results[amount]])
            for amount, evaluator in evaluators.items()
        }
    by_goal = None
    labels = agent.made_by_other_books
    if labels is not None:
        by_goal = {
            str(amount): slices_of(agent, world.tasks, [result], labels).get("other_book", ())
            for amount, result in results.items()
        }
    return AgentEvaluation(
        run=str(run),
        checkpoint=agent.checkpoint,
        part=part,
        depth=tasks.depth,
        success={str(amount): result.metrics() for amount, result in results.items()},
        outcomes={str(amount): result.shares() for amount, result in results.items()},
        against_scorer=against_scorer,
        sources=sources,
        by_goal=by_goal,
    )


class Baselines(Record):
    """Success rates of scripted players.

    For a model that learned from another book, players of this process have two further rows: goals
    that the other book makes, and all other goals.

    Attributes:
        graph: the graph as the user named it.
        part: split part with the tasks.
        depth: fewest attempts that solve a task.
        tasks: number of played tasks.
        distractor_seeds: tables per task.
        seed: seed of distractors and of the players' choices.
        intervals: level and method of the intervals, in words.
        rows: a row for each player and distractor count.
        shares: share of the tasks in each group of goals; empty without another book.
    """

    graph: str
    part: TaskPart
    depth: int
    tasks: Count
    distractor_seeds: Count
    seed: int
    intervals: str
    rows: tuple[PlayerSuccess, ...]
    shares: dict[str, Share]


def view_baselines(  # noqa: PLR0913 - each argument is an option of a command
    opened: OpenedGraph,
    graph: str,
    config: WordCraftConfig,
    distractors: Sequence[int],
    model: tuple[str, Model] | None = None,
    distractor_seeds: int | None = None,
    seed: int = 0,
    limit: int = MOST_TASKS,
    external: ExternalPlayer | None = None,
) -> Baselines:
    """Evaluate scripted players and, if a model is given, players that follow the model's scores.

    Args:
        opened: graph and split.
        graph: the graph as the user named it.
        config: settings of the tasks.
        distractors: distractor counts.
        model: name of a model, and the model; None for scripted players only.
        distractor_seeds: tables per task; None as for
            :func:`~wordcraft_kg.agents.evaluation.play_all`.
        seed: seed of distractors and of the players' choices.
        limit: most tasks; of more, evenly spaced ones are played.
        external: a player outside of this process, on the same tables; None without one.

    Returns:
        A row for each player and distractor count.

    Raises:
        TaskError: if there is no task for these settings.
        ConfigError: if the graph has too few entities for so many distractors, the model needs
            score tables that would be too large, or the external player is of an unknown kind.
        PlayerError: if the external player does not start, ends early or does not answer in time.
        GraphMismatchError: if the model belongs to another graph.
        LeakError: if a cross-fitted model has seen all recipes of a task's plan.
    """
    scripted = players.knowledge_players(
        opened.split, players.knowledge_of(model[1].scorer if model else None)
    )
    world = World(opened, config)
    groups: dict[str, NDArray[np.bool_]] = {}
    if model is not None:
        name, trained = model
        # A cross-fitted scorer needs the tasks that it may have been trained on, to answer by the
        # model of the fold that has not seen them.
        tasks = world.tasks if config.part in ("train", "all") else None
        groups = goal_groups(opened.graph, world.tasks.goals, trained.history.made_by_other_books)
        guided = players.scorer_players(
            opened.graph, trained.scorer, trained.triples, tasks, plans=True
        )
        # The oracle stays last, as the upper bound.
        oracle = scripted.pop("recipe oracle")
        scripted |= {f"{name}, {kind}": player for kind, player in guided.items()}
        scripted["recipe oracle"] = oracle
    tables = default_seeds(len(world.tasks)) if distractor_seeds is None else distractor_seeds
    # The external player first: it may fail, and its games are kept.
    external_rows: tuple[PlayerSuccess, ...] = ()
    if external is not None:
        worlds = [world.variant(num_distractors=amount) for amount in distractors]
        external_rows = tuple(_external_rows(external, worlds, tables, limit))
    rows = play_all(
        world, scripted, distractors, distractor_seeds=tables, seed=seed, groups=groups, limit=limit
    )
    played = sampled_tasks(world, limit)
    return Baselines(
        graph=graph,
        part=config.part,
        depth=config.depth,
        tasks=len(played),
        distractor_seeds=tables,
        seed=seed,
        intervals=f"95 %, bootstrap over {opened.split.unit}",
        rows=(*rows, *external_rows),
        shares={group: float(mask[played].mean()) for group, mask in groups.items()},
    )


def _external_rows(
    player: ExternalPlayer, worlds: Sequence[World], tables: int, limit: int
) -> Iterator[PlayerSuccess]:
    kind, _, argument = player.name.partition(":")
    if kind not in EXTERNAL or not argument:
        kinds = ", ".join(f"{name}:COMMAND" for name in EXTERNAL) or "none here"
        raise ConfigError(f"`player` '{player.name[:100]}': expected {kinds}.")
    name, results = EXTERNAL[kind](player, worlds, tables, limit)
    for world, result in zip(worlds, results, strict=True):
        yield from success_rows(name, world.config.num_distractors, result, {})
