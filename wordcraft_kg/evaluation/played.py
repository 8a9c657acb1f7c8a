"""An agent's success on all tasks of a part, and why it picked what it picked."""

from collections.abc import Sequence
from pathlib import Path

from wordcraft_kg.agents.agent_folder import OpenedAgent
from wordcraft_kg.agents.evaluation import Evaluator, player_of
from wordcraft_kg.agents.explanation import ExplainedEpisode, explain_episodes
from wordcraft_kg.agents.outcomes import Ending, Success
from wordcraft_kg.base.records import Record, Share
from wordcraft_kg.envs.world import World
from wordcraft_kg.graphs.tasks import TaskPart


class AgentEvaluation(Record):
    """Success of a run's agent, or of another player on its tasks, by the number of distractors.

    Attributes:
        run: folder of the run.
        agent: name of the player.
        checkpoint: checkpoint of the trained agent's weights; None for other players.
        scores: how the scorer's values were made, if it played alone; None for other players.
        success: success by the number of distractors.
        outcomes: share of each ending, by the number of distractors.
    """

    run: str
    agent: str
    checkpoint: str | None
    scores: str | None
    part: TaskPart
    depth: int
    success: dict[str, Success]
    outcomes: dict[str, dict[Ending, Share]]


class Explanation(Record):
    """Episodes of a run's agent, with the logits of each pick."""

    run: str
    checkpoint: str
    part: TaskPart
    episodes: tuple[ExplainedEpisode, ...]


def view_evaluation(
    run: Path, trained: OpenedAgent, agent: str, part: TaskPart, distractors: Sequence[int], draws: int
) -> AgentEvaluation:
    """Let an agent play all tasks of a part.

    Args:
        run: folder of ``trained``.
        trained: the agent whose tasks are played.
        agent: name of the player, see :func:`~wordcraft_kg.agents.evaluation.player_of`.
        part: part of the tasks.
        distractors: numbers of distractors.
        draws: draws of distractors for each task.
    """
    player, tasks, policy = player_of(trained.policy, agent), trained.config.tasks, trained.config.policy
    world = World(trained.opened, tasks.environment(part, distractors[0]))
    found = {
        str(amount): Evaluator(world.variant(num_distractors=amount), draws=draws)(player) for amount in distractors
    }
    scores = f"{policy.use}, scale {policy.scale}, self edges {policy.self_edges}" if agent == "kg-only" else None
    return AgentEvaluation(
        run=str(run),
        agent=agent,
        checkpoint=trained.checkpoint if agent == "trained" else None,
        scores=scores,
        part=part,
        depth=tasks.depth,
        success={amount: result.figures() for amount, result in found.items()},
        outcomes={amount: result.shares() for amount, result in found.items()},
    )


def view_explanation(
    run: Path, agent: OpenedAgent, part: TaskPart, distractors: int | None, goal: str | None, episodes: int
) -> Explanation:
    """Let an agent explain some episodes, see :func:`~wordcraft_kg.agents.explanation.explain_episodes`."""
    world = World(agent.opened, agent.config.tasks.environment(part, distractors))
    found = explain_episodes(agent.policy, world, goal=goal, episodes=episodes)
    return Explanation(str(run), agent.checkpoint, part, found)
