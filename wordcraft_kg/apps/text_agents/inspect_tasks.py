"""Tasks of Inspect AI: crafting tasks at the tables of the evaluation, and the open-ended world.

``inspect eval wordcraft_kg/crafting`` finds them by the package's entry point. The conversation is that of all text
agents.
"""

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import fields
from inspect import Parameter, Signature, signature
from pathlib import Path
from typing import Any, TypeVar

from wordcraft_kg.agents.discovery import HUMAN_CURVE, HUMAN_SOURCE
from wordcraft_kg.apps.text_agents.conversation import Conversation, Play
from wordcraft_kg.apps.text_agents.games import TaskGames
from wordcraft_kg.apps.text_agents.inspect_log import (
    METADATA,
    UNFINISHED,
    VERDICT,
    LoggedTask,
    distinct_draws,
    played_of,
)
from wordcraft_kg.apps.text_agents.records import PlayedTask, PlayedWorld
from wordcraft_kg.apps.text_agents.results import chosen_tasks, evaluation_of, mean_known, record_of
from wordcraft_kg.apps.text_agents.settings import ATTEMPTS, EvaluationSettings
from wordcraft_kg.base.errors import ArtefactError, ConfigError, UnknownSettingError, WordCraftKGError
from wordcraft_kg.base.extras import missing_extra
from wordcraft_kg.base.records import as_values
from wordcraft_kg.base.settings import MAX_SIZE, nearest, refuse, whole

try:
    from inspect_ai import Task, task

    # Its name is private, but it is the error that Inspect shows to users without a traceback.
    from inspect_ai._util.error import PrerequisiteError
    from inspect_ai.dataset import MemoryDataset, Sample
    from inspect_ai.model import ChatMessage, ChatMessageSystem, ChatMessageUser
    from inspect_ai.scorer import Metric, SampleScore, Score, Scorer, Target, Value, metric, scorer, stderr
    from inspect_ai.solver import Generate, Solver, TaskState, solver
except ModuleNotFoundError:
    raise missing_extra("inspect", ["Inspect AI"]) from None

F = TypeVar("F", bound=Callable[..., Any])
PLAYED = "wordcraft_kg_played"
"""Key of a sample's store under which the solver leaves the record of its game."""
_RULES = ("knowledge", "scorer", "look_ups", "refusals")


class InspectTaskError(ConfigError, PrerequisiteError):
    """A parameter of a task is wrong; Inspect shows the message without a traceback."""

    def __init__(self, message: str):
        """Take the message."""
        from rich.markup import escape

        ValueError.__init__(self, message)
        self.message = escape(message)


def _with_parameters(*names: str, **own: Any) -> Callable[[F], F]:
    """Declare the parameters that Inspect reads: a graph, settings of games by their names, and others by default."""
    defaults = {field.name: field.default for field in fields(EvaluationSettings)}
    kind = Parameter.POSITIONAL_OR_KEYWORD
    given = {"graph": "everyday", **{name: defaults[name] for name in names}, **own}
    parameters = [Parameter(name, kind, default=value) for name, value in given.items()]

    def declared(function: F) -> F:
        # A parameter that is unknown is an error of ours, not a warning of Inspect's.
        read = Signature([*parameters, Parameter("unknown", Parameter.VAR_KEYWORD)])
        function.__signature__ = read  # type: ignore[attr-defined]
        return function

    return declared


@task
@_with_parameters("part", "depth", "distractors", "attempts", "draws", "tasks", *_RULES)
def crafting(graph: str = "everyday", **settings: Any) -> Task:
    """Make the goal from what is on the table: the tasks on which agents are evaluated, at the same tables.

    ``graph`` is a graph folder, a book's file or a known book; the other parameters are those of
    :class:`~wordcraft_kg.apps.text_agents.settings.EvaluationSettings`.

    Raises:
        InspectTaskError: for a wrong parameter, or a graph or scorer that cannot be read.
    """
    with _readable():
        play = _open(crafting, graph, settings)
        rules = play.settings
        assert isinstance(play.games, TaskGames)
        tasks = play.games.world.tasks
        samples = [
            _sample(f"{rules.part}-{number}-{draw}", play, task=number, draw=draw, goal=tasks[number].goal)
            for draw in range(rules.draws)
            for number in chosen_tasks(play.games.world, rules.tasks).tolist()
        ]
        return _task(play, samples, f"{rules.graph}, {rules.part}", scorer=goal_made())


@task
@_with_parameters(*_RULES, attempts=ATTEMPTS, base=None, games=1)
def discovery(graph: str = "everyday", *, games: int = 1, base: Any = None, **settings: Any) -> Task:
    """Discover as much as possible in the open-ended world, from one or several entities as a ``base``.

    Other parameters are those of :func:`crafting`; ``games`` is their number, which Inspect's ``--epochs`` replaces.

    Raises:
        InspectTaskError: as :func:`crafting`.
    """
    with _readable():
        whole("games", games, 1, MAX_SIZE)
        # Inspect reads a number or a truth value where the name of an entity is meant.
        named = base if isinstance(base, list | tuple) else [base]
        start = None if base is None else [str(entity) for entity in named]
        play = _open(discovery, graph, settings, open_ended=True, base=start, draws=games)
        rules = play.settings
        sample = _sample("world", play, attempts=rules.attempts, known_at_start=len(rules.base))
        people = {"known": {str(after): known for after, known in HUMAN_CURVE.items()}, "source": HUMAN_SOURCE}
        return _task(play, [sample], rules.graph, people, scorer=things_known(), epochs=games)


def _open(declared: Callable[..., Task], graph: Any, given: Mapping[str, Any], **own: Any) -> Play:
    """Open the games of a task's parameters."""
    known = [name for name in signature(declared).parameters if name != "unknown"]
    for name in given:
        if name not in known:
            raise UnknownSettingError(
                f"there is no parameter `{name}`; expected one of {', '.join(known)}.{nearest(name, known)}"
            )
    if not isinstance(graph, str) or not graph:
        raise refuse("graph", graph, "a graph folder, a recipe book's file, or the name of a known book")
    scorer = given.get("scorer")
    settings = EvaluationSettings(**{**given, **own, "scorer": scorer and Path(str(scorer))})
    return Play.open(graph, settings, draws=settings.draws, tasks=settings.tasks, refusals=settings.refusals)


def _sample(identity: str, play: Play, **about: Any) -> Sample:
    """Return a game as a sample: its opening, its goal if it has one, and metadata."""
    talk = _begin(play, about)
    hashes = {name: getattr(play.settings, name) for name in ("graph_hash", "split_hash", "texts")}
    opening: list[ChatMessage] = [ChatMessageSystem(content=talk.rules), ChatMessageUser(content=talk.game.state)]
    return Sample(id=identity, input=opening, target=about.get("goal", ""), metadata=about | hashes)


def _begin(play: Play, about: Mapping[str, Any]) -> Conversation:
    return play.begin(about.get("task", 0), about.get("draw", 0))


def _task(play: Play, samples: list[Sample], name: str, people: dict[str, Any] | None = None, **options: Any) -> Task:
    about = LoggedTask(settings=play.settings, games=len(samples), people=people)
    return Task(
        dataset=MemoryDataset(samples, name=name),
        solver=conversation(play),
        version=play.settings.texts[:12],
        metadata={METADATA: as_values(about)},
        **options,
    )


@contextmanager
def _readable() -> Iterator[None]:
    """Turn errors of ours into errors that Inspect shows without a traceback."""
    try:
        yield
    except WordCraftKGError as error:
        raise InspectTaskError(str(error)) from error


@solver
def conversation(play: Play) -> Solver:
    """Let a model play: each message is answered until the game is over.

    A game that a limit of Inspect's ends is given up, and scored as it was then.
    """

    async def solve(state: TaskState, generate: Generate) -> TaskState:
        talk = _begin(play, state.metadata)
        try:
            state = await generate(state)
            told = talk.hear(state.output.completion)
            while not talk.is_over:
                state.messages.append(ChatMessageUser(content=told))
                state = await generate(state)
                told = talk.hear(state.output.completion)
        finally:  # also on a limit, which Inspect raises as an error
            is_finished = talk.is_over
            talk.game.end()
            played = as_values(record_of(talk, [], state.epoch - 1))  # Inspect counts epochs from 1
            del played["messages"]  # they are in Inspect's log
            state.store.set(PLAYED, {**played, UNFINISHED: not is_finished, VERDICT: talk.game.state})
        return state

    return solve


@metric(scores="unreduced")
def crafting_figures() -> Metric:
    """Compute the figures of an evaluation of agents, and Inspect's standard error over tasks."""

    def figures(scores: list[SampleScore]) -> Value:
        if not scores:
            return {}
        played = distinct_draws([_played(one, PlayedTask) for one in scores])
        tasks, draws = {one.task for one in played}, {one.draw for one in played}
        # With some samples of a task missing there is no interval over tasks.
        is_complete = len(played) == len(tasks) * len(draws)
        success = evaluation_of(played).figures() if is_complete else None

        def mean(name: str) -> float:
            return sum(getattr(one, name) for one in played) / len(played)

        return {
            "success": mean("success"),
            "stderr": float(stderr(cluster="task")(scores)),  # type: ignore[arg-type]
            "ci_low": success.ci_low if success else None,
            "ci_high": success.ci_high if success else None,
            "by_plan": mean("by_plan"),
            "picks": mean("picks"),
            **_counts(scores),
        }

    return figures


@metric(scores="unreduced")
def discovery_figures() -> Metric:
    """Compute the mean number of known entities after some numbers of attempts, and its standard error at the end."""

    def figures(scores: list[SampleScore]) -> Value:
        if not scores:
            return {}
        about = scores[0].sample_metadata or {}
        played = [_played(one, PlayedWorld) for one in scores]
        known = mean_known(played, about["attempts"], about["known_at_start"])
        return {
            **{f"known_{attempts}": value for attempts, value in known.items()},
            "stderr": float(stderr()(scores)),  # type: ignore[arg-type]
            **_counts(scores),
        }

    return figures


def _played(score: SampleScore, kind: type[Any]) -> Any:
    return played_of(score.score.metadata, kind, f"the score of {score.sample_id}")


def _counts(scores: list[SampleScore]) -> dict[str, int]:
    """Return the counts over all games."""
    values = [one.score.metadata or {} for one in scores]
    return {name: sum(one.get(name, 0) for one in values) for name in ("refused", "lost", "look_ups", UNFINISHED)}


@scorer(metrics=[crafting_figures()])
def goal_made() -> Scorer:
    """Score a task: 1 if its goal was made, else 0; the score's metadata is the game's record."""

    async def score(state: TaskState, target: Target) -> Score:
        played = _left(state)
        answer = " + ".join(played["last"]) if played["last"] else None
        return Score(value=int(played["success"]), answer=answer, explanation=played[VERDICT], metadata=played)

    return score


@scorer(metrics=[discovery_figures()])
def things_known() -> Scorer:
    """Score a game in the open-ended world: the number of known entities at its end."""

    async def score(state: TaskState, target: Target) -> Score:
        played = _left(state)
        after = played["known_after"] or [state.metadata["known_at_start"]]
        return Score(value=after[-1], explanation=played[VERDICT], metadata=played)

    return score


def _left(state: TaskState) -> dict[str, Any]:
    """Return the record that the solver has left.

    Raises:
        ArtefactError: if another solver has played.
    """
    played = state.store.get(PLAYED)
    if played is None:
        raise ArtefactError(
            f"sample {state.sample_id} has no game: these tasks are scored by their own solver; leave --solver out."
        )
    return dict(played)
