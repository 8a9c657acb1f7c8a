"""Logs of Inspect AI, read as results of text agents."""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import msgspec

from wordcraft_kg.apps.text_agents.records import PlayedSettings, PlayedTask, PlayedWorld, TextResult
from wordcraft_kg.apps.text_agents.results import result_of
from wordcraft_kg.base.errors import ArtefactError, reason
from wordcraft_kg.base.extras import missing_extra
from wordcraft_kg.base.records import Count, Record, as_record

if TYPE_CHECKING:
    from inspect_ai.log import EvalLog

Played = TypeVar("Played", PlayedTask, PlayedWorld)
METADATA = "wordcraft_kg"
"""Key of a task's metadata under which is a :class:`LoggedTask`."""
UNFINISHED = "unfinished"
"""Key of a game's record: whether a limit of Inspect's ended the game."""
VERDICT = "verdict"
"""Key of a game's record: how the game ended, in words."""

_NOT_NEEDED = {"messages", "events", "events_data", "timelines", "store", "output", "attachments"}
"""Fields of a log that are not read; the model's messages make up most of it."""


class LoggedTask(Record, frozen=True, kw_only=True):
    """Metadata of a task in its log.

    Attributes:
        settings: settings of the games.
        games: games in an epoch.
        people: discoveries of people in another game's open-ended world, and their source.
    """

    settings: PlayedSettings
    games: Count
    people: dict[str, Any] | None = None


def read_inspect_log(path: str | Path) -> TextResult:
    """Read the result of a language model from a log of ``crafting`` or ``discovery``, ``.eval`` or ``.json``.

    The model's name is the player. A game that a limit of Inspect's has ended counts; without a game that has failed or
    was not played there is no result. Tables that were played several times (``--epochs``) count like further draws.

    Raises:
        MissingExtraError: if Inspect AI is not installed.
        ArtefactError: if the file is missing or damaged, no log of these tasks, or not all games were played.
    """
    path = Path(path)
    log = _read(path)
    about = (log.eval.metadata or {}).get(METADATA)
    if about is None:
        raise ArtefactError(
            f"{path} is a log of '{log.eval.task}'; expected one of wordcraft_kg/crafting or wordcraft_kg/discovery."
        )
    task = as_record(about, LoggedTask, path)
    settings, scores = task.settings, _scores(path, log, task.games)
    if settings.is_open_ended:
        return result_of(log.eval.model, settings, [played_of(one, PlayedWorld, str(path)) for one in scores])
    played = [played_of(one, PlayedTask, str(path)) for one in scores]
    return result_of(log.eval.model, settings, distinct_draws(played))


def _read(path: Path) -> "EvalLog":
    try:
        from inspect_ai.log import read_eval_log
    except ModuleNotFoundError:
        raise missing_extra("inspect", ["Inspect AI"]) from None
    if not path.is_file():
        raise ArtefactError(f"{path} is not a file; expected a log of Inspect AI, .eval or .json.")
    try:
        return read_eval_log(str(path), exclude_fields=_NOT_NEEDED)
    except Exception as error:  # of a damaged file Inspect raises whatever comes up
        raise ArtefactError(
            f"{path} is no log of Inspect AI (.eval or .json), or it is damaged ({reason(error)})."
        ) from None


def _scores(path: Path, log: "EvalLog", games: int) -> list[dict[str, Any]]:
    """Return what was recorded of each game, if all games were played."""
    expected = games * (log.eval.config.epochs or 1)
    scores = []
    for sample in log.samples or []:
        for name in ("goal_made", "things_known"):
            if sample.error is None and sample.scores and name in sample.scores:
                scores.append(sample.scores[name].metadata or {})
    there = f"{len(scores):,} of {expected:,} games were played"
    if log.status != "success":
        said = {"started": "it was cut off, or goes on", "cancelled": "it was stopped"}.get(log.status, "it has failed")
        raise ArtefactError(
            f"{path} is of a run that is not done: {said}, and {there}. Finish it: inspect eval-retry {path}"
        )
    if len(scores) != expected:
        raise ArtefactError(
            f"{path}: {there}; expected all. Of fewer tasks, evenly spaced, the figures can be compared: use "
            "-T tasks=N instead of --limit or --sample-id; failed ones are played again by inspect eval-retry."
        )
    return scores


def played_of(values: Mapping[str, Any] | None, kind: type[Played], where: str) -> Played:
    """Return a game from the metadata of its score.

    Raises:
        ArtefactError: if it is not one; ``where`` names the source.
    """
    bare = {key: value for key, value in (values or {}).items() if key not in (UNFINISHED, VERDICT)}
    return as_record({**bare, "messages": []}, kind, where)


def distinct_draws(played: Sequence[PlayedTask]) -> list[PlayedTask]:
    """Return games so that no task has a draw twice: a table that is played again counts like a further draw.

    Inspect's epochs play each sample several times.
    """
    draws = 1 + max((one.draw for one in played), default=0)
    times: dict[tuple[int, int], int] = defaultdict(int)
    found = []
    for one in played:
        place = one.task, one.draw
        found.append(msgspec.structs.replace(one, draw=one.draw + draws * times[place]))
        times[place] += 1
    return found
