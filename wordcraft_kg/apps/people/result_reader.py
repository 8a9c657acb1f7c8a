"""Reader for answers of people as recorded games."""

from collections.abc import Iterator
from pathlib import Path

from wordcraft_kg.apps.people.study import STUDY_FILE, read_study
from wordcraft_kg.evaluation.reference import GameReader, TableGame, check_hash
from wordcraft_kg.graphs.folder import OpenedGraph


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


READER = GameReader("a folder of 'people serve'", _is_study, _games)
"""Registered as a reader of games, so that the explorer shows people."""
