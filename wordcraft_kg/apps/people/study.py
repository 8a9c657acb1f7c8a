"""A study: several people take the protocol, in several forms and distractor conditions."""

import hashlib
import json
import os
from collections.abc import Iterator, Mapping
from contextlib import closing, contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.resources import files
from itertools import product
from pathlib import Path
from typing import Any, Literal

from wordcraft_kg.apps.people.answers_database import (
    ANSWERS_FILE,
    AnswersDatabase,
    Cell,
    Participant,
    read_answers,
)
from wordcraft_kg.apps.people.protocol import (
    Answer,
    HumanProtocol,
    PosedTask,
    schedule,
)
from wordcraft_kg.apps.people.study_config import MOST_TASKS, StudyConfig
from wordcraft_kg.base import (
    ArtefactError,
    ConfigError,
    Count,
    GraphMismatchError,
    Hash,
    OutputExistsError,
    Record,
    as_values,
    dump_json,
    output_target,
    parse_record,
    read_small_file,
    what_is,
    write_atomically,
)
from wordcraft_kg.graphs.graph_folder import GraphLike
from wordcraft_kg.runs.run_folder import locked_folder

STUDY_FILE = "study.json"


class StudyRecord(Record):
    """``study.json``: the identity of a study, with its texts.

    Answers belong to this record and to no other: the database repeats its hash.

    Attributes:
        format: kind and version of the file.
        graph: name of the graph.
        graph_hash: hash of the graph.
        split_hash: hash of the split.
        settings: settings of the tasks, by name, without the number of distractors.
        distractors: numbers of distractors on a table, the conditions.
        seed: seed of the first form; the others have the following seeds.
        forms: number of sampled task lists.
        consent: text that people agree to.
        texts_hash: SHA-256 of all page templates, since other texts may give other answers.
        created: time at which the study began, in UTC.
    """

    format: Literal["wordcraft-kg study 2"]
    graph: str
    graph_hash: Hash
    split_hash: Hash
    settings: dict[str, int | str]
    distractors: tuple[Count, ...]
    seed: Count
    forms: Count
    consent: str
    texts_hash: Hash
    created: str

    def __post_init__(self) -> None:
        tasks = self.settings.get("tasks_per_part")
        if not isinstance(tasks, int) or not 1 <= tasks <= MOST_TASKS:
            raise ValueError(f"'tasks_per_part' is not a whole number, 1 to {MOST_TASKS:,}")

    @property
    def tasks(self) -> int:
        """Number of tasks in each part."""
        return int(self.settings["tasks_per_part"])


def texts_hash() -> str:
    """Return the hash of all page templates, the text version of a study."""
    folder = files("wordcraft_kg.apps.people") / "templates"
    # Names and texts together: a text that moves to another page is another study.
    texts = {file.name: file.read_text(encoding="utf-8") for file in folder.iterdir()}
    return hashlib.sha256(json.dumps(texts, sort_keys=True).encode()).hexdigest()


class HumanStudy:
    """A study's tasks for each cell: a form (sampled task list) with a number of distractors.

    Attributes:
        record: identity of the study, as in ``study.json``.
        cells: all cells, in the order in which people are assigned to them.
    """

    def __init__(self, graph: GraphLike, config: StudyConfig):
        """Prepare the tasks.

        Raises:
            TaskError: if a part has no tasks.
            ConfigError: if the graph has too few entities for so many distractors.
            RecipeFileError: if there is no such graph, or a book cannot be read.
            ArtefactError: if a graph folder is damaged.
        """
        first = HumanProtocol(graph, config.distractors[0])
        # One world for all: the graph is the same, and a world takes long to make.
        self._protocols = {
            amount: HumanProtocol(first.world, amount) for amount in config.distractors
        }
        self.record = StudyRecord(
            format="wordcraft-kg study 2",
            graph=first.world.graph.name,
            graph_hash=first.world.graph.hash,
            split_hash=first.world.split.hash,
            settings={"tasks_per_part": config.tasks, **first.settings},
            distractors=config.distractors,
            seed=config.seed,
            forms=config.forms,
            consent=config.consent,
            texts_hash=texts_hash(),
            created=datetime.now(UTC).isoformat(timespec="seconds"),
        )
        # Conditions alternate before forms, since a study compares conditions.
        self.cells = tuple(
            Cell(form, amount) for form, amount in product(range(config.forms), config.distractors)
        )
        # Posed when first needed: a study may have a thousand forms, and few people.
        self._posed: dict[Cell, tuple[PosedTask, ...]] = {}

    def tasks(self, cell: Cell) -> tuple[PosedTask, ...]:
        """Return a cell's tasks, in order; thread-safe: those that two threads pose are equal."""
        if cell not in self._posed:
            self._posed[cell] = tuple(
                self.protocol(cell).task(self.record.seed + cell.form, *turn)
                for turn in schedule(self.record.tasks)
            )
        return self._posed[cell]

    def protocol(self, cell: Cell) -> HumanProtocol:
        """Return the protocol of a cell's number of distractors."""
        return self._protocols[cell.distractors]


@contextmanager
def kept_answers(folder: Path, study: HumanStudy) -> Iterator[AnswersDatabase]:
    """Yield the answers of a new or begun study folder, for one server.

    Raises:
        ArtefactError: if another server uses the folder, a file is damaged, or this version poses
            different tasks.
        GraphMismatchError, ConfigError, OutputExistsError: see :func:`check_study_folder`.
    """
    if check_study_folder(folder, study.record) and (folder / ANSWERS_FILE).exists():
        _check_tasks(folder, study)
    output_target(folder)  # refuses a link that leads nowhere
    with locked_folder(folder, "served"):
        # Once more under the lock: another server may have begun a study meanwhile.
        if not check_study_folder(folder, study.record):
            # Durable: answers after a power failure need the record that they belong to.
            write_atomically(folder / STUDY_FILE, dump_json(as_values(study.record)), durable=True)
        _, identity = read_study_record(folder)
        turns = len(schedule(study.record.tasks))
        with closing(AnswersDatabase(folder / ANSWERS_FILE, identity, turns)) as answers:
            yield answers


def _check_tasks(folder: Path, study: HumanStudy) -> None:
    """Check that this version poses the tasks that people have answered."""
    for session in read_study(folder):
        # People stop at any task, so there are fewer answers than tasks.
        for answer, task in zip(session.answers, study.tasks(session.person.cell), strict=False):
            if not task.is_of(answer):
                raise ArtefactError(
                    f"'{folder}': this version poses another {task.part} task {task.number} than "
                    f"person {session.person.number} answered. Nothing was changed; continue with "
                    "the version that began the study."
                )


def check_study_folder(folder: Path, record: StudyRecord) -> bool:
    """Return whether a folder holds this study; False for a new or empty folder.

    Raises:
        ArtefactError: if ``study.json`` is damaged.
        GraphMismatchError: if the folder's study is on another graph or split.
        ConfigError: if the folder's study has other settings or texts.
        OutputExistsError: if there is another folder or file.
    """
    is_empty = folder.is_dir() and not any(folder.iterdir())
    if is_empty or not os.path.lexists(folder):
        return False
    if not (folder / STUDY_FILE).exists():
        raise OutputExistsError(
            f"'{folder}' {what_is(folder)}; expected the folder of this study, or a new one. "
            "Choose another `out`."
        )
    begun, _ = read_study_record(folder)
    # The texts have errors of their own, since their values are too long to be shown.
    if begun.consent != record.consent:
        raise ConfigError(
            f"'{folder}': people agreed to another text. Nothing was changed; give that text."
        )
    if begun.texts_hash != record.texts_hash:
        raise ConfigError(
            f"'{folder}': the pages of this version have other texts than the pages that people "
            "have seen. Nothing was changed; continue with the version that began the study."
        )
    check_equal(
        f"'{folder}' is a study with", _identity(begun), "this command has", _identity(record)
    )
    return True


def check_equal(
    subject: str, have: Mapping[str, object], other: str, want: Mapping[str, object]
) -> None:
    """Check that two sets of settings are equal, apart from the name of the graph.

    Args:
        subject: begin of the error message, such as ``'study' has``.
        have: settings to check, by name.
        other: end of the error message, such as ``this command has``.
        want: expected settings, by name.

    Raises:
        GraphMismatchError: if a hash differs.
        ConfigError: if another setting differs.
    """
    for name in {**want, **have}:
        if name == "graph" or have.get(name) == want.get(name):
            continue
        value = str(have.get(name))
        expected = str(want.get(name))
        if name.endswith("_hash"):
            raise GraphMismatchError(
                f"{subject} {name} {value[:12]}, but {other} {expected[:12]}. Nothing was changed."
            )
        raise ConfigError(f"{subject} {name} {value}, but {other} {expected}. Nothing was changed.")


def _identity(record: StudyRecord) -> dict[str, Any]:
    """Return all settings by name; the time is no setting."""
    values = as_values(record) | record.settings
    return {name: values[name] for name in values if name not in ("created", "settings")}


def read_study_record(folder: Path) -> tuple[StudyRecord, str]:
    """Return ``study.json`` and the SHA-256, which the answers database repeats.

    Raises:
        ArtefactError: if the folder is missing or no study, or the file is damaged.
    """
    path = folder / STUDY_FILE
    if not path.exists():
        raise ArtefactError(
            f"'{folder}' {what_is(folder)}; expected the folder that `people serve` writes."
        )
    data = read_small_file(path)
    return parse_record(data, StudyRecord, path), hashlib.sha256(data).hexdigest()


TableKey = tuple[int, int, str, int]
"""Distractor count, seed, part, task number."""


@dataclass(frozen=True)
class Session:
    """One participant's answers.

    Attributes:
        record: the study.
        person: the participant, with form and condition.
        answers: answers so far, in task order.
    """

    record: StudyRecord
    person: Participant
    answers: tuple[Answer, ...]

    @property
    def seed(self) -> int:
        """Seed of the session's form."""
        return self.record.seed + self.person.cell.form

    @property
    def is_finished(self) -> bool:
        """Whether all tasks are answered."""
        return len(self.answers) == len(schedule(self.record.tasks))

    def table_of(self, answer: Answer) -> TableKey:
        """Return the key of an answer's table: the table follows from it, graph and split."""
        return self.person.cell.distractors, self.seed, answer.part, answer.number

    def lines(self) -> Iterator[dict[str, Any]]:
        """Yield exported answers: nothing about a person but number, form and condition.

        ``session`` is the person number, ``seed`` the seed of the form, and ``loads`` counts page
        loads: more than one after a reload or a return.
        """
        assignment = {
            "session": self.person.number,
            "form": self.person.cell.form,
            "distractors": self.person.cell.distractors,
            "seed": self.seed,
        }
        for answer in self.answers:
            yield assignment | as_values(answer)


def read_study(folder: Path) -> list[Session]:
    """Return the sessions in a study folder, in starting order, without withdrawn people.

    Nothing is written, and a server may be running.

    Raises:
        ArtefactError: if a file is missing or damaged, or the answers contradict each other.
    """
    record, identity = read_study_record(folder)
    path = folder / ANSWERS_FILE
    turns = schedule(record.tasks)
    sessions = []
    for person, answers in read_answers(path, identity).items():
        # The server poses tasks in order, so answers are the start of the schedule without a gap.
        order = tuple((answer.part, answer.number) for answer in answers)
        is_in_order = order == turns[: len(order)]
        if not (is_in_order and all(answer.is_sound for answer in answers)):
            raise ArtefactError(
                f"{path} is damaged: the answers of person {person.number} are inconsistent."
            )
        if person.cell.distractors not in record.distractors:
            raise ArtefactError(
                f"{path} is damaged: {person.cell.distractors} distractors are not a condition of "
                "this study."
            )
        sessions.append(Session(record, person, answers))
    return sessions
