"""Reading logs of Inspect AI: what a language model did there, as a result like that of any player that uses words."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

from wordcraft_kg.agents.words.evaluation import result_of_tasks, result_of_worlds
from wordcraft_kg.agents.words.records import WordsResult, WordsSettings
from wordcraft_kg.errors import ArtefactError, reason
from wordcraft_kg.interfaces.inspect_extra import missing_inspect
from wordcraft_kg.records import as_record

if TYPE_CHECKING:
    from inspect_ai.log import EvalLog

_NOT_NEEDED = {"messages", "events", "events_data", "timelines", "store", "output", "attachments"}
"""Of a game in a log; what a model said makes up most of it."""


def read_inspect_log(path: str | Path) -> WordsResult:
    """Read the result of a language model from a log of Inspect AI, of ``crafting`` or ``discovery``.

    The model's name is the player, and the figures are made from the games, as those of any other player. A game that
    a limit of Inspect's has ended counts; one that was not played, or has failed, is missing, and then there is no
    result.
    Tables that were played several times (``--epochs``) count like further draws.

    Args:
        path: the log's file, ``.eval`` or ``.json``.

    Raises:
        MissingExtraError: if Inspect AI is not installed.
        ArtefactError: if the file is missing or damaged, no log of these tasks, or not all games were played.
    """
    path = Path(path)
    log = _read(path)
    about = (log.eval.metadata or {}).get("wordcraft_kg")
    if not isinstance(about, dict) or "settings" not in about:
        raise ArtefactError(
            f"{path} is a log of '{log.eval.task}'; expected one of wordcraft_kg/crafting or wordcraft_kg/discovery."
        )
    settings = as_record(about["settings"], WordsSettings, path)
    scores = _scores(path, log, int(about.get("games", 0)))
    from wordcraft_kg.interfaces.inspect_games import distinct_draws, played_task_of, played_world_of

    if settings.is_open_ended:
        return result_of_worlds(log.eval.model, settings, [played_world_of(one, str(path)) for one in scores])
    played = distinct_draws([played_task_of(one, str(path)) for one in scores])
    return result_of_tasks(log.eval.model, settings, None, played)


def _read(path: Path) -> "EvalLog":
    try:
        from inspect_ai.log import read_eval_log
    except ModuleNotFoundError:
        raise missing_inspect() from None
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
