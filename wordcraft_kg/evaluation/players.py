"""Success of an agent or of scripted players on all tasks of a split part, and explained episodes."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from wordcraft_kg.agents.agent_folder import OpenedAgent
from wordcraft_kg.agents.evaluation import Evaluator, player_of
from wordcraft_kg.agents.explanation import ExplainedEpisode, explain_episodes
from wordcraft_kg.agents.outcomes import Success, TerminationReason
from wordcraft_kg.agents.players import PlayerSuccess, knowledge_players, play_all, scorer_players
from wordcraft_kg.base.records import Count, Record, Share
from wordcraft_kg.envs.config import WordCraftConfig
from wordcraft_kg.envs.world import World
from wordcraft_kg.graphs.folder import OpenedGraph
from wordcraft_kg.graphs.tasks import TaskPart

if TYPE_CHECKING:
    from wordcraft_kg.models.model import Model


class AgentEvaluation(Record):
    """Success of a run's agent, or of another player on the same tasks.

    Attributes:
        checkpoint: the trained agent's checkpoint, else None.
        scores: origin of the scores for a scorer alone, else None.
        success: by distractor count, like ``outcomes`` (shares of termination reasons).
    """

    run: str
    agent: str
    checkpoint: str | None
    scores: str | None
    part: TaskPart
    depth: int
    success: dict[str, Success]
    outcomes: dict[str, dict[TerminationReason, Share]]


class Explanation(Record):
    """Episodes of a run's agent, with the logits for each action."""

    run: str
    checkpoint: str
    part: TaskPart
    episodes: tuple[ExplainedEpisode, ...]


def view_evaluation(
    run: Path, trained: OpenedAgent, agent: str, part: TaskPart, distractors: Sequence[int], distractor_seeds: int
) -> AgentEvaluation:
    """Evaluate the player called ``agent``, see :func:`~wordcraft_kg.agents.evaluation.player_of`, on a run's tasks."""
    player, tasks, policy = player_of(trained.policy, agent), trained.config.tasks, trained.config.policy
    world = World(trained.opened, tasks.environment(part, distractors[0]))
    results = {
        str(amount): Evaluator(world.variant(num_distractors=amount), distractor_seeds=distractor_seeds)(player)
        for amount in distractors
    }
    scores = f"{policy.use}, scale {policy.scale}, self edges {policy.self_edges}" if agent == "kg-only" else None
    return AgentEvaluation(
        run=str(run),
        agent=agent,
        checkpoint=trained.checkpoint if agent == "trained" else None,
        scores=scores,
        part=part,
        depth=tasks.depth,
        success={amount: result.figures() for amount, result in results.items()},
        outcomes={amount: result.shares() for amount, result in results.items()},
    )


def view_explanation(
    run: Path, agent: OpenedAgent, part: TaskPart, distractors: int | None, goal: str | None, episodes: int
) -> Explanation:
    """Explain an agent's episodes, see :func:`~wordcraft_kg.agents.explanation.explain_episodes`."""
    world = World(agent.opened, agent.config.tasks.environment(part, distractors))
    explained = explain_episodes(agent.policy, world, goal=goal, episodes=episodes)
    return Explanation(str(run), agent.checkpoint, part, explained)


class Baselines(Record):
    """Success of scripted players, a row for each distractor count and player.

    Attributes:
        tasks: task count; each task is played ``distractor_seeds`` times for each distractor count.
        intervals: interval kind.
    """

    graph: str
    part: TaskPart
    depth: int
    tasks: Count
    distractor_seeds: Count
    seed: int
    intervals: str
    rows: tuple[PlayerSuccess, ...]


def view_baselines(
    opened: OpenedGraph,
    graph: str,
    config: WordCraftConfig,
    distractors: Sequence[int],
    model: "tuple[str, Model] | None" = None,
    *,
    distractor_seeds: int = 5,
    seed: int = 0,
    progress: Callable[[int, int, dict[str, float]], None] | None = None,
) -> Baselines:
    """Evaluate scripted players, and a model's players if given.

    Args:
        opened: graph and split.
        graph: the user's name for the graph.
        config: task part and depth.
        distractors: distractor counts.
        model: name and link predictor.
        distractor_seeds: distractor seeds per task.
        seed: seed for distractors and ties.
        progress: see :func:`~wordcraft_kg.agents.players.play_all`.
    """
    players = knowledge_players(opened.split)
    world = World(opened, config)
    if model is not None:
        name, trained = model
        tasks = world.tasks if config.part in ("train", "all") else None
        named = scorer_players(opened.graph, trained.scorer, trained.observed, tasks)
        oracle = players.pop("recipe oracle")
        players |= {f"{name}, {kind}": player for kind, player in named.items()} | {"recipe oracle": oracle}
    rows = play_all(world, players, distractors, distractor_seeds=distractor_seeds, seed=seed, progress=progress)
    return Baselines(
        graph=graph,
        part=config.part,
        depth=config.depth,
        tasks=len(world.tasks),
        distractor_seeds=distractor_seeds,
        seed=seed,
        intervals="95 %, bootstrap over tasks",
        rows=rows,
    )
