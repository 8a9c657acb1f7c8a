"""Session files: a header and one line per answer, on disk before the next task."""

import logging
import os
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from wordcraft_kg.apps.people.config import MOST_TASKS
from wordcraft_kg.apps.people.protocol import HUMAN_FORMAT, Answer, Header, HumanProtocol, schedule
from wordcraft_kg.base.artefacts import read_small_file, write_atomically
from wordcraft_kg.base.errors import ArtefactError, ConfigError, GraphMismatchError
from wordcraft_kg.base.records import Record, as_lines, as_values, parse_record
from wordcraft_kg.base.settings import MAX_SIZE

TableKey = tuple[int, int, str, int]
"""Distractor count, seed, part, task number."""


@dataclass(frozen=True)
class Session:
    """One participant's answers in task order, and the length of a torn last line in the file, in bytes."""

    header: Header
    answers: tuple[Answer, ...]
    torn: int = 0

    @property
    def tasks(self) -> int:
        """Number of tasks per part."""
        return int(self.header.settings["tasks_per_part"])

    @property
    def distractors(self) -> int:
        """Distractors per table."""
        return int(self.header.settings["num_distractors"])

    @property
    def is_finished(self) -> bool:
        """Whether all tasks are answered."""
        return len(self.answers) == len(schedule(self.tasks))

    def table_of(self, answer: Answer) -> TableKey:
        """Return distractor count, seed, part and task number, which determine an answer's table."""
        return self.distractors, self.header.seed, answer.part, answer.number


def open_session(path: Path, protocol: HumanProtocol) -> Session:
    """Create or read a session file; a torn last line is dropped.

    Raises:
        ArtefactError: for other or damaged files, and for tasks outside the protocol.
        GraphMismatchError: for another graph or split.
        ConfigError: for different settings. The file is unchanged in all cases.
    """
    if not path.exists():
        path.parent.mkdir(parents=True, exist_ok=True)
        write_atomically(path, as_lines([protocol.header])[0])
        return Session(protocol.header, ())
    session = read_session(path)
    check_alike(path, session.header, "this command", protocol.header)
    for line, answer in enumerate(session.answers, start=2):
        if not protocol.task(answer.part, answer.number).is_of(answer):
            raise ArtefactError(f"{path}, line {line}: this version poses another task. Nothing was changed.")
    drop_torn_line(path, session.torn)
    return replace(session, torn=0)


def append_answer(path: Path, session: Session, answer: Answer) -> Session:
    """Add an answer to a session and its file."""
    append_record(path, answer)
    return replace(session, answers=(*session.answers, answer))


def append_record(path: Path, record: Record) -> None:
    """Append a line to a file; the line is on disk on return."""
    with path.open("ab") as file:
        file.write(as_lines([record])[0].encode())
        file.flush()
        os.fsync(file.fileno())


def drop_torn_line(path: Path, torn: int) -> None:
    """Cut ``torn`` bytes from the end, with a warning."""
    if torn:
        logging.getLogger(__name__).warning("%s ended in a torn line, which was dropped.", path)
        os.truncate(path, path.stat().st_size - torn)


def read_session(path: Path) -> Session:
    """Read one participant's answers, written by ``play --protocol paper``.

    Raises:
        ArtefactError: for other or damaged files, with the line number; a torn last line is allowed.
    """
    if not path.is_file():
        fault = "is not a file" if path.exists() else "does not exist"
        raise ArtefactError(f"'{path}' {fault}; expected a session file (`wordcraft-kg play --protocol paper`).")
    first, *lines = read_small_file(path).split(b"\n")
    if HUMAN_FORMAT.encode() not in first or not lines:
        raise ArtefactError(f"'{path}' is not a session file of this version ({HUMAN_FORMAT}). Nothing was changed.")
    header = parse_record(first, Header, f"{path}, line 1")
    for name, least, most in (("tasks_per_part", 1, MOST_TASKS), ("num_distractors", 0, MAX_SIZE)):
        check_number(header.settings, name, least, most, f"{path}, line 1")
    turns = schedule(int(header.settings["tasks_per_part"]))
    *lines, rest = lines
    if len(lines) > len(turns):
        raise ArtefactError(f"{path} is damaged: it has {len(lines)} answers, but a session has {len(turns)}.")
    answers = []
    for line, (text, (part, number)) in enumerate(zip(lines, turns, strict=False), start=2):
        answer = parse_record(text, Answer, f"{path}, line {line}")
        if not answer.is_sound or (answer.part, answer.number) != (part, number):
            raise ArtefactError(f"{path}, line {line} is damaged: expected an answer to {part} task {number}.")
        answers.append(answer)
    return Session(header, tuple(answers), len(rest))


def check_number(settings: dict[str, int | str], name: str, least: int, most: int, where: str) -> None:
    """Check that a recorded setting is a whole number in the range."""
    value = settings.get(name)
    if not isinstance(value, int) or not least <= value <= most:
        raise ArtefactError(f"{where} is damaged: '{name}' is not a whole number, {least} to {most:,}.")


def check_alike(path: Path, header: Header, other: str, reference: Header) -> None:
    """Check that a header equals the reference, with the errors of :func:`check_equal`."""
    have, want = (as_values(entry) | entry.settings for entry in (header, reference))
    del have["settings"], want["settings"]
    check_equal(f"'{path}' has", have, f"{other} has", want)


def check_equal(subject: str, have: Mapping[str, object], other: str, want: Mapping[str, object]) -> None:
    """Check that the settings ``have`` equal ``want``, except for the graph name; ``subject`` and ``other`` name both.

    Raises:
        GraphMismatchError: if a hash differs.
        ConfigError: if another setting differs.
    """
    for name in {**want, **have}:
        if name != "graph" and have.get(name) != want.get(name):
            is_hash = name.endswith("_hash")
            kind = GraphMismatchError if is_hash else ConfigError
            is_, should = (str(values.get(name))[: 12 if is_hash else None] for values in (have, want))
            graph = f" (graph {have['graph']})" if name == "graph_hash" else ""
            raise kind(f"{subject} {name} {is_}{graph}, but {other} {should}. Nothing was changed.")
