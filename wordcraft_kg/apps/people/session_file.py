"""The file of one person's answers: a header and a line for each answer, each on disk before the next task."""

import json
import logging
import math
import os
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import Any

from wordcraft_kg.apps.people.config import MOST_TASKS
from wordcraft_kg.apps.people.protocol import HUMAN_FORMAT, Answer, HumanProtocol, schedule
from wordcraft_kg.base.artefacts import read_small_file, write_atomically
from wordcraft_kg.base.errors import ArtefactError, ConfigError, GraphMismatchError
from wordcraft_kg.base.settings import MAX_SIZE

TableKey = tuple[int, int, str, int]
"""What a table follows from, beside graph and split: number of distractors, seed, part, number of the task."""


@dataclass(frozen=True)
class Session:
    """What one person answered.

    Attributes:
        header: see :class:`HumanProtocol`.
        answers: the answers so far, in the order of the protocol.
        torn: number of bytes after the last whole line, which a crash left.
    """

    header: dict[str, Any]
    answers: tuple[Answer, ...]
    torn: int = 0

    @property
    def seed(self) -> int:
        """Seed of tasks and tables."""
        return int(self.header["seed"])

    @property
    def tasks(self) -> int:
        """Number of tasks of each part."""
        return int(self.header["settings"]["tasks_per_part"])

    @property
    def distractors(self) -> int:
        """Number of distractors on each table."""
        return int(self.header["settings"]["num_distractors"])

    @property
    def is_finished(self) -> bool:
        """Whether all tasks are answered."""
        return len(self.answers) == len(schedule(self.tasks))

    def table_of(self, answer: Answer) -> TableKey:
        """Return at which table an answer was given."""
        return self.distractors, self.seed, answer.part, answer.number


def open_session(path: Path, protocol: HumanProtocol) -> Session:
    """Begin a session's file, or read the existing one to continue it; a torn last line is dropped.

    Raises:
        ArtefactError: if the file is not of this kind, is damaged, or has other tasks than the protocol.
        GraphMismatchError: if it belongs to another graph or split.
        ConfigError: if it was begun with other settings. The file is unchanged in all these cases.
    """
    if not path.exists():
        path.parent.mkdir(parents=True, exist_ok=True)
        write_atomically(path, _line(protocol.header))
        return Session(protocol.header, ())
    session = read_session(path)
    check_alike(path, session.header, "this command", protocol.header)
    for line, answer in enumerate(session.answers, start=2):
        task = protocol.task(answer.part, answer.number)
        if (answer.goal, answer.table) != (task.goal, task.table):
            raise ArtefactError(f"{path}, line {line}: this version poses another task there. Nothing was changed.")
    if session.torn:
        logging.getLogger(__name__).warning("%s ended in a torn line, which was dropped; its task is asked again", path)
        os.truncate(path, path.stat().st_size - session.torn)
    return replace(session, torn=0)


def append_answer(path: Path, session: Session, answer: Answer) -> Session:
    """Add an answer to a session and its file; it is on disk when this returns."""
    with path.open("ab") as file:
        file.write(_line(asdict(answer)).encode())
        file.flush()
        os.fsync(file.fileno())
    return replace(session, answers=(*session.answers, answer))


def read_session(path: Path) -> Session:
    """Read a session's file.

    Raises:
        ArtefactError: naming the line, if the file is not of this kind or damaged; a torn last line is not an error.
    """
    if not path.is_file():
        raise ArtefactError(f"'{path}' is not a file; expected one that `wordcraft-kg play --protocol paper` wrote.")
    *lines, rest = read_small_file(path).split(b"\n")
    header = _json(lines[0]) if lines else None
    if not isinstance(header, dict) or header.get("format") != HUMAN_FORMAT:
        raise ArtefactError(
            f"'{path}' is not a file of the human protocol of this version ({HUMAN_FORMAT}). Nothing was changed."
        )
    kinds = {"graph": str, "graph_hash": str, "split_hash": str, "settings": dict, "seed": int}
    wrong = [name for name, kind in kinds.items() if not isinstance(header.get(name), kind)]
    if wrong:
        raise ArtefactError(f"{path}, line 1 is damaged: '{wrong[0]}' is missing or has another type.")
    for name, least, most in (("tasks_per_part", 1, MOST_TASKS), ("num_distractors", 0, MAX_SIZE)):
        value = header["settings"].get(name)
        if type(value) is not int or not least <= value <= most:
            raise ArtefactError(f"{path}, line 1 is damaged: '{name}' is not a whole number, {least} to {most:,}.")
    turns = schedule(header["settings"]["tasks_per_part"])
    if len(lines) - 1 > len(turns):
        raise ArtefactError(f"{path} is damaged: it has {len(lines) - 1} answers, but a session has {len(turns)}.")
    answers = []
    for line, (text, turn) in enumerate(zip(lines[1:], turns, strict=False), start=2):
        answer = _answer(_json(text))
        if answer is None or (answer.part, answer.number) != turn:
            raise ArtefactError(f"{path}, line {line} is damaged: it is not an answer to {turn[0]} task {turn[1]}.")
        answers.append(answer)
    return Session(header, tuple(answers), len(rest))


def _line(value: dict[str, Any]) -> str:
    return json.dumps(value, ensure_ascii=False, allow_nan=False) + "\n"


def _json(line: bytes) -> Any:
    try:
        return json.loads(line)
    except (ValueError, RecursionError):
        return None


_KINDS = dict(
    zip((entry.name for entry in fields(Answer)), (str, int, str, list, list, list, bool, float), strict=True)
)


def _answer(value: Any) -> Answer | None:
    """Return the answer that a line holds, or None if it is not one."""
    if not isinstance(value, dict) or {name: type(entry) for name, entry in value.items()} != _KINDS:
        return None
    lists = {name: tuple(entry) for name, entry in value.items() if isinstance(entry, list)}
    answer = Answer(**(value | lists))
    return answer if is_sound(answer) else None


def is_sound(answer: Answer) -> bool:
    """Return whether an answer's fields, which have the right types, agree with each other."""
    return (
        all(isinstance(label, str) for labels in (answer.table, answer.picks, answer.made) for label in labels)
        and len(answer.picks) == 2
        and set(answer.picks) <= set(answer.table)
        and answer.success == (answer.goal in answer.made)
        and 0 <= answer.seconds < math.inf
    )


def check_alike(path: Path, header: dict[str, Any], other: str, reference: dict[str, Any]) -> None:
    """Check that a header differs from the reference in nothing but the graph's name.

    Raises:
        GraphMismatchError: if the graph or split is another.
        ConfigError: naming the setting that is another.
    """
    have, want = ({**entry, **entry["settings"]} for entry in (header, reference))
    for name in want | have:
        if name in ("graph", "settings") or have.get(name) == want.get(name):
            continue
        kind = GraphMismatchError if name.endswith("_hash") else ConfigError
        is_, should = (str(entry.get(name))[:12] for entry in (have, want))
        raise kind(f"'{path}' has {name} {is_}, but {other} has {should}. Nothing was changed.")
