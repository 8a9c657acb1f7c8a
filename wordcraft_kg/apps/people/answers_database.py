"""The answers database of a study: each answer is on disk before the next page.

SQLite in write-ahead mode with full synchronisation: commits survive a killed process and a power
failure.
"""

import json
import logging
import os
import sqlite3
import threading
from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from wordcraft_kg.apps.people.protocol import Answer
from wordcraft_kg.base import ArtefactError, as_record, check_file

ANSWERS_FILE = "answers.sqlite"
APPLICATION = 0x57434B47
"""Marks the file as a database of this package: "WCKG" in ASCII."""
VERSION = 2
"""Version of the tables; files of another version are refused."""
# Stored databases repeat these texts to the letter, so a changed blank is another schema.
TABLES = (
    "CREATE TABLE study (record TEXT PRIMARY KEY) STRICT",
    "CREATE TABLE sessions (number INTEGER PRIMARY KEY, code TEXT NOT NULL UNIQUE, "
    "form INTEGER NOT NULL, distractors INTEGER NOT NULL) STRICT",
    # Only for unanswered tasks: answer times are private.
    "CREATE TABLE showings (session INTEGER NOT NULL REFERENCES sessions, part TEXT NOT NULL, "
    "number INTEGER NOT NULL, shown REAL NOT NULL, loads INTEGER NOT NULL, "
    "PRIMARY KEY (session, part, number)) STRICT",
    # The primary key keeps a form that is sent twice from becoming two answers.
    "CREATE TABLE answers (session INTEGER NOT NULL REFERENCES sessions, part TEXT NOT NULL, "
    "number INTEGER NOT NULL, goal TEXT NOT NULL, slots TEXT NOT NULL, actions TEXT NOT NULL, "
    "made TEXT NOT NULL, success INTEGER NOT NULL, seconds REAL NOT NULL, loads INTEGER NOT NULL, "
    "PRIMARY KEY (session, part, number)) STRICT",
)
COUNTS = """
SELECT s.form, s.distractors, COUNT(*), SUM(COALESCE(a.answered, 0) >= ?)
FROM sessions AS s
LEFT JOIN (SELECT session, COUNT(*) AS answered FROM answers GROUP BY session) AS a
ON a.session = s.number WHERE s.code NOT LIKE 'withdrawn %' GROUP BY s.form, s.distractors
"""
BUSY = 10
"""Seconds to wait for a program that reads a copy meanwhile, such as a backup."""
_LOG = logging.getLogger(__name__)


@dataclass(frozen=True, order=True)
class Cell:
    """The assignment of a person.

    Attributes:
        form: number of the sampled task list, from 0.
        distractors: number of distractors on each table, the condition.
    """

    form: int
    distractors: int


@dataclass(frozen=True)
class Participant:
    """A person in a study.

    Attributes:
        number: number of the person, from 1, in starting order.
        cell: form and condition.
    """

    number: int
    cell: Cell


class AnswersDatabase:
    """The answers of a study, for the server; thread-safe."""

    def __init__(self, path: Path, study: str, turns: int):
        """Open or create a study's database.

        Args:
            path: database file.
            study: SHA-256 of ``study.json``, which the database repeats.
            turns: number of tasks per person.

        Raises:
            ArtefactError: if the file is damaged, something else, or belongs to another study; it
                is then unchanged.
        """
        if not path.exists():
            _make(path, study)
        # Only the checks count here: a file that is not ours must not be opened for writing.
        with _reading(path, study):
            pass
        self._path = path
        self._turns = turns
        self._lock = threading.Lock()
        # Pages are made in several threads; the lock keeps them from using the connection at once.
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
        """Run a block as one transaction: everything in the block is stored, or nothing."""
        with self._lock:
            try:
                # Immediate: the transaction reads before it writes, and nobody may write between.
                self._connection.execute("BEGIN IMMEDIATE")
                yield self._connection
                self._connection.execute("COMMIT")
            except sqlite3.Error as error:
                raise _failed(self._path, error) from None
            finally:
                if self._connection.in_transaction:  # a full disk ends the transaction
                    self._connection.execute("ROLLBACK")

    def _empty_log(self) -> None:
        """Remove overwritten pages, such as withdrawn answers, from the write-ahead log."""
        with self._lock, suppress(sqlite3.Error):
            if not self._connection.execute("PRAGMA wal_checkpoint(TRUNCATE)").fetchone()[0]:
                return
        _LOG.warning(
            "%s-wal keeps withdrawn answers until the server stops or starts again.", self._path
        )

    def begin(self, code: str, cells: Sequence[Cell]) -> Participant:
        """Start the session of a new person, or return the session that a code has begun.

        The new person gets the cell with the fewest sessions; ties are decided by the fewest
        finished sessions, then by the order of ``cells``. A form that is sent twice has the same
        code, and so begins one session.

        Args:
            code: hash of the person's code.
            cells: forms and conditions, preferred cells first.
        """
        with self._writing() as connection:
            person = _find(connection, code)
            if person is not None:
                return person
            rows = connection.execute(COUNTS, (self._turns,)).fetchall()
            counts = {
                Cell(form, distractors): (begun, finished)
                for form, distractors, begun, finished in rows
            }
            # min returns the first of several equal cells, so the order of the cells decides ties.
            cell = min(cells, key=lambda cell: counts.get(cell, (0, 0)))
            # The code's hash is unique, so that even two servers cannot begin a session twice.
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

    def answers_of(self, person: Participant) -> tuple[Answer, ...]:
        """Return the answers of a person in order.

        Raises:
            ArtefactError: if a stored answer has a wrong field.
        """
        with self._lock:
            return _answers_of(self._connection, person.number, self._path)

    def show(self, person: Participant, part: str, number: int, now: float) -> None:
        """Record a page load for an unanswered task; answered tasks are ignored.

        Args:
            person: the person.
            part: part of the task, train or test.
            number: number of the task in its part, from 1.
            now: time in seconds. Only the first load's time is kept; each load is counted.
        """
        key = (person.number, part, number)
        with self._writing() as connection:
            if not connection.execute(f"SELECT 1 FROM answers WHERE {_KEY}", key).fetchone():
                connection.execute(
                    "INSERT INTO showings VALUES (?, ?, ?, ?, 1) "
                    "ON CONFLICT DO UPDATE SET loads = loads + 1",
                    (*key, now),
                )

    def shown(self, person: Participant, part: str, number: int) -> float | None:
        """Return the time of the first page load for an unanswered task.

        Args:
            person: the person.
            part: part of the task, train or test.
            number: number of the task in its part, from 1.

        Returns:
            Seconds by the clock of :meth:`show`; None if the task was not shown, or is answered.
        """
        key = (person.number, part, number)
        with self._lock:
            row = self._connection.execute(
                f"SELECT shown FROM showings WHERE {_KEY}", key
            ).fetchone()
        return None if row is None else float(row[0])

    def add(self, person: Participant, answer: Answer) -> bool:
        """Store the answer to a shown task.

        Returns False, and stores nothing, if the task was not shown or has an answer already: the
        first answer stays.
        """
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
            # The time of showing goes as soon as it has served: answer times are private.
            connection.execute(f"DELETE FROM showings WHERE {_KEY}", key)
            return True

    def withdraw(self, person: Participant) -> None:
        """Remove the answers and the code of a person; the session number is not used again.

        The row of the session stays, without its code: a removed row's number could be given to
        another person, and an export made before would then mix the two.
        """
        with self._writing() as connection:
            for table in ("answers", "showings"):
                connection.execute(f"DELETE FROM {table} WHERE session = ?", (person.number,))
            # Codes are hashes in hexadecimal, so no code can be equal to this text.
            connection.execute(
                "UPDATE sessions SET code = 'withdrawn ' || number WHERE number = ?",
                (person.number,),
            )
        self._empty_log()

    def close(self) -> None:
        """Close the database file; SQLite then removes the write-ahead log."""
        with self._lock:
            self._connection.close()


_KEY = "session = ? AND part = ? AND number = ?"
_PEOPLE = "SELECT number, form, distractors FROM sessions WHERE code NOT LIKE 'withdrawn %'"
# Descending parts: train comes before test.
_ANSWERS = (
    "SELECT part, number, goal, slots, actions, made, success, seconds, loads FROM answers "
    "WHERE session = ? ORDER BY part DESC, number"
)


def read_answers(path: Path, study: str) -> dict[Participant, tuple[Answer, ...]]:
    """Return all people and answers of a study in order; nothing is written.

    A server may be running.

    Args:
        path: database file.
        study: SHA-256 of ``study.json``, which the database repeats.

    Returns:
        answers in the order of tasks, of each person by number; without withdrawn people.

    Raises:
        ArtefactError: if the file is missing, damaged, something else, or of another study.
    """
    with _reading(path, study) as connection:
        rows = connection.execute(f"{_PEOPLE} ORDER BY number").fetchall()
        people = [
            Participant(number, Cell(form, distractors)) for number, form, distractors in rows
        ]
        try:
            return {person: _answers_of(connection, person.number, path) for person in people}
        except (ValueError, TypeError, RecursionError) as error:
            raise _damaged(path, error) from None


@contextmanager
def _reading(path: Path, study: str) -> Iterator[sqlite3.Connection]:
    """Open the database of a study for reading, after a check that it is sound and ours."""
    check_file(path)
    try:
        with closing(sqlite3.connect(_address(path), uri=True, timeout=BUSY)) as connection:
            # One transaction: a server may write between two queries.
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
            # Damaged pages may hold plausible answers, so nothing is read from such a file.
            problem = connection.execute("PRAGMA quick_check(1)").fetchone()[0]
            if problem != "ok":
                raise _damaged(path, problem)
            if connection.execute("PRAGMA foreign_key_check").fetchone():
                raise _damaged(path, "it has answers without a session")
            if connection.execute("SELECT record FROM study").fetchall() != [(study,)]:
                raise ArtefactError(
                    f"{path} belongs to another study than the study.json in its folder, or "
                    "study.json was changed. Nothing was changed; restore a copy."
                )
            yield connection
    except sqlite3.Error as error:
        raise _failed(path, error) from None


def _address(path: Path) -> str:
    """Return the address for reading; SQLite itself takes the answers that a kill left in the log.

    Without a log there is no writer, so no lock is needed, and the medium may be read-only.
    """
    has_log = path.with_name(f"{path.name}-wal").exists()
    return f"{path.resolve().as_uri()}?{'mode=ro' if has_log else 'immutable=1'}"


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
        # SQLite makes the new name durable when it begins its log in this folder.
        os.replace(new, path)
    except sqlite3.Error as error:
        raise _failed(path, error) from None
    finally:
        new.unlink(missing_ok=True)


def _find(connection: sqlite3.Connection, code: str) -> Participant | None:
    row = connection.execute(
        "SELECT number, form, distractors FROM sessions WHERE code = ?", (code,)
    ).fetchone()
    return None if row is None else Participant(row[0], Cell(row[1], row[2]))


def _answers_of(connection: sqlite3.Connection, session: int, path: Path) -> tuple[Answer, ...]:
    """Return the answers of a person, by number, in the order of tasks."""
    answers = []
    for row in connection.execute(_ANSWERS, (session,)):
        part, number, goal, *lists, success, seconds, loads = row
        # The columns have the order of the record's fields.
        values = (part, number, goal, *map(json.loads, lists), bool(success), seconds, loads)
        fields = dict(zip(Answer.__struct_fields__, values, strict=True))
        answers.append(as_record(fields, Answer, path))
    return tuple(answers)


def _failed(path: Path, error: sqlite3.Error) -> ArtefactError:
    # Operational errors come from the system, such as a full disk; others from the content.
    if not isinstance(error, sqlite3.OperationalError):
        return _damaged(path, error)
    return ArtefactError(
        f"{path} cannot be read or written: {error}. Expected a writable folder with free space."
    )


def _damaged(path: Path, error: object) -> ArtefactError:
    return ArtefactError(f"{path} is damaged: {error}. Nothing was changed; restore a copy.")
