"""What a study's folder holds: its people as sessions, and its answers as lines."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from wordcraft_kg.apps.people.answers_database import Participant, StoredAnswer, read_answers
from wordcraft_kg.apps.people.protocol import schedule
from wordcraft_kg.apps.people.session_file import Session, is_sound
from wordcraft_kg.apps.people.study import ANSWERS_FILE, StudyRecord, read_study_record
from wordcraft_kg.base.errors import ArtefactError
from wordcraft_kg.base.records import Count, Record


class AnswerLine(Record):
    """A line of ``study export``: one answer, and nothing about the person but a number.

    Attributes:
        session: number of the person, from 1, in the order in which they began.
        form: number of the draw of tasks, from 0.
        distractors: the person's condition.
        seed: seed of the form; ``play --protocol paper`` with it poses the same tasks.
        part: ``train`` or ``test``.
        number: number of the task in its part, from 1.
        goal: entity to make.
        table: entities on the table, slot by slot.
        picks: the two entities picked.
        made: their results.
        success: whether the goal is among them.
        seconds: from the first showing of the task to the second pick, on the server's clock.
        loads: how often the task's page was loaded; more than once after a reload or a return.
    """

    session: Count
    form: Count
    distractors: Count
    seed: Count
    part: str
    number: Count
    goal: str
    table: tuple[str, ...]
    picks: tuple[str, ...]
    made: tuple[str, ...]
    success: bool
    seconds: float
    loads: Count


@dataclass(frozen=True)
class ReadStudy:
    """A study as it is on the disk.

    Attributes:
        record: what it is.
        people: those who have begun, in their order.
        answers: their answers by the number of the person.
    """

    record: StudyRecord
    people: tuple[Participant, ...]
    answers: dict[int, tuple[StoredAnswer, ...]]

    def sessions(self) -> tuple[Session, ...]:
        """Return what each person answered, as the file of a session would hold it."""
        return tuple(
            Session(
                self.record.header(person.cell.form, person.cell.distractors),
                tuple(stored.answer for stored in self.answers[person.number]),
            )
            for person in self.people
        )

    def lines(self) -> Iterator[AnswerLine]:
        """Yield the lines of the export."""
        for person in self.people:
            for stored in self.answers[person.number]:
                one = stored.answer
                yield AnswerLine(
                    session=person.number,
                    form=person.cell.form,
                    distractors=person.cell.distractors,
                    seed=self.record.seed + person.cell.form,
                    part=one.part,
                    number=one.number,
                    goal=one.goal,
                    table=one.table,
                    picks=one.picks,
                    made=one.made,
                    success=one.success,
                    seconds=one.seconds,
                    loads=stored.loads,
                )


def read_study(folder: Path) -> ReadStudy:
    """Read the folder of a study, which may be served at this moment; nothing is written.

    Raises:
        ArtefactError: if it is not one, or damaged.
    """
    record, identity = read_study_record(folder)
    path = folder / ANSWERS_FILE
    people, found = read_answers(path, identity)
    answers: dict[int, list[StoredAnswer]] = {person.number: [] for person in people}
    for stored in found:
        answers.setdefault(stored.session, []).append(stored)
    turns = schedule(record.tasks)
    for number, given in answers.items():
        order = tuple((one.answer.part, one.answer.number) for one in given)
        if order != turns[: len(order)] or not all(is_sound(one.answer) and one.loads >= 1 for one in given):
            raise ArtefactError(f"{path} is damaged: the answers of person {number} are not as they are stored.")
    if set(answers) != {person.number for person in people}:
        raise ArtefactError(f"{path} is damaged: it has answers of somebody who has not begun.")
    if unknown := {person.cell.distractors for person in people} - set(record.distractors):
        raise ArtefactError(f"{path} is damaged: {unknown.pop()} distractors are no condition of this study.")
    return ReadStudy(record, tuple(people), {number: tuple(given) for number, given in answers.items()})
