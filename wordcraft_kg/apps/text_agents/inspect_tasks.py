"""Tasks for Inspect AI, which evaluates language models, and the games in its logs.

``inspect eval wordcraft_kg/crafting`` and ``discovery`` find the tasks by the package's entry
point; :func:`read_inspect_log` reads a log of either.
"""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from msgspec.structs import replace

from wordcraft_kg.apps.text_agents.benchmark import open_track
from wordcraft_kg.apps.text_agents.games import TaskGame
from wordcraft_kg.apps.text_agents.plays import DiscoveryGames, Play, chosen_tasks, open_play
from wordcraft_kg.apps.text_agents.results import (
    COUNTS,
    GameRecord,
    GamesHeader,
    evaluation_of,
    mean_known,
    record_of,
)
from wordcraft_kg.apps.text_agents.settings import (
    ATTEMPTS,
    LOOK_UPS,
    MAX_INVALID,
    KnowledgeKind,
    PlayedSettings,
)
from wordcraft_kg.base import (
    MAX_SIZE,
    ArtefactError,
    ConfigError,
    Count,
    Record,
    WordCraftKGError,
    as_record,
    as_values,
    reason,
    whole,
)
from wordcraft_kg.base.extras import missing_extra
from wordcraft_kg.base.wording import for_file
from wordcraft_kg.graphs import TaskPart, open_graph

try:
    from inspect_ai import Task, task

    # A private name, but the only error that Inspect shows without a traceback.
    from inspect_ai._util.error import PrerequisiteError
    from inspect_ai.dataset import MemoryDataset, Sample
    from inspect_ai.log import EvalLog, read_eval_log
    from inspect_ai.model import ChatMessage, ChatMessageSystem, ChatMessageUser
    from inspect_ai.scorer import (
        Metric,
        SampleScore,
        Score,
        Scorer,
        Target,
        Value,
        metric,
        scorer,
        stderr,
    )
    from inspect_ai.solver import Generate, Solver, TaskState, solver
except ModuleNotFoundError:
    raise missing_extra("inspect", ["Inspect AI"]) from None

METADATA = "wordcraft_kg"
"""Key in the metadata of an Inspect task; the value is a :class:`LoggedTask`."""
UNFINISHED = "unfinished"
"""Key in the record of a game: whether an Inspect limit ended the game."""

# The records of the games stand in the scores, so results need none of these.
_NOT_NEEDED = {"messages", "events", "events_data", "timelines", "store", "output", "attachments"}
"""Skipped log fields; messages are the largest part."""
_GAME = ("everyday", "test", 1, 8, None)
"""Defaults of graph, part, depth, distractors and attempts."""
_RULES = (None, LOOK_UPS, 1, None, MAX_INVALID)
"""Defaults of scorer, look-ups, distractor seeds, tasks and invalid actions."""
_SCORE = "wordcraft_kg_score"
"""Key in a sample's store, by which the solver hands the game's score to the scorer."""


class InspectTaskError(ConfigError, PrerequisiteError):
    """A parameter for an Inspect task is invalid; Inspect shows the message without a traceback."""

    def __init__(self, message: str):
        from rich.markup import escape

        # Inspect prints the message as Rich markup, in which text in brackets would vanish.
        ValueError.__init__(self, message)
        self.message = escape(message)


@task
def crafting(  # noqa: PLR0913 - parameters are the options of `inspect eval -T`
    graph: str = "everyday",
    part: TaskPart = "test",
    depth: int = 1,
    distractors: int = 8,
    attempts: int | None = None,
    distractor_seeds: int = 1,
    tasks: int | None = None,
    knowledge: KnowledgeKind = "none",
    scorer: str | None = None,
    look_ups: int = LOOK_UPS,
    max_invalid: int = MAX_INVALID,
    track: str | None = None,
) -> Task:
    """Return an Inspect task: make goals from the entities on a table, as in agent evaluation.

    Args:
        graph: graph folder, recipe book file, or name of a built-in book.
        part: part of the tasks.
        depth: fewest attempts that make the goal.
        distractors: distractors on the table.
        attempts: attempts in a game; None for the depth.
        distractor_seeds: tables per task, with different distractors.
        tasks: number of tasks, evenly spaced over the part; None for all.
        knowledge: look-up source.
        scorer: model folder, for ``knowledge`` scorer.
        look_ups: look-ups in a game.
        max_invalid: consecutive invalid actions without cost.
        track: track of the benchmark, which fits with ``knowledge`` only.

    Raises:
        InspectTaskError: for a wrong parameter, or an unreadable graph or scorer.
    """
    with _readable():
        whole("distractor_seeds", distractor_seeds, 1, MAX_SIZE)
        whole("max_invalid", max_invalid, 0, MAX_SIZE)
        # Inspect may have parsed a book's name as a number.
        game = (str(graph), part, depth, distractors, attempts)
        rules = (_folder(scorer), look_ups, distractor_seeds, tasks, max_invalid)
        if track is None:
            play: Play = open_play(
                *game,
                knowledge=knowledge,
                scorer=_folder(scorer),
                look_ups=look_ups,
                distractor_seeds=distractor_seeds,
                tasks=tasks,
                max_invalid=max_invalid,
            )
        elif (*game, *rules) == (*_GAME, *_RULES):
            play = open_track(str(track)).play(knowledge)
        else:
            raise ConfigError("`track` has its own games; omit all but `knowledge`.")
        played = play.settings
        if played.is_open_ended:  # a track
            return _discovery(play)
        all_tasks = play.world.tasks
        groups = play.world.groups.tolist()
        task_numbers = chosen_tasks(play.world, played.tasks).tolist()
        samples: list[Sample] = []
        # Seed by seed: after a part of the run, each task has been played about equally often.
        for seed, number in product(range(played.distractor_seeds), task_numbers):
            about = {
                "task": number,
                "distractor_seed": seed,
                "goal": all_tasks[number].goal,
                "group": groups[number],
            }
            samples.append(_sample(f"{played.part}-{number}-{seed}", play, **about))
        return _task(play, samples, f"{played.graph}, {played.part}")


@task
def discovery(
    graph: str = "everyday",
    attempts: int = ATTEMPTS,
    base: Any = None,
    games: int = 1,
    knowledge: KnowledgeKind = "none",
    scorer: str | None = None,
    look_ups: int = LOOK_UPS,
    max_invalid: int = MAX_INVALID,
) -> Task:
    """Return an Inspect task: discover entities in the open-ended world.

    Args:
        graph: graph folder, recipe book file, or name of a built-in book.
        attempts: attempts in a game.
        base: label or labels of the entities at the start; None for the graph's base.
        games: number of games, all from the same entities.
        knowledge: look-up source.
        scorer: model folder, for ``knowledge`` scorer.
        look_ups: look-ups in a game.
        max_invalid: consecutive invalid actions without cost.

    Raises:
        InspectTaskError: for a wrong parameter, or an unreadable graph or scorer.
    """
    with _readable():
        whole("games", games, 1, MAX_SIZE)
        # Inspect parses labels such as `1` and `true` as a number and a truth value.
        labels = base if isinstance(base, list | tuple) else [base]
        play = DiscoveryGames(
            open_graph(str(graph)),
            attempts=attempts,
            base=None if base is None else [str(label) for label in labels],
            knowledge=knowledge,
            scorer=_folder(scorer),
            look_ups=look_ups,
            distractor_seeds=games,
            max_invalid=whole("max_invalid", max_invalid, 0, MAX_SIZE),
        )
        return _discovery(play)


def _folder(scorer: object) -> Path | None:
    # Inspect may have parsed the name of a folder as a number.
    return None if scorer is None else Path(str(scorer))


def _discovery(play: Play) -> Task:
    rules = play.settings
    about = {"attempts": rules.attempts, "known_at_start": len(rules.base)}
    samples = [
        _sample(f"world-{game}", play, distractor_seed=game, **about)
        for game in range(rules.distractor_seeds)
    ]
    return _task(play, samples, rules.graph)


def _sample(identity: str, play: Play, **about: Any) -> Sample:
    talk = play.begin(about.get("task", 0), about["distractor_seed"])
    opening: list[ChatMessage] = [
        ChatMessageSystem(content=talk.rules),
        ChatMessageUser(content=talk.game.state),
    ]
    return Sample(id=identity, input=opening, target=about.get("goal", ""), metadata=about)


def _task(play: Play, samples: list[Sample], name: str) -> Task:
    return Task(
        dataset=MemoryDataset(samples, name=name),
        solver=conversation(play),
        scorer=game_score(),
        version=play.settings.prompt_hash[:12],
        metadata={METADATA: as_values(LoggedTask(settings=play.settings, games=len(samples)))},
    )


@contextmanager
def _readable() -> Iterator[None]:
    """Convert package errors into errors that Inspect shows without a traceback."""
    try:
        yield
    except WordCraftKGError as error:
        raise InspectTaskError(str(error)) from error


@solver
def conversation(play: Play) -> Solver:
    """Return an Inspect solver: a model plays until the game is over, or until an Inspect limit."""

    async def solve(state: TaskState, generate: Generate) -> TaskState:
        seed = state.metadata["distractor_seed"]
        # The same game as in the sample, whose prompts the model has already got.
        talk = play.begin(state.metadata.get("task", 0), seed)
        game = talk.game
        try:
            while True:
                state = await generate(state)
                message = state.output.message
                text = for_file(message.text)
                # Half a character could be neither sent again nor logged.
                if text != message.text:
                    message.text = text
                reply = talk.hear(text)
                if talk.is_over:
                    break
                state.messages.append(ChatMessageUser(content=reply))
        finally:
            # Also on a limit, which Inspect raises as an error: the game counts as it stands,
            # because a model that runs out of tokens has not made the goal.
            is_finished = talk.is_over
            talk.end()
            # Inspect's log has the messages already.
            played = as_values(replace(record_of(talk), messages=()))
            last = game.pairs[-1] if game.pairs else None
            score = {
                "value": int(game.is_made) if isinstance(game, TaskGame) else len(game.labels),
                "answer": " + ".join(last) if last else None,
                "explanation": game.state,
                "metadata": {**played, UNFINISHED: not is_finished},
            }
            state.store.set(_SCORE, score)
        return state

    return solve


@metric(scores="unreduced")
def game_figures() -> Metric:
    """Return an Inspect metric for games of either kind, with counts in the run."""

    def figures(scores: list[SampleScore]) -> Value:
        if not scores:
            return {}
        values = [score.score.metadata or {} for score in scores]
        counts: dict[str, int] = {}
        for name in (*COUNTS, UNFINISHED):
            counts[f"{name}_in_run"] = sum(game.get(name, 0) for game in values)
        is_open_ended = "known_at_start" in (scores[0].sample_metadata or {})
        figures_of = discovery_figures if is_open_ended else crafting_figures
        return {**figures_of(scores), **counts}

    return figures


def crafting_figures(scores: list[SampleScore]) -> dict[str, float | None]:
    """Return the figures of crafting tasks.

    These are success with the standard error and interval over groups of tasks that the split holds
    out together, the share of goals made by a plan, and actions per game.
    """
    played = [_game(score) for score in scores]
    tasks = {game.task for game in played}
    distractor_seeds = {game.distractor_seed for game in played}
    groups = np.zeros(max(tasks) + 1, dtype=np.int64)
    for score, game in zip(scores, played, strict=True):
        groups[game.task] = (score.sample_metadata or {})["group"]
    # The interval needs all distractor seeds. Failed samples may be missing.
    success = None
    if len(played) == len(tasks) * len(distractor_seeds):
        success = evaluation_of(played, groups).metrics()

    def mean(name: str) -> float:
        return sum(getattr(game, name) for game in played) / len(played)

    return {
        "success": mean("success"),
        # Games of a group are not independent: alike goals, and one task on several tables.
        "stderr": float(stderr(cluster="group")(scores)),  # type: ignore[arg-type]
        "ci_low": success.ci_low if success else None,
        "ci_high": success.ci_high if success else None,
        "by_plan": mean("by_plan"),
        "actions_per_game": mean("actions"),
    }


def discovery_figures(scores: list[SampleScore]) -> dict[str, float | None]:
    """Return the figures of open-ended games.

    These are mean numbers of known entities by attempts, and the standard error at the end.
    """
    about = scores[0].sample_metadata or {}
    curves = [(about["known_at_start"], *_game(score).known_after) for score in scores]
    means = mean_known(curves, about["attempts"])
    return {
        **{f"known_{attempts}": value for attempts, value in means.items()},
        "stderr": float(stderr()(scores)),  # type: ignore[arg-type]
    }


def _game(score: SampleScore) -> GameRecord:
    return game_of_score(score.score.metadata, f"the score of {score.sample_id}")


@scorer(metrics=[game_figures()])
def game_score() -> Scorer:
    """Return an Inspect scorer: 1 if the goal was made, else 0; or the number of known entities.

    That is their number at the end of an open-ended game. The score's metadata is the game's
    record.
    """

    async def score(state: TaskState, target: Target) -> Score:
        values = state.store.get(_SCORE)
        if values is None:
            raise ArtefactError(
                f"sample {state.sample_id} has no game: these tasks are scored by their own "
                "solver; leave --solver out."
            )
        return Score(**values)

    return score


class LoggedTask(Record, frozen=True, kw_only=True):
    """Metadata for an Inspect task in a log.

    Attributes:
        settings: settings of the games.
        games: number of games in an epoch.
    """

    settings: PlayedSettings
    games: Count


def read_inspect_log(
    path: str | Path,
) -> tuple[GamesHeader, list[GameRecord], dict[str, int]]:
    """Read a language model's games from an Inspect log of ``crafting`` or ``discovery``.

    Metrics follow from the games, as for any other player. A game that an Inspect limit ended
    counts. A game that was not played or has failed is missing, and then there is no result,
    because the other tasks may be easier.

    Args:
        path: the log's file, ``.eval`` or ``.json``.

    Returns:
        The model's name with the settings of the games, their records without messages, and the
        numbers of tokens by kind (input, output) over all models in the log.

    Raises:
        ArtefactError: for a missing or damaged file, the log of another Inspect task, or missing
            games.
    """
    path = Path(path)
    try:
        log = read_eval_log(str(path), exclude_fields=_NOT_NEEDED)
    except Exception as error:  # a damaged file may raise any error
        raise ArtefactError(
            f"{path} cannot be read as an Inspect AI log, .eval or .json ({reason(error)})."
        ) from None
    about = (log.eval.metadata or {}).get(METADATA)
    if about is None:
        raise ArtefactError(
            f"{path} logs the task '{log.eval.task}'; expected wordcraft_kg/crafting or "
            "wordcraft_kg/discovery."
        )
    task = as_record(about, LoggedTask, path)
    header = GamesHeader(player=log.eval.model, settings=task.settings)
    games = [game_of_score(score, str(path)) for score in _scores(path, log, task.games)]
    usages = log.stats.model_usage.values()
    tokens = {
        "input": sum(usage.input_tokens for usage in usages),
        "output": sum(usage.output_tokens for usage in usages),
    }
    return header, games, tokens


def _scores(path: Path, log: EvalLog, games: int) -> list[dict[str, Any]]:
    scores = []
    for sample in log.samples or []:
        score = (sample.scores or {}).get("game_score")
        # A failed game has an error, and a sample of another task other scores.
        if sample.error is None and score is not None:
            scores.append(score.metadata or {})
    progress = f"{len(scores):,} of {games:,} games were played"
    if log.status != "success":
        raise ArtefactError(
            f"{path}: the evaluation has the status {log.status}, {progress}. Continue with "
            f"inspect eval-retry {path}"
        )
    if len(scores) != games:
        # Fewer games are a selection; more are repetitions, whose tables are no independent draws.
        raise ArtefactError(
            f"{path}: {progress}; expected each game once. Play fewer tasks with -T tasks=N "
            "instead of --limit or "
            "--sample-id, and more games with -T distractor_seeds=N or games=N instead of "
            "--epochs; repeat failed "
            "games with inspect eval-retry."
        )
    return scores


def game_of_score(values: Mapping[str, Any] | None, place: str) -> GameRecord:
    """Parse a score's metadata as the record of a game.

    Args:
        values: the metadata; None if the score has none.
        place: where the score is from, for errors.

    Raises:
        ArtefactError: if the metadata is no such record.
    """
    # The messages are in the log's samples, once.
    record = {key: value for key, value in (values or {}).items() if key != UNFINISHED}
    return as_record(record, GameRecord, place)
