"""A study: several people take the protocol, with several draws of tasks and numbers of distractors; and its folder."""

import hashlib
import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Literal

from wordcraft_kg.apps.people.answers_database import (
    ANSWERS_FILE,
    AnswersDatabase,
    Cell,
    Participant,
    StoredAnswer,
    read_answers,
)
from wordcraft_kg.apps.people.config import MOST_TASKS, StudyConfig
from wordcraft_kg.apps.people.protocol import HUMAN_FORMAT, HUMAN_PARTS, Header, HumanProtocol, PosedTask, schedule
from wordcraft_kg.apps.people.session_file import Session, check_number
from wordcraft_kg.base.artefacts import dump_json, read_small_file, what_is, write_atomically
from wordcraft_kg.base.errors import ArtefactError, ConfigError, GraphMismatchError, OutputExistsError
from wordcraft_kg.base.records import Count, Hash, Record, as_values, parse_record
from wordcraft_kg.envs.world import GraphLike
from wordcraft_kg.runs.folder import locked

STUDY_FILE = "study.json"


class StudyRecord(Record):
    """``study.json``: the identity of a study; its settings leave out the number of distractors."""

    format: Literal["wordcraft-kg study 1"]
    graph: str
    graph_hash: Hash
    split_hash: Hash
    settings: dict[str, int | str]
    distractors: tuple[Count, ...]
    seed: Count
    forms: Count
    consent: str
    created: str

    def header(self, cell: Cell) -> Header:
        """Return the header of a session's file with a form and condition."""
        settings = self.settings | {"num_distractors": cell.distractors}
        return Header(HUMAN_FORMAT, self.graph, self.graph_hash, self.split_hash, settings, self.seed + cell.form)

    @property
    def tasks(self) -> int:
        """Tasks of each part."""
        return int(self.settings["tasks_per_part"])


class Study:
    """The tasks of a study, posed when they are first needed; its cells are in the order of assignment."""

    def __init__(self, graph: GraphLike, config: StudyConfig):
        """Prepare the tasks.

        Raises:
            ConfigError: for a setting out of range.
            TaskError: if a part of the split has no task.
        """
        first = HumanProtocol(graph, config.distractors[0], config.seed, tasks=config.tasks)
        self._of_condition = {
            amount: HumanProtocol(first.world, amount, config.seed, tasks=config.tasks) for amount in config.distractors
        }
        header = first.header
        self.record = StudyRecord(
            format="wordcraft-kg study 1",
            graph=header.graph,
            graph_hash=header.graph_hash,
            split_hash=header.split_hash,
            settings={name: value for name, value in header.settings.items() if name != "num_distractors"},
            distractors=config.distractors,
            seed=config.seed,
            forms=config.forms,
            consent=config.consent,
            created=datetime.now(UTC).isoformat(timespec="seconds"),
        )
        # Conditions alternate before forms do: a study compares conditions.
        self.cells = tuple(Cell(form, amount) for form in range(config.forms) for amount in config.distractors)
        self._posed: dict[Cell, tuple[PosedTask, ...]] = {}
        self._lock = threading.Lock()

    def tasks(self, cell: Cell) -> tuple[PosedTask, ...]:
        """Return the tasks of a form and condition, in their order; safe to be called from several threads."""
        with self._lock:
            if cell not in self._posed:
                protocol = self.protocol(cell)
                self._posed[cell] = tuple(protocol.task(*turn) for turn in protocol.turns)
            return self._posed[cell]

    def protocol(self, cell: Cell) -> HumanProtocol:
        """Return the protocol of a form and condition; those of a condition share their environments."""
        return self._of_condition[cell.distractors].with_seed(self.record.seed + cell.form)


# --- its folder ------------------------------------------------------------------------------------------------------


@contextmanager
def kept_answers(folder: Path, study: Study) -> Iterator[AnswersDatabase]:
    """Yield the answers of a study in a folder, new or begun, for one server alone.

    Raises:
        ArtefactError: if another server has it, or its files are damaged or of tasks that this version poses otherwise.
        GraphMismatchError, ConfigError, OutputExistsError: see :func:`check_study_folder`; the folder is unchanged in
            all cases.
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
    """Refuse to go on if this version of the package poses other tasks than the answered ones."""
    found = read_study(folder)
    for person in found.people:
        for stored, task in zip(found.answers[person.number], study.tasks(person.cell), strict=False):
            if not task.is_of(stored.answer):
                raise ArtefactError(
                    f"'{folder}': this version poses another {task.part} task {task.number} than person "
                    f"{person.number} has answered. Nothing was changed; go on with the version that it was begun with."
                )


def check_study_folder(folder: Path, record: StudyRecord) -> bool:
    """Return whether a folder holds this very study already; False if it can be begun there.

    Raises:
        ArtefactError: if ``study.json`` is damaged.
        GraphMismatchError: if the folder's study is of another graph or split.
        ConfigError: if it has other settings.
        OutputExistsError: if something else is there.
    """
    if not os.path.lexists(folder) or (folder.is_dir() and not any(folder.iterdir())):
        return False
    if not (folder / STUDY_FILE).exists():
        raise OutputExistsError(
            f"'{folder}' {what_is(folder)}; expected the folder of this study, or a new one. Choose another `out`."
        )
    found, _ = read_study_record(folder)
    have, want = (_flat(study) for study in (found, record))
    where = f"'{folder}' is a study"
    for name in {**have, **want}:
        one, other = have.get(name), want.get(name)
        if one == other:
            continue
        if name == "consent":
            raise ConfigError(f"{where} whose people agreed to another text. Nothing was changed; give that text.")
        if name.endswith("_hash"):
            what, names = name.removesuffix("_hash"), f" ({found.graph})" if name == "graph_hash" else ""
            raise GraphMismatchError(
                f"{where} of the {what} {str(one)[:12]}{names}, but this command has {str(other)[:12]}. "
                "Nothing was changed."
            )
        is_, should = (", ".join(map(str, value)) if isinstance(value, list) else value for value in (one, other))
        raise ConfigError(f"{where} with {name} {is_}, but this command has {should}. Nothing was changed.")
    return True


def _flat(record: StudyRecord) -> dict[str, Any]:
    """Return the values by which two studies can differ."""
    values = as_values(record) | record.settings
    return {name: value for name, value in values.items() if name not in ("created", "graph", "settings")}


def write_study_record(folder: Path, record: StudyRecord) -> None:
    """Write ``study.json`` into a new or empty folder."""
    folder.mkdir(parents=True, exist_ok=True)
    write_atomically(folder / STUDY_FILE, dump_json(as_values(record)), durable=True)


def read_study_record(folder: Path) -> tuple[StudyRecord, str]:
    """Return ``study.json`` and its SHA-256, which the answers name.

    Raises:
        ArtefactError: if it is missing or damaged.
    """
    path = folder / STUDY_FILE
    if not path.exists():
        raise ArtefactError(f"'{folder}' {what_is(folder)}; expected the folder that `people serve` writes.")
    data = read_small_file(path)
    record = parse_record(data, StudyRecord, path)
    check_number(record.settings, "tasks_per_part", 1, MOST_TASKS, str(path))
    return record, hashlib.sha256(data).hexdigest()


@dataclass(frozen=True)
class ReadStudy:
    """A study as it is on the disk: the people in the order in which they began, and their answers by their numbers."""

    record: StudyRecord
    people: tuple[Participant, ...]
    answers: dict[int, tuple[StoredAnswer, ...]]

    def sessions(self) -> tuple[Session, ...]:
        """Return the answers of each person, as the file of a session would hold them."""
        return tuple(
            Session(self.record.header(person.cell), tuple(stored.answer for stored in self.answers[person.number]))
            for person in self.people
        )

    def lines(self) -> Iterator[dict[str, Any]]:
        """Yield the answers for an export: the person, the :class:`~wordcraft_kg.apps.people.protocol.Answer`, loads.

        The person is known by ``session``, a number from 1 in the order in which people began; ``form`` and
        ``distractors`` are the assigned cell, ``seed`` that of the form, ``loads`` the number of loads of the page.
        """
        for person in self.people:
            who = {"session": person.number, "form": person.cell.form, "distractors": person.cell.distractors}
            who["seed"] = self.record.seed + person.cell.form
            for stored in self.answers[person.number]:
                yield who | as_values(stored.answer) | {"loads": stored.loads}


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
        if order != turns[: len(order)] or not all(one.answer.is_sound and one.loads >= 1 for one in given):
            raise ArtefactError(f"{path} is damaged: the answers of person {number} are not as they are stored.")
    if set(answers) != {person.number for person in people}:
        raise ArtefactError(f"{path} is damaged: it has answers of somebody who has not begun.")
    if unknown := {person.cell.distractors for person in people} - set(record.distractors):
        raise ArtefactError(f"{path} is damaged: {unknown.pop()} distractors are no condition of this study.")
    return ReadStudy(record, tuple(people), {number: tuple(given) for number, given in answers.items()})
