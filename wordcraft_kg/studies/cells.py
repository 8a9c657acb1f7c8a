"""A store of cells.

Cells are results of finished trainings, shared between machines and committed with the code.

A cell is named by the address of its task, a hash over settings, seed, recipe book and code
version. It holds the results without durations, so the same training on the same platform gives the
same bytes. ``packs`` has the files.
"""

import logging
from functools import partial
from pathlib import Path
from typing import Any, Literal

from msgspec import structs

from wordcraft_kg.base.artefacts import json_text, made_folder, write_atomically
from wordcraft_kg.base.errors import ArtefactError
from wordcraft_kg.base.records import Record, as_record, as_values, parse_record
from wordcraft_kg.graphs.folder import OpenedGraph
from wordcraft_kg.graphs.library import open_book
from wordcraft_kg.graphs.recipe_graph import RecipeGraph
from wordcraft_kg.graphs.splits import SplitConfig, make_split
from wordcraft_kg.studies.packs import CellFiles
from wordcraft_kg.studies.perform import METRICS, is_done
from wordcraft_kg.studies.plan import Plan
from wordcraft_kg.studies.played_tasks import PlayedTasks
from wordcraft_kg.studies.results import (
    RunMetrics,
    TaskMetrics,
    hash_of,
    read_metrics,
    write_metrics,
)
from wordcraft_kg.studies.tasks import Task

_UNTIMED = {"seconds": 0.0, "steps_per_second": 0, "stored": False}
"""Values in a cell of what differs between two equal trainings."""


class StoredCell(Record, frozen=True):
    """A cell: a JSON text with the results of one scorer or agent training.

    Attributes:
        format: name and version of the file format.
        sha256: hash of settings and results, which finds damage and careless edits, but no forged
            cell.
        settings: settings of the task, whose hash is the cell's name.
        figures: results without durations.
    """

    format: Literal["wordcraft-kg cell 1"]
    sha256: str
    settings: dict[str, Any]
    figures: dict[str, Any]


def exchange_cells(plan: Plan, root: Path, store: CellFiles) -> int:
    """Copy missing cells between a results folder and a store, both ways.

    Args:
        plan: the study; graphs have no cells.
        root: results folder.
        store: files of the store.

    Returns:
        Number of cells that were taken from the store.

    Raises:
        OSError: if results cannot be written to ``root``, as on a full disk.
    """
    taken = 0
    # Opened once for all cells: each agent of a graph plays the same tasks.
    played = PlayedTasks(partial(_opened, plan))
    for task in plan.tasks.values():
        if task.kind == "graphs":
            continue
        if _is_here(task, root):
            keep_cell(task, root, store)
            continue
        figures = read_cell(task, store, played)
        if figures is not None:
            with made_folder(task.folder(root)):
                write_metrics(task.folder(root), structs.replace(figures, stored=True))
            taken += 1
    return taken


def read_cell(
    task: Task,
    store: CellFiles,
    played: PlayedTasks | None = None,
) -> TaskMetrics | None:
    """Return a task's results from its cell, and warn of a cell that does not count.

    Args:
        task: scorer or agent training.
        store: files of the store.
        played: test tasks of the study's agents. With them, results of other tasks than the agent's
            are damage, too.

    Returns:
        None if the cell is missing, damaged or edited, or has results that contradict each other.
    """
    where = store.where(task.address)
    if where is None:
        return None
    try:
        cell = parse_record(store.read(task.address), StoredCell, where)
        is_intact = cell.sha256 == hash_of([cell.settings, cell.figures])
        if not is_intact or cell.settings != task.settings:
            raise ArtefactError(
                f"{where} is damaged or was changed: the hash or the settings do not fit."
            )
        figures = as_record(cell.figures, METRICS[task.kind], where)
        # `keep_cell` writes no durations, so others are forged: a page would add them up.
        for name, expected in _UNTIMED.items():
            value = getattr(figures, name, expected)
            if value != expected:
                raise ArtefactError(
                    f"{where} is damaged or was changed: '{name}' is {value}; expected {expected} "
                    "in a cell."
                )
        if played is not None and isinstance(figures, RunMetrics):
            played.check(figures, task.needs[0], task.settings["settings"], where)
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


def keep_cell(task: Task, root: Path, store: CellFiles) -> None:
    """Write a finished training into a store as a loose file.

    An intact cell stays, with a warning if results differ.

    Results that came from a store, or that do not name their platform, are left out.

    Args:
        task: a done task; graphs have no cells.
        root: results folder with the task's results.
        store: files of the store. A store that cannot be written is a warning: the results are safe
            in ``root``.

    Raises:
        ArtefactError: if the task has no results, or they are damaged.
    """
    figures = read_metrics(task.folder(root), METRICS[task.kind])
    if task.kind == "graphs" or figures.stored or not figures.platform:
        return
    text = _text(task, figures)
    before = read_cell(task, store)
    if before is None:
        _write_loose(task, store, text)
        return
    # Other platforms and versions round otherwise, so only results of the same ones have to agree.
    is_comparable = before.platform == figures.platform and before.versions == figures.versions
    if is_comparable and store.read(task.address) != text.encode():
        logging.getLogger(__name__).warning(
            "'%s' has other results than its cell %s, which stays. If the code has changed, raise "
            "VERSIONS in wordcraft_kg/studies/plan.py.",
            task.title,
            store.where(task.address),
        )


def _write_loose(task: Task, store: CellFiles, text: str) -> None:
    path = store.loose(task.address)
    try:
        with made_folder(path.parent):
            write_atomically(path, text)
    except OSError as error:
        logging.getLogger(__name__).warning(
            "the cell of '%s' cannot be written to '%s' (%s).",
            task.title,
            store.folder,
            error.strerror,
        )


def _text(task: Task, figures: TaskMetrics) -> str:
    untimed = {name: value for name, value in _UNTIMED.items() if hasattr(figures, name)}
    values = as_values(structs.replace(figures, **untimed))
    cell = StoredCell(
        format="wordcraft-kg cell 1",
        sha256=hash_of([task.settings, values]),
        settings=task.settings,
        figures=values,
    )
    # Without blanks: cells are many, and are read by programs.
    return json_text(as_values(cell), separators=(",", ":")) + "\n"


def _is_here(task: Task, root: Path) -> bool:
    try:
        return is_done(task, root)
    except ArtefactError:  # the engine repeats the task and says so
        return False
