"""The answers database of a study: each answer is on disk before the next page.

SQLite in write-ahead mode with full synchronisation: commits survive a killed process and a power
failure."""

import json
import logging
import os
import shutil
import sqlite3
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from wordcraft_kg.apps.people.protocol import Answer
from wordcraft_kg.base.artefacts import check_file
from wordcraft_kg.base.errors import ArtefactError
from wordcraft_kg.base.records import as_record
from wordcraft_kg.runs.folder import locked

ANSWERS_FILE = "answers.sqlite"
APPLICATION = 0x57434B47
VERSION = 2
TABLES = (
    "CREATE TABLE study (record TEXT PRIMARY KEY) STRICT",
    "CREATE TABLE sessions (number INTEGER PRIMARY KEY, code TEXT NOT NULL UNIQUE, form INTEGER "
    "NOT NULL, "
    "distractors INTEGER NOT NULL) STRICT",
    # Only for unanswered tasks: answer times are private.
    "CREATE TABLE showings (session INTEGER NOT NULL REFERENCES sessions, part TEXT NOT NULL, "
    "number INTEGER NOT NULL, "
    "shown REAL NOT NULL, loads INTEGER NOT NULL, PRIMARY KEY (session, part, number)) STRICT",
    "CREATE TABLE answers (session INTEGER NOT NULL REFERENCES sessions, part TEXT NOT NULL, "
    "number INTEGER NOT NULL, "
    "goal TEXT NOT NULL, slots TEXT NOT NULL, actions TEXT NOT NULL, made TEXT NOT NULL, success "
    "INTEGER NOT NULL, "
    "seconds REAL NOT NULL, loads INTEGER NOT NULL, PRIMARY KEY (session, part, number)) STRICT",
)
COUNTS = """
SELECT s.form, s.distractors, COUNT(*), SUM(COALESCE(a.answered, 0) >= ?)
FROM sessions AS s LEFT JOIN (SELECT session, COUNT(*) AS answered FROM answers GROUP BY session) AS a
ON a.session = s.number WHERE s.code NOT LIKE 'withdrawn %' GROUP BY s.form, s.distractors
"""
BUSY = 10
_LOG = logging.getLogger(__name__)


@dataclass(frozen=True, order=True)
class Cell:
    """The assignment of a person: a form (sampled task list), numbered from 0, and the number of distractors."""

    form: int
    distractors: int


@dataclass(frozen=True)
class Participant:
    """A person in a study, numbered from 1 in starting order."""

    number: int
    cell: Cell


@dataclass(frozen=True)
class StoredAnswer:
    """An answer with the person number and the number of page loads."""

    session: int
    answer: Answer
    loads: int


@dataclass(frozen=True)
class Stored:
    """Counts for people, finished people, and answers."""

    people: int
    finished: int
    answers: int


class AnswersDatabase:
    """The answers of a study, for the server; thread-safe."""

    def __init__(self, path: Path, study: str, turns: int):
        """Open or create a study's database, with ``turns`` per person; other files are an ArtefactError."""
        if not path.exists():
            _make(path, study)
        with _reading(path, study):
            pass
        self._path, self._turns, self._lock = path, turns, threading.Lock()
        self._connection = sqlite3.connect(
            path, timeout=BUSY, isolation_level=None, check_same_thread=False
        )
        try:
            # Withdrawn answers are overwritten; writing the version again fails in a read-only
            # folder.
            settings = (
                "journal_mode = WAL",
                "synchronous = FULL",
                "foreign_keys = ON",
                "secure_delete = ON",
            )
            for pragma in (*settings, f"user_version = {VERSION}"):
                self._connection.execute(f"PRAGMA {pragma}")
        except sqlite3.Error as error:
            self.close()
            raise _failed(path, error) from None
        self._empty_log()

    @contextmanager
    def _writing(self) -> Iterator[sqlite3.Connection]:
        with self._lock:
            try:
                self._connection.execute("BEGIN IMMEDIATE")
                yield self._connection
                self._connection.execute("COMMIT")
            except sqlite3.Error as error:
                raise _failed(self._path, error) from None
            finally:
                if self._connection.in_transaction:  # a full disk ends the transaction
                    self._connection.execute("ROLLBACK")

    def _empty_log(self) -> None:
        with self._lock, suppress(sqlite3.Error):
            if not self._connection.execute("PRAGMA wal_checkpoint(TRUNCATE)").fetchone()[0]:
                return
        _LOG.warning(
            "%s-wal keeps withdrawn answers until the server stops or starts again.", self._path
        )

    def begin(self, code: str, cells: Sequence[Cell]) -> Participant:
        """Start, or return by a code's hash, a session in the cell with the fewest sessions, then finished ones."""
        with self._writing() as connection:
            if (known := _find(connection, code)) is not None:
                return known
            counts = {
                Cell(form, distractors): (begun, finished)
                for form, distractors, begun, finished in connection.execute(COUNTS, (self._turns,))
            }
            cell = min(cells, key=lambda cell: counts.get(cell, (0, 0)))
            cursor = connection.execute(
                "INSERT INTO sessions (code, form, distractors) VALUES (?, ?, ?)",
                (code, cell.form, cell.distractors),
            )
            assert cursor.lastrowid is not None
            return Participant(cursor.lastrowid, cell)

    def find(self, code: str) -> Participant | None:
        """Return the person for a code hash, or None."""
        with self._lock:
            return _find(self._connection, code)

    def answers_of(self, person: Participant) -> list[Answer]:
        """Return the answers of a person in order."""
        with self._lock:
            query = f"{_ANSWERS} WHERE session = ? ORDER BY part DESC, number"
            return [
                _answer(row).answer for row in self._connection.execute(query, (person.number,))
            ]

    def show(self, person: Participant, part: str, number: int, now: float) -> None:
        """Record a page load for an unanswered task: the time of the first load, and the load count."""
        key = (person.number, part, number)
        with self._writing() as connection:
            if connection.execute(f"SELECT 1 FROM answers WHERE {_KEY}", key).fetchone() is None:
                connection.execute(
                    "INSERT INTO showings VALUES (?, ?, ?, ?, 1) ON CONFLICT DO UPDATE SET loads "
                    "= loads + 1",
                    (*key, now),
                )

    def shown(self, person: Participant, part: str, number: int) -> float | None:
        """Return the time of the first page load for an unanswered task; None for other tasks."""
        key = (person.number, part, number)
        with self._lock:
            row = self._connection.execute(
                f"SELECT shown FROM showings WHERE {_KEY}", key
            ).fetchone()
        return None if row is None else float(row[0])

    def add(self, person: Participant, answer: Answer) -> bool:
        """Store the answer to a shown task; return False for other tasks."""
        key = (person.number, answer.part, answer.number)
        lists = (
            json.dumps(value, ensure_ascii=False)
            for value in (answer.table, answer.actions, answer.made)
        )
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
        """Remove the answers and the code of a person; the session number is not used again."""
        with self._writing() as connection:
            for table in ("answers", "showings"):
                connection.execute(f"DELETE FROM {table} WHERE session = ?", (person.number,))
            connection.execute(
                "UPDATE sessions SET code = 'withdrawn ' || number WHERE number = ?",
                (person.number,),
            )
        self._empty_log()

    def stored(self) -> Stored:
        """Return counts for people and answers."""
        with self._lock:
            counts = self._connection.execute(COUNTS, (self._turns,)).fetchall()
            (answers,) = self._connection.execute("SELECT COUNT(*) FROM answers").fetchone()
        return Stored(sum(row[2] for row in counts), sum(row[3] for row in counts), answers)

    def close(self) -> None:
        """Close the database file; SQLite then removes the write-ahead log."""
        with self._lock:
            self._connection.close()


_KEY = "session = ? AND part = ? AND number = ?"
_PEOPLE = "SELECT number, form, distractors FROM sessions WHERE code NOT LIKE 'withdrawn %'"
_ANSWERS = (
    "SELECT session, part, number, goal, slots, actions, made, success, seconds, loads FROM answers"
)


def read_answers(path: Path, study: str) -> tuple[list[Participant], list[StoredAnswer]]:
    """Return all people and answers in order; nothing is written. Damage or another study is an ArtefactError."""
    with _reading(path, study) as connection:
        rows = connection.execute(f"{_PEOPLE} ORDER BY number").fetchall()
        people = [
            Participant(number, Cell(form, distractors)) for number, form, distractors in rows
        ]
        rows = connection.execute(f"{_ANSWERS} ORDER BY session, part DESC, number").fetchall()
        try:
            return people, [_answer(row, path) for row in rows]
        except (ValueError, TypeError, RecursionError) as error:
            raise _damaged(path, error) from None


@contextmanager
def _reading(path: Path, study: str) -> Iterator[sqlite3.Connection]:
    check_file(path)
    try:
        with (
            _address(path) as address,
            closing(sqlite3.connect(address, uri=True, timeout=BUSY)) as connection,
        ):
            connection.execute("BEGIN")
            kind = [
                connection.execute(f"PRAGMA {name}").fetchone()[0]
                for name in ("application_id", "user_version")
            ]
            if kind != [APPLICATION, VERSION]:
                raise ArtefactError(
                    f"{path} is not an answers database of this version. Nothing was changed."
                )
            # Views and triggers in a foreign file would run on the first query.
            schema = connection.execute(
                "SELECT sql FROM sqlite_schema WHERE sql IS NOT NULL"
            ).fetchall()
            if sorted(schema) != sorted((table,) for table in TABLES):
                raise _damaged(path, "expected the tables of a study")
            if (problem := connection.execute("PRAGMA quick_check(1)").fetchone()[0]) != "ok":
                raise _damaged(path, problem)
            if connection.execute("SELECT record FROM study").fetchall() != [(study,)]:
                raise ArtefactError(
                    f"{path} belongs to another study than the study.json in its folder, or "
                    "study.json was changed. "
                    "Nothing was changed; restore a copy."
                )
            yield connection
    except sqlite3.Error as error:
        raise _failed(path, error) from None


@contextmanager
def _address(path: Path) -> Iterator[str]:
    """Yield the address for reading: after a kill a copy, because SQLite would write to the log."""
    address, log, index = (
        path.resolve().as_uri(),
        *(path.with_name(f"{path.name}-{end}") for end in ("wal", "shm")),
    )
    if not log.exists() and not index.exists():
        yield f"{address}?immutable=1"  # without a log there is no writer, so no lock is needed
    elif _is_served(path.parent):
        yield f"{address}?mode=ro"
    else:
        with TemporaryDirectory() as folder:
            copy = Path(shutil.copy(path, folder))
            entries, shared = (part.read_bytes() if part.exists() else b"" for part in (log, index))
            copy.with_name(log.name).write_bytes(entries)
            with closing(sqlite3.connect(copy)) as connection:
                read = connection.execute("PRAGMA wal_checkpoint").fetchone()[1]
            if read < (written := _pages(entries, shared)):
                lost = f"{written - max(read, 0)} of its {written} pages cannot be read, so answers may be missing"
                _LOG.warning(
                    "%s is damaged or ends in an unfinished answer: %s. Compare with a copy.",
                    log,
                    lost,
                )
            yield copy.as_uri()


def _is_served(folder: Path) -> bool:
    try:
        with locked(folder):
            return False
    except ArtefactError:
        return True


def _pages(log: bytes, index: bytes) -> int:
    """Return the number of pages that a write-ahead log should have (sqlite.org/walformat.html)."""
    size, salt = 24 + int.from_bytes(log[8:12], "big"), log[16:24]
    starts = range(32, len(log), size)
    # Pages from before the last checkpoint follow with another salt.
    is_current = [
        log[at + 8 : at + 16] in (salt, bytes(8)) or at + size > len(log) for at in starts
    ]
    recorded = max(
        (number for number, is_one in enumerate(is_current, 1) if is_one),
        default=len(log) not in (0, 32),
    )
    committed, saved = (int.from_bytes(index[at : at + 4], sys.byteorder) for at in (16, 96))
    return max(
        recorded, committed if committed > saved and (len(log) <= 32 or index[32:40] == salt) else 0
    )


def _make(path: Path, study: str) -> None:
    """Create the database under a temporary name first, so that no partial file appears."""
    new = path.with_name(f".{path.name}.new")
    try:
        new.unlink(missing_ok=True)
        with closing(sqlite3.connect(new, isolation_level=None)) as connection:
            connection.execute("BEGIN IMMEDIATE")
            for statement in (
                *TABLES,
                f"PRAGMA application_id = {APPLICATION}",
                f"PRAGMA user_version = {VERSION}",
            ):
                connection.execute(statement)
            connection.execute("INSERT INTO study VALUES (?)", (study,))
            connection.execute("COMMIT")
        os.replace(new, path)
    except sqlite3.Error as error:
        raise _failed(path, error) from None
    finally:
        new.unlink(missing_ok=True)
    if os.name == "posix":  # the new name is on disk, too
        folder = os.open(path.parent, os.O_RDONLY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)


def _find(connection: sqlite3.Connection, code: str) -> Participant | None:
    row = connection.execute(
        "SELECT number, form, distractors FROM sessions WHERE code = ?", (code,)
    ).fetchone()
    return None if row is None else Participant(row[0], Cell(row[1], row[2]))


def _answer(row: Sequence[Any], path: Path | str = ANSWERS_FILE) -> StoredAnswer:
    session, part, number, goal, *lists, success, seconds, loads = row
    values = (part, number, goal, *map(json.loads, lists), bool(success), seconds)
    return StoredAnswer(
        session,
        as_record(dict(zip(Answer.__struct_fields__, values, strict=True)), Answer, path),
        loads,
    )


def _failed(path: Path, error: sqlite3.Error) -> ArtefactError:
    if not isinstance(error, sqlite3.OperationalError):
        return _damaged(path, error)
    return ArtefactError(
        f"{path} cannot be read or written: {error}. Expected a writable folder with free space."
    )


def _damaged(path: Path, error: object) -> ArtefactError:
    return ArtefactError(f"{path} is damaged: {error}. Nothing was changed; restore a copy.")
