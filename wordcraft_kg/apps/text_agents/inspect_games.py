"""Games as Inspect AI sees them: a solver that holds the conversation, scorers, and our figures as its metrics."""

from collections.abc import Callable, Mapping
from typing import Any

from wordcraft_kg.apps.text_agents.conversation import Conversation
from wordcraft_kg.apps.text_agents.inspect_log import (
    UNFINISHED,
    VERDICT,
    distinct_draws,
    played_task_of,
    played_world_of,
)
from wordcraft_kg.apps.text_agents.played import played_task, played_world
from wordcraft_kg.base.errors import ArtefactError
from wordcraft_kg.base.extras import missing_extra
from wordcraft_kg.base.records import as_values

try:
    from inspect_ai.model import ChatMessageUser
    from inspect_ai.scorer import Metric, SampleScore, Score, Scorer, Target, Value, metric, scorer, stderr
    from inspect_ai.solver import Generate, Solver, TaskState, solver
except ModuleNotFoundError:
    raise missing_extra("inspect", ["Inspect AI"]) from None

PLAYED = "wordcraft_kg_played"
"""Where the solver leaves what was played in a sample's store."""
Begin = Callable[[Mapping[str, Any]], Conversation]
"""Begins the game of a sample, by the sample's metadata."""


@solver
def conversation(begin: Begin) -> Solver:
    """Let a model play: it is told what its last message did, until the game is over.

    A game that a limit of Inspect's ends is given up: what was not made by then is not made.
    """

    async def solve(state: TaskState, generate: Generate) -> TaskState:
        talk = begin(state.metadata)
        try:
            state = await generate(state)
            told = talk.hear(state.output.completion)
            while not talk.is_over:
                state.messages.append(ChatMessageUser(content=told))
                state = await generate(state)
                told = talk.hear(state.output.completion)
        finally:
            # Also on a limit, which Inspect raises as an error: what was played until then is scored.
            is_finished = talk.is_over
            talk.game.end()
            state.store.set(PLAYED, {**_played(talk, state), UNFINISHED: not is_finished, VERDICT: talk.game.state})
        return state

    return solve


def _played(talk: Conversation, state: TaskState) -> dict[str, Any]:
    """Return what is recorded of a game, without its messages, which Inspect's log has."""
    # Inspect counts epochs from 1.
    played = played_world(talk, state.epoch - 1, []) if talk.game.tasks is None else played_task(talk, [])
    return {key: value for key, value in as_values(played).items() if key != "messages"}


@metric(scores="unreduced")
def crafting_figures() -> Metric:
    """Our figures of success on tasks, those of an evaluation of agents, and Inspect's standard error over tasks."""

    def figures(scores: list[SampleScore]) -> Value:
        from wordcraft_kg.apps.text_agents.evaluation import evaluation_of

        if not scores:
            return {}
        played = distinct_draws([played_task_of(one.score.metadata, f"the score of {one.sample_id}") for one in scores])
        games, tasks, draws = len(played), {one.task for one in played}, {one.draw for one in played}
        # With some samples of a task missing there is no interval over tasks; what is not there is not shown.
        success = evaluation_of(None, played).figures() if games == len(tasks) * len(draws) else None
        return {
            "success": success.mean if success else sum(one.success for one in played) / games,
            "stderr": float(stderr(cluster="task")(scores)),  # type: ignore[arg-type]
            "ci_low": success.ci_low if success else None,
            "ci_high": success.ci_high if success else None,
            "by_plan": success.by_plan if success else sum(one.by_plan for one in played) / games,
            "picks": success.picks if success else sum(one.picks for one in played) / games,
            **_counts(scores),
        }

    return figures


@metric(scores="unreduced")
def discovery_figures() -> Metric:
    """Return the mean number of entities known after some numbers of attempts, and its standard error at the end."""

    def figures(scores: list[SampleScore]) -> Value:
        from wordcraft_kg.apps.text_agents.evaluation import mean_known

        if not scores:
            return {}
        played = [played_world_of(one.score.metadata, f"the score of {one.sample_id}") for one in scores]
        about = scores[0].sample_metadata or {}
        known = mean_known(played, about["attempts"], about["known_at_start"])
        return {
            **{f"known_{attempts}": value for attempts, value in known.items()},
            "stderr": float(stderr()(scores)),  # type: ignore[arg-type]
            **_counts(scores),
        }

    return figures


def _counts(scores: list[SampleScore]) -> dict[str, int]:
    """Return what is counted over all games."""
    values = [one.score.metadata or {} for one in scores]
    return {name: sum(one.get(name, 0) for one in values) for name in ("refused", "lost", "look_ups", UNFINISHED)}


@scorer(metrics=[crafting_figures()])
def goal_made() -> Scorer:
    """Score a task: 1 if its goal was made, else 0; all that is recorded of the game is the score's metadata."""

    async def score(state: TaskState, target: Target) -> Score:
        played = _left(state)
        last = played["last"]
        return Score(
            value=int(played["success"]),
            answer=" + ".join(last) if last else None,
            explanation=played[VERDICT],
            metadata=played,
        )

    return score


@scorer(metrics=[discovery_figures()])
def things_known() -> Scorer:
    """Score a game in the open-ended world: how much was known at its end."""

    async def score(state: TaskState, target: Target) -> Score:
        played = _left(state)
        after = played["known_after"] or [state.metadata["known_at_start"]]
        return Score(value=after[-1], explanation=played[VERDICT], metadata=played)

    return score


def _left(state: TaskState) -> dict[str, Any]:
    """Return what the solver has left.

    Raises:
        ArtefactError: if another solver has played.
    """
    played = state.store.get(PLAYED)
    if played is None:
        raise ArtefactError(
            f"sample {state.sample_id} has no game: these tasks are scored by their own solver; leave --solver out."
        )
    return dict(played)
