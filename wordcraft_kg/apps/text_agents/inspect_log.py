"""Text agents' results in logs by Inspect AI, a framework for evaluating language models."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from wordcraft_kg.apps.text_agents.records import (
    GameRecord,
    PlayedSettings,
)
from wordcraft_kg.apps.text_agents.results import evaluation_of, groups_of
from wordcraft_kg.base import ArtefactError, Count, Record, as_record, reason
from wordcraft_kg.base.extras import missing_extra
from wordcraft_kg.graphs.folder import OpenedGraph

if TYPE_CHECKING:
    from inspect_ai.log import EvalLog, EvalSample

    from wordcraft_kg.agents.evaluation import Evaluation

METADATA = "wordcraft_kg"
"""Key in the metadata of an Inspect task; the value is a :class:`LoggedTask`."""
UNFINISHED = "unfinished"
"""Key in the record of a game: whether an Inspect limit ended the game."""
VERDICT = "verdict"
"""Key in the record of a game: the outcome as text."""

# The records of the games stand in the scores, so results need none of these.
_NOT_NEEDED = {"messages", "events", "events_data", "timelines", "store", "output", "attachments"}
"""Skipped log fields; messages are the largest part."""


class LoggedTask(Record, frozen=True, kw_only=True):
    """Metadata for an Inspect task in a log.

    Attributes:
        settings: settings of the games.
        games: number of games in an epoch.
    """

    settings: PlayedSettings
    games: Count


@dataclass(frozen=True)
class LoggedGames:
    """Games in an Inspect log.

    Attributes:
        model: the model's name.
        settings: settings of the games.
        games: records of the games, without messages.
        tokens: numbers of tokens by kind (input, output), over all models in the log.
    """

    model: str
    settings: PlayedSettings
    games: Sequence[GameRecord]
    tokens: Mapping[str, int]

    def evaluation(self, opened: OpenedGraph | None = None) -> "Evaluation":
        """Return the evaluation of the games on tasks; ``metrics()`` has the success rate.

        Args:
            opened: graph of the games, for intervals that resample the groups of tasks that its
                split holds out together; None resamples tasks.
        """
        return evaluation_of(self.games, groups_of(opened, self.settings) if opened else None)


def read_inspect_log(path: str | Path) -> LoggedGames:
    """Read a language model's games from an Inspect log of ``crafting`` or ``discovery``.

    Metrics follow from the games, as for any other player. A game that an Inspect limit ended
    counts. A game that was not played or has failed is missing, and then there is no result,
    because the other tasks may be easier.

    Args:
        path: the log's file, ``.eval`` or ``.json``.

    Raises:
        MissingExtraError: if Inspect AI is not installed.
        ArtefactError: for a missing or damaged file, the log of another Inspect task, or missing
            games.
    """
    path = Path(path)
    log = _read(path)
    about = (log.eval.metadata or {}).get(METADATA)
    if about is None:
        raise ArtefactError(
            f"{path} logs the task '{log.eval.task}'; expected wordcraft_kg/crafting or "
            "wordcraft_kg/discovery."
        )
    task = as_record(about, LoggedTask, path)
    settings = task.settings
    scores = _scores(path, log, task.games)
    games = [game_of_score(score, str(path)) for score in scores]
    usages = log.stats.model_usage.values()
    tokens = {
        "input": sum(usage.input_tokens for usage in usages),
        "output": sum(usage.output_tokens for usage in usages),
    }
    return LoggedGames(log.eval.model, settings, games, tokens)


def _read(path: Path) -> "EvalLog":
    try:
        from inspect_ai.log import read_eval_log
    except ModuleNotFoundError:
        raise missing_extra("inspect", ["Inspect AI"]) from None
    if not path.is_file():
        raise ArtefactError(f"{path} is not a file; expected an Inspect AI log, .eval or .json.")
    try:
        return read_eval_log(str(path), exclude_fields=_NOT_NEEDED)
    except Exception as error:  # a damaged file may raise any error
        raise ArtefactError(
            f"{path} cannot be read as an Inspect AI log, .eval or .json ({reason(error)})."
        ) from None


def _scores(path: Path, log: "EvalLog", games: int) -> list[dict[str, Any]]:
    sample_scores = map(_score, log.samples or [])
    scores = [score for score in sample_scores if score is not None]
    progress = f"{len(scores):,} of {games:,} games were played"
    if log.status != "success":
        state = {"started": "unfinished", "cancelled": "stopped"}.get(log.status, "failed")
        raise ArtefactError(
            f"{path}: the evaluation is {state}, {progress}. Continue with inspect eval-retry "
            f"{path}"
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


def _score(sample: "EvalSample") -> dict[str, Any] | None:
    """Return the metadata of a game's score.

    None for a failed game, or a sample of another task.
    """
    for name in ("goal_made", "known_items"):
        if sample.error is None and sample.scores and name in sample.scores:
            return sample.scores[name].metadata or {}
    return None


def game_of_score(values: Mapping[str, Any] | None, place: str) -> GameRecord:
    """Parse a score's metadata as the record of a game.

    Args:
        values: the metadata; None if the score has none.
        place: where the score is from, for errors.

    Raises:
        ArtefactError: if the metadata is no such record.
    """
    # The messages are in the log's samples, once.
    extra = (UNFINISHED, VERDICT)
    record = {key: value for key, value in (values or {}).items() if key not in extra}
    return as_record(record, GameRecord, place)
