"""The database of a study's answers: each is on the disk before the person sees the next page.

SQLite in write-ahead mode with full synchronisation: what was committed survives a killed process and a power failure.
The primary keys are what keeps a form that is sent twice from becoming two answers.
"""

import json
import os
import sqlite3
import threading
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from wordcraft_kg.apps.people.protocol import Answer
from wordcraft_kg.base.artefacts import check_file
from wordcraft_kg.base.errors import ArtefactError
from wordcraft_kg.base.records import as_record

ANSWERS_FILE = "answers.sqlite"
APPLICATION = 0x57434B47
"""Marks the file as ours: "WCKG"."""
VERSION = 1
TABLES = (
    "CREATE TABLE study (record TEXT PRIMARY KEY) STRICT",
    "CREATE TABLE sessions (number INTEGER PRIMARY KEY, code TEXT NOT NULL UNIQUE, form INTEGER NOT NULL, "
    "distractors INTEGER NOT NULL) STRICT",
    # Of the task before a person only: the time of an answer is private.
    "CREATE TABLE showings (session INTEGER NOT NULL REFERENCES sessions, part TEXT NOT NULL, number INTEGER NOT NULL, "
    "shown REAL NOT NULL, loads INTEGER NOT NULL, PRIMARY KEY (session, part, number)) STRICT",
    "CREATE TABLE answers (session INTEGER NOT NULL REFERENCES sessions, part TEXT NOT NULL, number INTEGER NOT NULL, "
    "goal TEXT NOT NULL, slots TEXT NOT NULL, picks TEXT NOT NULL, made TEXT NOT NULL, success INTEGER NOT NULL, "
    "seconds REAL NOT NULL, loads INTEGER NOT NULL, PRIMARY KEY (session, part, number)) STRICT",
)
COUNTS = """
SELECT s.form, s.distractors, COUNT(*), SUM(COALESCE(a.answered, 0) >= ?)
FROM sessions AS s LEFT JOIN (SELECT session, COUNT(*) AS answered FROM answers GROUP BY session) AS a
ON a.session = s.number WHERE s.code NOT LIKE 'withdrawn %' GROUP BY s.form, s.distractors
"""
BUSY = 10
"""Seconds to wait for a reader of a copy."""


@dataclass(frozen=True, order=True)
class Cell:
    """The assignment of a person: the number of the draw of tasks, from 0, and the condition."""

    form: int
    distractors: int


@dataclass(frozen=True)
class Participant:
    """A person of a study; the number is from 1, in the order in which people began."""

    number: int
    cell: Cell


@dataclass(frozen=True)
class StoredAnswer:
    """An answer with the number of its person and of the loads of its page."""

    session: int
    answer: Answer
    loads: int


@dataclass(frozen=True)
class Stored:
    """The numbers of people who have begun, of those who have finished, and of answers."""

    people: int
    finished: int
    answers: int


class AnswersDatabase:
    """The answers of a study, for its server; safe to be called from several threads."""

    def __init__(self, connection: sqlite3.Connection, turns: int):
        """Take a connection to a sound database; ``turns`` is the number of tasks of a person."""
        self._connection, self._turns = connection, turns
        self._lock = threading.Lock()

    @classmethod
    def open(cls, path: Path, study: str, turns: int) -> "AnswersDatabase":
        """Open the database of a study, or make it.

        Args:
            path: the file.
            study: hash of the study's record.
            turns: number of tasks of a person.

        Raises:
            ArtefactError: if the file is damaged, something else, or of another study; it is unchanged then.
        """
        if not path.exists():
            _make(path, study)
        with reading(path, study):
            pass
        connection = sqlite3.connect(path, timeout=BUSY, isolation_level=None, check_same_thread=False)
        try:
            connection.execute("PRAGMA journal_mode = WAL")
            connection.execute("PRAGMA synchronous = FULL")
            connection.execute("PRAGMA foreign_keys = ON")
            connection.execute("PRAGMA secure_delete = ON")  # withdrawn answers are overwritten
        except sqlite3.Error as error:
            connection.close()
            raise _damaged(path, error) from None
        return cls(connection, turns)

    @contextmanager
    def _writing(self) -> Iterator[sqlite3.Connection]:
        with self._lock:
            self._connection.execute("BEGIN IMMEDIATE")
            try:
                yield self._connection
                self._connection.execute("COMMIT")
            except BaseException:
                if self._connection.in_transaction:  # a full disk has ended it already
                    self._connection.execute("ROLLBACK")
                raise

    def begin(self, code: str, cells: Sequence[Cell]) -> Participant:
        """Begin a session, in the cell with the fewest begun, then finished sessions, then the first one.

        A code that has begun already keeps its session, so that a form that is sent twice begins one.

        Args:
            code: hash of the person's code.
            cells: forms and conditions, in the order of preference.
        """
        with self._writing() as connection:
            if (known := _find(connection, code)) is not None:
                return known
            counts = {
                Cell(form, distractors): (begun, finished)
                for form, distractors, begun, finished in connection.execute(COUNTS, (self._turns,))
            }
            cell = min(cells, key=lambda cell: counts.get(cell, (0, 0)))
            cursor = connection.execute(
                "INSERT INTO sessions (code, form, distractors) VALUES (?, ?, ?)", (code, cell.form, cell.distractors)
            )
            assert cursor.lastrowid is not None
            return Participant(cursor.lastrowid, cell)

    def find(self, code: str) -> Participant | None:
        """Return the person with this hash of a code, None if there is none."""
        with self._lock:
            return _find(self._connection, code)

    def answers_of(self, person: Participant) -> list[Answer]:
        """Return a person's answers in their order."""
        with self._lock:
            query = f"{_ANSWERS} WHERE session = ? ORDER BY part DESC, number"
            return [_answer(row).answer for row in self._connection.execute(query, (person.number,))]

    def show(self, person: Participant, part: str, number: int, now: float) -> None:
        """Record the loading of a task without an answer: the time of the first, and the number of all."""
        key = (person.number, part, number)
        with self._writing() as connection:
            if connection.execute(f"SELECT 1 FROM answers WHERE {_KEY}", key).fetchone() is None:
                connection.execute(
                    "INSERT INTO showings VALUES (?, ?, ?, ?, 1) ON CONFLICT DO UPDATE SET loads = loads + 1",
                    (*key, now),
                )

    def shown(self, person: Participant, part: str, number: int) -> float | None:
        """Return the time when a task was first shown; None if it was not, or has been answered."""
        key = (person.number, part, number)
        with self._lock:
            row = self._connection.execute(f"SELECT shown FROM showings WHERE {_KEY}", key).fetchone()
        return None if row is None else float(row[0])

    def add(self, person: Participant, answer: Answer) -> bool:
        """Store an answer to a task that was shown; return False without a change if there is one already."""
        key = (person.number, answer.part, answer.number)
        lists = (json.dumps(value, ensure_ascii=False) for value in (answer.table, answer.picks, answer.made))
        with self._writing() as connection:
            row = connection.execute(f"SELECT loads FROM showings WHERE {_KEY}", key).fetchone()
            if row is None:
                return False
            connection.execute(
                "INSERT INTO answers VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?)",
                (*key, answer.goal, *lists, int(answer.success), answer.seconds, row[0]),
            )
            connection.execute(f"DELETE FROM showings WHERE {_KEY}", key)
            return True

    def withdraw(self, person: Participant) -> None:
        """Remove a person's answers and the way to their session; its number is not given away again."""
        with self._writing() as connection:
            for table in ("answers", "showings"):
                connection.execute(f"DELETE FROM {table} WHERE session = ?", (person.number,))
            connection.execute("UPDATE sessions SET code = 'withdrawn ' || number WHERE number = ?", (person.number,))

    def stored(self) -> Stored:
        """Return the numbers of people and answers."""
        with self._lock:
            counts = self._connection.execute(COUNTS, (self._turns,)).fetchall()
            (answers,) = self._connection.execute("SELECT COUNT(*) FROM answers").fetchone()
        return Stored(sum(row[2] for row in counts), sum(row[3] for row in counts), answers)

    def close(self) -> None:
        """Close the file, which is then the only one."""
        with self._lock:
            self._connection.close()


_KEY = "session = ? AND part = ? AND number = ?"
_PEOPLE = "SELECT number, form, distractors FROM sessions WHERE code NOT LIKE 'withdrawn %'"
_ANSWERS = "SELECT session, part, number, goal, slots, picks, made, success, seconds, loads FROM answers"


def read_answers(path: Path, study: str) -> tuple[list[Participant], list[StoredAnswer]]:
    """Return the people of a study and their answers, in order; nothing is written, and its server may be running.

    Raises:
        ArtefactError: if the file is damaged, something else, or of another study.
    """
    with reading(path, study) as connection:
        rows = connection.execute(f"{_PEOPLE} ORDER BY number").fetchall()
        people = [Participant(number, Cell(form, distractors)) for number, form, distractors in rows]
        found = connection.execute(f"{_ANSWERS} ORDER BY session, part DESC, number").fetchall()
        try:
            return people, [_answer(row, path) for row in found]
        except (ValueError, TypeError, RecursionError) as error:
            raise _damaged(path, error) from None


@contextmanager
def reading(path: Path, study: str) -> Iterator[sqlite3.Connection]:
    """Open the database of a study for reading, after checking that it is sound.

    Raises:
        ArtefactError: if it is damaged, something else, or of another study.
    """
    check_file(path)
    # A log beside it counts; without one nobody writes, and not even a lock is needed.
    mode = "mode=ro" if path.with_name(f"{path.name}-wal").exists() else "immutable=1"
    try:
        with closing(sqlite3.connect(f"{path.resolve().as_uri()}?{mode}", uri=True, timeout=BUSY)) as connection:
            connection.execute("BEGIN")
            kind = [connection.execute(f"PRAGMA {name}").fetchone()[0] for name in ("application_id", "user_version")]
            if kind != [APPLICATION, VERSION]:
                raise ArtefactError(f"{path} is not a database of answers of this version. Nothing was changed.")
            # Other contents of a foreign file, such as views and triggers, would run as soon as it is queried.
            found = connection.execute("SELECT sql FROM sqlite_schema WHERE sql IS NOT NULL").fetchall()
            if sorted(found) != sorted((table,) for table in TABLES):
                raise _damaged(path, "its tables are not those of a study")
            if (found := connection.execute("PRAGMA quick_check(1)").fetchone()[0]) != "ok":
                raise _damaged(path, found)
            if connection.execute("SELECT record FROM study").fetchall() != [(study,)]:
                raise ArtefactError(
                    f"{path} belongs to another study than the study.json beside it, or that was changed. "
                    "Nothing was changed; restore a copy."
                )
            yield connection
    except sqlite3.Error as error:
        raise _damaged(path, error) from None


def _make(path: Path, study: str) -> None:
    """Make the database under another name first, so that it is whole or not there."""
    new = path.with_name(f".{path.name}.new")
    new.unlink(missing_ok=True)
    try:
        with closing(sqlite3.connect(new, isolation_level=None)) as connection:
            connection.execute("BEGIN IMMEDIATE")
            for table in TABLES:
                connection.execute(table)
            connection.execute("INSERT INTO study VALUES (?)", (study,))
            connection.execute(f"PRAGMA application_id = {APPLICATION}")
            connection.execute(f"PRAGMA user_version = {VERSION}")
            connection.execute("COMMIT")
        os.replace(new, path)
    finally:
        new.unlink(missing_ok=True)
    if os.name == "posix":  # the new name is on the disk too
        folder = os.open(path.parent, os.O_RDONLY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)


def _find(connection: sqlite3.Connection, code: str) -> Participant | None:
    row = connection.execute("SELECT number, form, distractors FROM sessions WHERE code = ?", (code,)).fetchone()
    return None if row is None else Participant(row[0], Cell(row[1], row[2]))


def _answer(row: Sequence[Any], path: Path | str = ANSWERS_FILE) -> StoredAnswer:
    session, part, number, goal, *lists, success, seconds, loads = row
    values = (part, number, goal, *map(json.loads, lists), bool(success), seconds)
    found = as_record(dict(zip(Answer.__struct_fields__, values, strict=True)), Answer, path)
    return StoredAnswer(session, found, loads)


def _damaged(path: Path, error: object) -> ArtefactError:
    return ArtefactError(f"{path} is damaged: {error}. Nothing was changed; restore a copy.")
