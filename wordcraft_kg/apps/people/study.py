"""A study: several people take the protocol, with several draws of tasks and numbers of distractors."""

import hashlib
import os
import threading
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Literal

from wordcraft_kg.apps.people.config import MOST_TASKS, StudyConfig
from wordcraft_kg.apps.people.protocol import HUMAN_FORMAT, HumanProtocol, PosedTask
from wordcraft_kg.base.artefacts import dump_json, read_small_file, what_is, write_atomically
from wordcraft_kg.base.errors import ArtefactError, ConfigError, GraphMismatchError, OutputExistsError
from wordcraft_kg.base.records import Count, Hash, Record, as_values, parse_record
from wordcraft_kg.envs.world import GraphLike

STUDY_FILE, ANSWERS_FILE = "study.json", "answers.sqlite"


class StudyRecord(Record):
    """``study.json``: what a study is; its answers belong to it and to no other.

    Attributes:
        graph: name of the graph.
        settings: those of the tasks, apart from the number of distractors.
        created: when it was begun, in UTC.
    """

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

    def header(self, form: int, distractors: int) -> dict[str, Any]:
        """Return the header of a session's file that somebody with this form and condition would have."""
        return {
            "format": HUMAN_FORMAT,
            "graph": self.graph,
            "graph_hash": self.graph_hash,
            "split_hash": self.split_hash,
            "settings": self.settings | {"num_distractors": distractors},
            "seed": self.seed + form,
        }

    @property
    def tasks(self) -> int:
        """Tasks of each part."""
        return int(self.settings["tasks_per_part"])


@dataclass(frozen=True, order=True)
class Cell:
    """What a person is assigned to.

    Attributes:
        form: number of the draw of tasks, from 0.
        distractors: the condition.
    """

    form: int
    distractors: int


class Study:
    """The tasks of a study, posed when they are first needed.

    Attributes:
        record: what it is.
        cells: forms and conditions, in the order in which they are assigned to people.
    """

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
            graph=header["graph"],
            graph_hash=header["graph_hash"],
            split_hash=header["split_hash"],
            settings={name: value for name, value in header["settings"].items() if name != "num_distractors"},
            distractors=config.distractors,
            seed=config.seed,
            forms=config.forms,
            consent=config.consent,
            created=datetime.now(UTC).isoformat(timespec="seconds"),
        )
        # Conditions alternate before forms do: they are what a study compares.
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


def check_study_folder(folder: Path, record: StudyRecord) -> bool:
    """Return whether a folder holds this very study already; False if it can be begun there.

    Raises:
        ArtefactError: if ``study.json`` is damaged.
        GraphMismatchError: if the folder's study is of another graph or split.
        ConfigError: if it has other settings.
        OutputExistsError: if something else is there.
    """
    if not os.path.lexists(folder):
        return False
    if not folder.is_dir() or not (folder / STUDY_FILE).exists():
        if folder.is_dir() and not any(folder.iterdir()):
            return False
        raise OutputExistsError(
            f"'{folder}' {what_is(folder)}; expected the folder of this study, or a new one. Choose another `out`."
        )
    found, _ = read_study_record(folder)
    for name in StudyRecord.__struct_fields__:
        one, other = getattr(found, name), getattr(record, name)
        if name in ("created", "graph") or one == other:
            continue
        where = f"'{folder}' is a study"
        if name.endswith("_hash"):
            what = name.removesuffix("_hash")
            names = f" ({found.graph})" if what == "graph" else ""
            raise GraphMismatchError(
                f"{where} of the {what} {one[:12]}{names}, but this command has {other[:12]}. Nothing was changed."
            )
        if name == "settings":
            differing = [key for key in {**one, **other} if one.get(key) != other.get(key)]
            name, one, other = differing[0], one.get(differing[0]), other.get(differing[0])
        if name == "consent":
            raise ConfigError(f"{where} whose people agreed to another text. Nothing was changed; give that text.")
        is_, should = (", ".join(map(str, value)) if isinstance(value, tuple) else value for value in (one, other))
        raise ConfigError(f"{where} with {name} {is_}, but this command has {should}. Nothing was changed.")
    return True


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
        raise ArtefactError(f"'{folder}' {what_is(folder)}; expected the folder that `study serve` writes.")
    data = read_small_file(path)
    record = parse_record(data, StudyRecord, path)
    tasks = record.settings.get("tasks_per_part")
    if not isinstance(tasks, int) or not 1 <= tasks <= MOST_TASKS:
        raise ArtefactError(f"{path} is damaged: 'tasks_per_part' is not a whole number, 1 to {MOST_TASKS:,}.")
    return record, hashlib.sha256(data).hexdigest()
