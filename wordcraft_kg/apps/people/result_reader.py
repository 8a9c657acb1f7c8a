"""Reader for answers of people, for comparison with the reference figures."""

from collections.abc import Iterator, Sequence
from pathlib import Path

from wordcraft_kg.apps.people.study import STUDY_FILE, read_study
from wordcraft_kg.apps.people.summary import view_people
from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.evaluation.reference import Estimate, ReferenceRow, TaskPlay, figures_of
from wordcraft_kg.evaluation.result_readers import ResultReader, TableGame, check_hash, check_tasks
from wordcraft_kg.graphs.folder import OpenedGraph


def _row(path: Path, opened: OpenedGraph, play: TaskPlay, columns: Sequence[int]) -> ReferenceRow:
    sessions = read_study(path).sessions()
    view = view_people({path: sessions})
    header = sessions[0].header
    check_hash(path, "graph", header.graph_hash, opened.graph.hash)
    check_hash(path, "split", header.split_hash, opened.split.hash)
    settings = view.settings
    check_tasks(
        path,
        TaskPlay(play.part, int(settings.get("depth", 1)), int(settings.get("attempts", 1))),
        play,
    )
    estimates: dict[int, Estimate] = {}
    people, over = 0, set()
    for condition in view.conditions:
        rate = condition.parts.get(play.part)
        if rate is None or rate.rate is None or condition.distractors not in columns:
            continue
        bounds = rate.people_interval or rate.interval or (None, None)
        over.add("people" if rate.people_interval else "the answers of one person")
        people += rate.people
        estimates[condition.distractors] = (rate.rate, *bounds)
    if not estimates:
        has = ", ".join(str(condition.distractors) for condition in view.conditions)
        raise ConfigError(
            f"--external-results: '{path}' has no answers to {play.part} tasks with {', '.join(map(str, columns))} "
            f"distractors; expected train or test tasks with {has} distractors."
        )
    return ReferenceRow(
        player=path.name,
        kind="people",
        measure="success",
        figures=figures_of(estimates),
        origin="external",
        source=str(path),
        play=play,
        interval=f"95 %, over {' or '.join(sorted(over))}",
        people=people,
    )


def _games(path: Path, opened: OpenedGraph) -> Iterator[TableGame]:
    study = read_study(path)
    check_hash(path, "graph", study.record.graph_hash, opened.graph.hash)
    check_hash(path, "split", study.record.split_hash, opened.split.hash)
    for person in study.people:
        for answer in (stored.answer for stored in study.answers[person.number]):
            yield TableGame(
                f"person {person.number} of {path.name}",
                "people",
                answer.part,  # type: ignore[arg-type]
                int(study.record.settings["depth"]),
                answer.goal,
                answer.table,
                (answer.actions,),
                answer.success,
            )


READER = ResultReader(
    "a folder of 'people serve'",
    lambda path: (path / STUDY_FILE).is_file(),
    lambda paths, opened, play, columns: [_row(path, opened, play, columns) for path in paths],
    games=_games,
)
