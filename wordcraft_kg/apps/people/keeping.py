"""The folder of a study while it is served: begun or gone on with, and one server's alone."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from wordcraft_kg.apps.people.answers_database import AnswersDatabase
from wordcraft_kg.apps.people.protocol import HUMAN_PARTS
from wordcraft_kg.apps.people.study import (
    ANSWERS_FILE,
    Study,
    check_study_folder,
    read_study_record,
    write_study_record,
)
from wordcraft_kg.apps.people.study_folder import read_study
from wordcraft_kg.base.errors import ArtefactError
from wordcraft_kg.runs.folder import locked


@contextmanager
def kept_answers(folder: Path, study: Study) -> Iterator[AnswersDatabase]:
    """Yield the answers of a study in a folder, new or begun.

    Raises:
        ArtefactError: if another server has it, or what is there is damaged or of tasks that this version poses
            otherwise.
        GraphMismatchError, ConfigError, OutputExistsError: see
            :func:`~wordcraft_kg.apps.people.study.check_study_folder`; the folder is unchanged in all cases.
    """
    check_study_folder(folder, study.record)
    folder.mkdir(parents=True, exist_ok=True)
    with locked(folder, "served"):
        if not check_study_folder(folder, study.record):
            write_study_record(folder, study.record)
        _, identity = read_study_record(folder)
        path = folder / ANSWERS_FILE
        if path.exists():
            _check_tasks(folder, study)
        answers = AnswersDatabase.open(path, identity, len(HUMAN_PARTS) * study.record.tasks)
        try:
            yield answers
        finally:
            answers.close()


def _check_tasks(folder: Path, study: Study) -> None:
    """Refuse to go on if this version of the package poses other tasks than those that have been answered."""
    found = read_study(folder)
    for person in found.people:
        for stored, task in zip(found.answers[person.number], study.tasks(person.cell), strict=False):
            if (stored.answer.goal, stored.answer.table) != (task.goal, task.table):
                raise ArtefactError(
                    f"'{folder}': this version poses another {task.part} task {task.number} than person "
                    f"{person.number} has answered. Nothing was changed; go on with the version that it was begun with."
                )
