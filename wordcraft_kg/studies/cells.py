"""A store of cells: results of finished trainings as small files, shared between machines and committed with the code.

A cell is named by the address of its task, a hash over settings, seed, recipe book and code version. It holds the
results without durations, so the same training on the same platform gives the same bytes.
"""

import json
import logging
from functools import partial
from pathlib import Path
from typing import Any, Literal

from msgspec import structs

from wordcraft_kg.base.artefacts import read_small_file, write_atomically
from wordcraft_kg.base.errors import ArtefactError, ConfigError
from wordcraft_kg.base.records import Record, as_record, as_values, parse_record
from wordcraft_kg.graphs.folder import OpenedGraph
from wordcraft_kg.graphs.library import open_book
from wordcraft_kg.graphs.recipe_graph import RecipeGraph
from wordcraft_kg.graphs.splits import SplitConfig, make_split
from wordcraft_kg.studies.perform import FIGURES, is_done
from wordcraft_kg.studies.plan import Plan
from wordcraft_kg.studies.played_tasks import PlayedTasks
from wordcraft_kg.studies.results import Figures, RunFigures, hash_of, read_figures, write_figures
from wordcraft_kg.studies.tasks import Task

_UNTIMED = {"seconds": 0.0, "steps_per_second": 0, "stored": False}


class StoredCell(Record, frozen=True):
    """A cell: a JSON file with the settings and results of one scorer or agent training, and the SHA-256 of both."""

    format: Literal["wordcraft-kg cell 1"]
    sha256: str
    settings: dict[str, Any]
    figures: dict[str, Any]


def cell_file(store: Path, task: Task) -> Path:
    """Return the path of a task's cell (JSON file with results) in the folder ``store``."""
    return store / f"{task.address}.json"


def exchange_cells(plan: Plan, root: Path, store: Path) -> int:
    """Copy missing cells between results and store, both ways; ConfigError for a file. Return those taken."""
    if store.is_file():
        raise ConfigError(
            f"`store` '{store}' is a file; expected a folder of cells, which may be new."
        )
    taken, played = 0, PlayedTasks(partial(_opened, plan))
    for task in (task for task in plan.tasks.values() if task.kind != "graphs"):
        if _is_here(task, root):
            keep_cell(task, root, store)
            continue
        figures = read_cell(task, store, played)
        if figures is not None:
            task.folder(root).mkdir(parents=True, exist_ok=True)
            write_figures(task.folder(root), structs.replace(figures, stored=True))
            taken += 1
    return taken


def read_cell(task: Task, store: Path, played: PlayedTasks | None = None) -> Figures | None:
    """Return a task's results from its cell (JSON file) in the folder ``store``; None if missing, damaged or edited.

    Figures that contradict each other are damage, too; with ``played``, so are results of other tasks than the agent's.
    """
    path = cell_file(store, task)
    if not path.exists():
        return None
    try:
        cell = parse_record(read_small_file(path), StoredCell, path)
        if cell.sha256 != hash_of([cell.settings, cell.figures]) or cell.settings != task.settings:
            raise ArtefactError(
                f"{path} is damaged or was changed: the hash or the settings do not fit."
            )
        figures = as_record(cell.figures, FIGURES[task.kind], path)
        # `keep_cell` writes no durations, so others are forged: a page would add them up.
        timed = [
            name for name in _UNTIMED if getattr(figures, name, _UNTIMED[name]) != _UNTIMED[name]
        ]
        if timed:
            raise ArtefactError(
                f"{path} is damaged or was changed: '{timed[0]}' is {getattr(figures, timed[0])}; expected "
                f"{_UNTIMED[timed[0]]} in a cell."
            )
        if played is not None and isinstance(figures, RunFigures):
            played.check(figures, task.needs[0], task.settings["settings"], path)
        return figures
    except ArtefactError as error:
        logging.getLogger(__name__).warning(
            "%s The training is repeated, and the cell replaced.", error
        )
        return None


def _opened(plan: Plan, address: str) -> OpenedGraph:
    graph = RecipeGraph.from_book(open_book(plan.books[address]))
    config = SplitConfig(**plan.tasks[address].settings["split"])
    return OpenedGraph(graph, make_split(graph, config), plan.books[address])


def keep_cell(task: Task, root: Path, store: Path) -> None:
    """Copy a finished training into the store; never replace an intact cell, but warn of other results."""
    figures = read_figures(task.folder(root), FIGURES[task.kind])
    if task.kind == "graphs" or figures.stored or not figures.platform:
        return
    path, text = cell_file(store, task), _text(task, figures)
    before, log = read_cell(task, store), logging.getLogger(__name__)
    if before is None:
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            write_atomically(path, text)
        except OSError as error:
            log.warning(
                "the cell of '%s' cannot be written to '%s' (%s).",
                task.title,
                store,
                error.strerror,
            )
    elif (before.platform, before.versions) == (
        figures.platform,
        figures.versions,
    ) and path.read_text("utf-8") != text:
        log.warning(
            "'%s' has other results than its cell %s, which stays. If the code has changed, raise VERSIONS in "
            "wordcraft_kg/studies/plan.py.",
            task.title,
            path,
        )


def _text(task: Task, figures: Figures) -> str:
    values = as_values(
        structs.replace(
            figures, **{name: _UNTIMED[name] for name in _UNTIMED if hasattr(figures, name)}
        )
    )
    cell = StoredCell(
        "wordcraft-kg cell 1", hash_of([task.settings, values]), task.settings, values
    )
    return json.dumps(as_values(cell), ensure_ascii=False, separators=(",", ":")) + "\n"


def _is_here(task: Task, root: Path) -> bool:
    try:
        return is_done(task, root)
    except ArtefactError:  # the engine repeats the task and says so
        return False
