"""Success of an agent or of scripted players on all tasks of a split part; explained episodes."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from wordcraft_kg.agents.agent_folder import OpenedAgent
from wordcraft_kg.agents.evaluation import (
    Evaluation,
    Evaluator,
    PlayerSuccess,
    play_all,
    player_of,
    success_rows,
)
from wordcraft_kg.agents.explanation import ExplainedEpisode, explain_episodes
from wordcraft_kg.agents.players import (
    BEST_PAIR,
    PLANNER,
    advice_on_words,
    is_words_player,
    knowledge_of,
    knowledge_players,
    scorer_alone,
    scorer_players,
)
from wordcraft_kg.agents.records import Success, TerminationReason
from wordcraft_kg.base import ConfigError, Count, Record, Share, counted
from wordcraft_kg.base.registry import Registry
from wordcraft_kg.envs.config import DistractorPolicy, WordCraftConfig
from wordcraft_kg.envs.draws import MOST_TASKS, default_seeds, sampled_tasks
from wordcraft_kg.envs.world import World
from wordcraft_kg.evaluation.agent_metrics import (
    AgainstScorer,
    SliceSuccess,
    SourceGain,
    compare_with_scorer,
    goal_groups,
    slice_successes,
    source_gains,
)
from wordcraft_kg.graphs import OpenedGraph, TaskPart
from wordcraft_kg.models.policies.sources import with_letters

if TYPE_CHECKING:
    from wordcraft_kg.models.model import Model


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
    """Success of a trained agent or of another player on the agent's tasks.

    Attributes:
        run: folder of the run with the tasks.
        agent: name of the player.
        checkpoint: checkpoint of the trained agent's weights; None for other players.
        scores: how the scores are standardised if the scorer plays alone; None for other players.
        part: split part with the tasks.
        depth: fewest attempts that solve a task.
        distractor_policy: where distractors are drawn from.
        success: success rate by distractor count.
        outcomes: share of episodes by termination reason, by distractor count.
        against_scorer: comparison of the trained agent with its scorer alone, by distractor count;
            None for other players and without a scorer.
        sources: what each source adds to the trained agent, by distractor count; None for other
            players and without a scorer.
        by_goal: success on goals that another book in the scorer's training makes, and on all other
            goals, by distractor count; None if the scorer learned from no other book.
    """

    run: str
    agent: str
    checkpoint: str | None
    scores: str | None
    part: TaskPart
    depth: int
    distractor_policy: DistractorPolicy
    success: dict[str, Success]
    outcomes: dict[str, dict[TerminationReason, Share]]
    against_scorer: dict[str, AgainstScorer] | None
    sources: dict[str, dict[str, SourceGain]] | None
    by_goal: dict[str, tuple[SliceSuccess, ...]] | None = None

    def notes(self) -> list[str]:
        """Return a sentence for each source that adds nothing."""
        notes = []
        for amount, gains in (self.sources or {}).items():
            tables = counted(int(amount), "distractor")
            for source, gain in gains.items():
                if gain.adds_nothing:
                    notes.append(f"{tables}: {source} {gain.sentence}")
        return notes


class Explanation(Record):
    """Episodes of a trained agent, with all scores and logits for each action.

    Attributes:
        run: folder of the run.
        checkpoint: checkpoint of the agent's weights.
        part: split part with the tasks.
        episodes: the explained episodes.
    """

    run: str
    checkpoint: str
    part: TaskPart
    episodes: tuple[ExplainedEpisode, ...]


def view_evaluation(
    run: Path,
    trained: OpenedAgent,
    agent: str,
    part: TaskPart,
    distractors: Sequence[int],
    distractor_seeds: int | None,
    distractor_policy: DistractorPolicy | None = None,
    limit: int = MOST_TASKS,
) -> AgentEvaluation:
    """Evaluate a player on an agent's tasks.

    Args:
        run: folder of ``trained``.
        trained: the agent whose tasks are played.
        agent: name of the player, see :func:`~wordcraft_kg.agents.evaluation.player_of`.
        part: split part with the tasks.
        distractors: distractor counts.
        distractor_seeds: tables per task; None as for
            :class:`~wordcraft_kg.agents.evaluation.Evaluator`.
        distractor_policy: where distractors are drawn from; None for the agent's setting in
            training.
        limit: most tasks; of more, evenly spaced ones are played.

    Returns:
        Success and outcomes by distractor count.

    Raises:
        ConfigError: if ``agent`` is kg-only and the run has no scorer, a value is out of range, or
            the graph has too few entities for so many distractors.
        TaskError: if the part has no tasks of the agent's depth.
    """
    player = player_of(trained.policy, agent)
    tasks = trained.config.tasks
    policy = trained.config.policy
    config = tasks.environment(part, distractors[0])
    if distractor_policy is not None:
        config = config.variant(distractor_policy=distractor_policy)
    world = World(trained.opened, config)
    # Variants share the world's tasks, so each count has the same tasks in the same order.
    evaluators = {}
    for amount in distractors:
        variant = world.variant(num_distractors=amount)
        evaluators[str(amount)] = Evaluator(
            variant,
            distractor_seeds=distractor_seeds,
            limit=limit,
        )
    results = {amount: evaluator(player) for amount, evaluator in evaluators.items()}
    against_scorer = None
    sources = None
    if agent == "trained" and trained.policy.sources:
        # The last one is p alone if the agent has it, else w alone, else all sources.
        name, scorer_player = list(scorer_alone(trained.policy.sources).items())[-1]
        against_scorer = {
            amount: compare_with_scorer([results[amount]], name, evaluator(scorer_player))
            for amount, evaluator in evaluators.items()
        }
        sources = {
            amount: source_gains([trained.policy], evaluator, [results[amount]])
            for amount, evaluator in evaluators.items()
        }
    by_goal = None
    if trained.made_by_other_books is not None:
        by_goal = {}
        for count, result in results.items():
            # The evaluator may have played a sample of the tasks.
            goals = world.tasks.goals[result.tasks]
            groups = goal_groups(trained.opened.graph, goals, trained.made_by_other_books)
            by_goal[count] = slice_successes(groups, [result])
    scores = None
    if agent == "kg-only":
        scores = (
            f"{with_letters(policy.sources)}, scale {policy.scale}, self edges {policy.self_edges}"
        )
    return AgentEvaluation(
        run=str(run),
        agent=agent,
        checkpoint=trained.checkpoint if agent == "trained" else None,
        scores=scores,
        part=part,
        depth=tasks.depth,
        distractor_policy=world.config.distractor_policy,
        success={amount: result.metrics() for amount, result in results.items()},
        outcomes={amount: result.shares() for amount, result in results.items()},
        against_scorer=against_scorer,
        sources=sources,
        by_goal=by_goal,
    )


def view_explanation(
    run: Path,
    agent: OpenedAgent,
    part: TaskPart,
    distractors: int | None,
    goal: str | None,
    episodes: int,
    *,
    task: int | None = None,
) -> Explanation:
    """Play episodes and explain each action.

    Args:
        run: folder of ``agent``.
        agent: the trained agent.
        part: split part with the tasks.
        distractors: distractors on each table; None for the number in training.
        goal: label of the goal; None for any goal.
        episodes: number of episodes.
        task: index of the only task to play; None for tasks in turn.

    Returns:
        The episodes, see :func:`~wordcraft_kg.agents.explanation.explain_episodes`.

    Raises:
        UnknownEntityError: if the goal does not exist.
        TaskError: if the part has no tasks, or none with the goal.
        ConfigError: if the task does not exist, the graph has too few entities for so many
            distractors, or the policy has other slots.
    """
    # Without a number, tables are as in training.
    world = World(agent.opened, agent.config.tasks.environment(part, distractors))
    explained = explain_episodes(
        agent.policy, world, goal=goal, episodes=episodes, outside=agent.outside, task=task
    )
    return Explanation(str(run), agent.checkpoint, part, explained)


class Baselines(Record):
    """Success rates of scripted players.

    For a model that learned from another book, its players by w and by plans and the player by
    nearest words have two further rows: goals that the other book makes, and all other goals.

    Attributes:
        graph: the graph as the user named it.
        part: split part with the tasks.
        depth: fewest attempts that solve a task.
        distractor_policy: where distractors are drawn from.
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
    distractor_policy: DistractorPolicy
    tasks: Count
    distractor_seeds: Count
    seed: int
    intervals: str
    rows: tuple[PlayerSuccess, ...]
    shares: dict[str, Share]

    def notes(self) -> list[str]:
        """Return advice on the words of the players, if there is any."""
        return advice_on_words(row.player for row in self.rows)


def view_baselines(  # noqa: PLR0913 - each argument is an option of a command
    opened: OpenedGraph,
    graph: str,
    config: WordCraftConfig,
    distractors: Sequence[int],
    model: "tuple[str, Model] | None" = None,
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
    players = knowledge_players(opened.split, knowledge_of(model[1].scorer if model else None))
    world = World(opened, config)
    # Only players that may have learned from another book, or know none, tell its goals apart.
    groups: dict[str, NDArray[np.bool_]] = {}
    grouped = {name for name in players if is_words_player(name)}
    if model is not None:
        name, trained = model
        # A cross-fitted scorer needs the tasks that it may have been trained on, to answer by the
        # model of the fold that has not seen them.
        tasks = world.tasks if config.part in ("train", "all") else None
        groups = goal_groups(opened.graph, world.tasks.goals, trained.made_by_other_books)
        guided = scorer_players(opened.graph, trained.scorer, trained.triples, tasks, plans=True)
        grouped |= {f"{name}, {kind}" for kind in (BEST_PAIR, PLANNER)}
        # The oracle stays last, as the upper bound.
        oracle = players.pop("recipe oracle")
        players |= {f"{name}, {kind}": player for kind, player in guided.items()}
        players["recipe oracle"] = oracle
    tables = default_seeds(len(world.tasks)) if distractor_seeds is None else distractor_seeds
    # The external player first: it may fail, and its games are kept.
    external_rows: tuple[PlayerSuccess, ...] = ()
    if external is not None:
        worlds = [world.variant(num_distractors=amount) for amount in distractors]
        external_rows = _external_rows(external, worlds, tables, limit)
    rows = play_all(
        world, players, distractors, distractor_seeds=tables, seed=seed, groups=groups, limit=limit
    )
    played = sampled_tasks(world, limit)
    return Baselines(
        graph=graph,
        part=config.part,
        depth=config.depth,
        distractor_policy=config.distractor_policy,
        tasks=len(played),
        distractor_seeds=tables,
        seed=seed,
        intervals=f"95 %, bootstrap over {opened.split.unit}",
        rows=(
            *(row for row in rows if not row.goals or row.player in grouped),
            *external_rows,
        ),
        shares={group: float(mask[played].mean()) for group, mask in groups.items()},
    )


def _external_rows(
    player: ExternalPlayer, worlds: Sequence[World], tables: int, limit: int
) -> tuple[PlayerSuccess, ...]:
    kind, _, argument = player.name.partition(":")
    if kind not in EXTERNAL or not argument:
        kinds = ", ".join(f"{name}:COMMAND" for name in EXTERNAL) or "none here"
        raise ConfigError(f"`player` '{player.name[:100]}': expected {kinds}.")
    name, results = EXTERNAL[kind](player, worlds, tables, limit)
    rows: list[PlayerSuccess] = []
    for world, result in zip(worlds, results, strict=True):
        amount = world.config.num_distractors
        rows += success_rows(name, amount, result.success, result.by_plan, result.groups, {})
    return tuple(rows)
