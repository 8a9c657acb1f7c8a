"""List of the known recipe books, the check of a recipe book, and the tasks of a book's graph."""

from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Unpack

import msgspec
import numpy as np

from wordcraft_kg.base import Count, RecipeFileError, Record, Share, staged_file
from wordcraft_kg.envs.draws import EvaluationTables
from wordcraft_kg.envs.world import World
from wordcraft_kg.graphs import (
    Recipe,
    RecipeBook,
    TaskPart,
    known_books,
    open_book,
    read_book,
    write_book,
)
from wordcraft_kg.graphs.audit import BookFigures
from wordcraft_kg.graphs.book_check import LISTED, BookCheck, Finding, check_book
from wordcraft_kg.graphs.book_files import ReadOptions
from wordcraft_kg.graphs.book_files.rows import Place
from wordcraft_kg.graphs.library import FETCHABLE, KnownBook, locate_book
from wordcraft_kg.graphs.recipes import Reading

MAX_COUNTED = 8 * 2**20
"""Bytes. A larger book's size is not listed, because counting takes seconds."""


class ListedBook(Record):
    """A known recipe book.

    Attributes:
        name: name for the command line.
        origin: built in, cache, data folder or to fetch.
        path: the file; None before the download.
        note: how to fetch the book, or empty.
        entities, recipes: number of these; None if the file is missing, unreadable or very large.
    """

    name: str
    origin: str
    path: str | None
    note: str
    entities: Count | None
    recipes: Count | None


class CheckedBook(Record):
    """The result of checking a recipe book.

    Attributes:
        book: the book as the user named it.
        path: the checked file.
        passed: whether the check found no problem.
        figures: counts; empty if no recipe could be read.
        findings: problems first, then notes.
        reading: how the file was read; None if its shape is unknown.
        fixed: the mended book that was written; None if none was asked for.
        left_out: rows that the mended book lacks, by reason, with the first lines or places; empty
            without a mended book.
        columns_left_out: further columns of the file that the mended book lacks.
    """

    book: str
    path: str
    passed: bool
    reading: Reading | None
    fixed: str | None
    figures: BookFigures | dict[str, None]
    findings: tuple[Finding, ...]
    left_out: dict[str, tuple[Place, ...]] = msgspec.field(default_factory=dict)
    columns_left_out: tuple[str, ...] = ()


def view_books() -> list[ListedBook]:
    """List the known recipe books with their sizes."""
    return [_listed(book) for book in known_books()]


def _listed(book: KnownBook) -> ListedBook:
    content = None
    if book.path is not None and book.path.stat().st_size <= MAX_COUNTED:
        # A damaged file in the data folder must not hide all other books.
        with suppress(RecipeFileError):
            content = open_book(book.name)
    return ListedBook(
        name=book.name,
        origin=book.origin,
        path=None if book.path is None else str(book.path),
        note=FETCHABLE[book.name].note if book.name in FETCHABLE else "",
        entities=None if content is None else len(content.entities),
        recipes=None if content is None else len(content.recipes),
    )


def view_check(
    book: str,
    base: list[str] | None,
    *,
    fix: Path | None = None,
    **options: Unpack[ReadOptions],
) -> CheckedBook:
    """Check a book, and write a mended one if asked for.

    Args:
        book: file, folder or known name.
        base: labels of the base entities; None for the book's own, or else inferred ones.
        fix: file for the mended book: readable recipes, each once, in UTF-8; None for none.
        options: what a user says about the file, see
            :class:`~wordcraft_kg.graphs.book_files.BookOptions`.

    Returns:
        Counts and findings.

    Raises:
        RecipeFileError: if the file cannot be read, or no recipe is left to write.
        ConfigError: for an option outside its values.
    """
    located = locate_book(book)
    in_folder = located.path / "graph.json"
    path = in_folder if in_folder.is_file() else located.path
    # A file that another process writes during this check is not replaced.
    replaces = fix is not None and fix.exists()
    check = check_book(path, base or located.base, located.name, **options)
    kept_columns = False
    if fix is not None:
        if check.book is None:
            raise RecipeFileError(
                f"{path}: no recipe is readable, so nothing was written to {fix}."
            )
        with staged_file(fix, force=replaces) as staged:
            kept_columns = _write_mended(check, check.book, staged)
    return CheckedBook(
        book,
        str(path),
        check.passed,
        check.reading,
        None if fix is None else str(fix),
        check.figures or {},
        check.findings,
        {} if fix is None else _left_out(check),
        () if kept_columns or fix is None or check.reading is None else check.reading.ignored,
    )


def _write_mended(check: BookCheck, book: RecipeBook, path: Path) -> bool:
    """Write a book in the order of a checked file, with its further columns if they can be read.

    Args:
        check: the check.
        book: its book.
        path: a .csv, .tsv or .json file.

    Returns:
        Whether the further columns were written: JSON has none, and one named "result", or labels
        that are numbers, cannot be read beside our own columns.
    """
    recipes = set(book.recipes)
    ordered = replace(book, recipes=[recipe for recipe in check.places if recipe in recipes])
    reading = check.reading
    if reading is not None and check.records and path.suffix.lower() != ".json":
        label_of = str.lower if reading.case == "fold" else str
        rows = {}
        for recipe in ordered.recipes:
            record = check.records[check.places[recipe]]
            # In their order, in which a further column may have numbers of pieces.
            columns = reading.columns[: -reading.num_results]
            labels = [label_of(record[name]) for name in columns if record[name]]
            if sorted(labels) != list(recipe.ingredients):  # such as all of them in one cell
                labels = sorted(recipe.ingredients, key=" ".join(labels).find)
            rows[recipe] = (labels, [record[name] for name in reading.ignored])
        write_book(ordered, path, (reading.ignored, rows))
        with suppress(RecipeFileError):
            if read_book(path).recipes == book.recipes:
                return True
    write_book(ordered, path)
    return False


def _left_out(check: BookCheck) -> dict[str, tuple[Place, ...]]:
    """Return the first places of the rows that a check's book lacks, by reason."""
    assert check.reading is not None
    reasons = check.reading.left_out
    return {reason: tuple(check.lost.get(reason, ())[:LISTED]) for reason in reasons}


class ShownTask(Record):
    """An example task.

    Attributes:
        goal: label of the goal.
        start: starting ingredients.
        distractors: other entities on the table.
        table: the table, slot by slot.
        plans: all ways to make the goal, each as recipes in turn.
    """

    goal: str
    start: tuple[str, ...]
    distractors: tuple[str, ...]
    table: tuple[str, ...]
    plans: tuple[tuple[Recipe, ...], ...]


class TaskListing(Record):
    """The tasks in a split part, with examples.

    Attributes:
        graph: name of the graph.
        depth: fewest attempts that solve a task.
        part: the split part.
        tasks: number of tasks.
        uses_twice: share of the tasks all of whose plans use an entity twice.
        complete: whether these are all tasks of the part, and not a random sample.
        mixed: number of tasks that use recipes of several parts and belong to none.
        shown: the examples.
    """

    graph: str
    depth: int
    part: TaskPart
    tasks: Count
    uses_twice: Share
    complete: bool
    mixed: Count
    shown: tuple[ShownTask, ...]


def view_tasks(world: World, limit: int, seed: int) -> TaskListing:
    """Count a world's tasks and show examples, on tables of evaluation.

    Args:
        world: graph, tasks and settings.
        limit: most examples to return.
        seed: seed of the choice and of the distractors.

    Returns:
        Counts, and the examples in random order.
    """
    tables = EvaluationTables(world)
    order = np.random.default_rng(seed).permutation(len(world.tasks))[:limit].tolist()
    shown = []
    for index in order:
        task = world.tasks[index]
        table = world.graph.labels(tables.table(index, seed))
        # Sorted, because the table's order is random and tells nothing.
        distractors = tuple(sorted(set(table) - set(task.start)))
        shown.append(ShownTask(task.goal, task.start, distractors, table, task.plans))
    return TaskListing(
        graph=world.graph.name,
        depth=world.config.depth,
        part=world.config.part,
        tasks=len(world.tasks),
        uses_twice=float(world.tasks.uses_twice.mean()),
        complete=world.tasks.is_complete,
        mixed=world.tasks.mixed,
        shown=tuple(shown),
    )
