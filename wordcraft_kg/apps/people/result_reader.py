"""Reader for answers of people, for comparison with the reference results."""

from collections.abc import Iterator, Sequence
from pathlib import Path

from wordcraft_kg.apps.people.study import STUDY_FILE, read_study
from wordcraft_kg.apps.people.summary import view_people
from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.evaluation.reference import Estimate, ReferenceRow, TaskPlay, metrics_of
from wordcraft_kg.evaluation.result_readers import ResultReader, TableGame, check_hash, check_tasks
from wordcraft_kg.graphs.folder import OpenedGraph


def _row(path: Path, opened: OpenedGraph, play: TaskPlay, columns: Sequence[int]) -> ReferenceRow:
    """Return a study's success rates as a row of a reference table, a column per condition."""
    sessions = read_study(path).sessions()
    view = view_people({path: sessions})
    header = sessions[0].header
    # Rates on another split, or with more attempts, would stand in the table as if comparable.
    check_hash(path, "graph", header.graph_hash, opened.graph.hash)
    check_hash(path, "split", header.split_hash, opened.split.hash)
    depth = int(view.settings.get("depth", 1))
    attempts = int(view.settings.get("attempts", 1))
    check_tasks(path, TaskPlay(play.part, depth, attempts), play)
    estimates: dict[int, Estimate] = {}
    people = 0
    resampled = set()
    for condition in view.conditions:
        rate = condition.parts.get(play.part)
        if rate is None or rate.rate is None or condition.distractors not in columns:
            continue
        # Answers of one person resemble each other, so an interval over people comes first.
        bounds = rate.people_interval or rate.interval or (None, None)
        resampled.add("people" if rate.people_interval else "the answers of one person")
        people += rate.people
        estimates[condition.distractors] = (rate.rate, *bounds)
    if not estimates:
        wanted = ", ".join(map(str, columns))
        has = ", ".join(str(condition.distractors) for condition in view.conditions)
        raise ConfigError(
            f"--external-results: '{path}' has no answers to {play.part} tasks with {wanted} "
            f"distractors; expected train or test tasks with {has} distractors."
        )
    return ReferenceRow(
        player=path.name,
        kind="people",
        measure="success",
        figures=metrics_of(estimates),
        origin="external",
        source=str(path),
        play=play,
        interval=f"95 %, over {' or '.join(sorted(resampled))}",
        people=people,
    )


def _games(path: Path, opened: OpenedGraph) -> Iterator[TableGame]:
    """Yield each answer as a game of one attempt."""
    study = read_study(path)
    check_hash(path, "graph", study.record.graph_hash, opened.graph.hash)
    check_hash(path, "split", study.record.split_hash, opened.split.hash)
    for person in study.people:
        for stored in study.answers[person.number]:
            answer = stored.answer
            yield TableGame(
                player=f"person {person.number} of {path.name}",
                kind="people",
                part=answer.part,  # type: ignore[arg-type]
                depth=int(study.record.settings["depth"]),
                goal=answer.goal,
                table=answer.table,
                pairs=(answer.actions,),
                success=answer.success,
            )


def _is_study(path: Path) -> bool:
    return (path / STUDY_FILE).is_file()


def _rows(
    paths: Sequence[Path], opened: OpenedGraph, play: TaskPlay, columns: Sequence[int]
) -> list[ReferenceRow]:
    return [_row(path, opened, play, columns) for path in paths]


READER = ResultReader("a folder of 'people serve'", _is_study, _rows, games=_games)
"""Registered as a reader of results, so that reference tables and the explorer show people."""
