"""List of the known recipe books, and the check of a recipe book."""

from pathlib import Path
from typing import Unpack

import numpy as np

from wordcraft_kg.base.artefacts import made_folder
from wordcraft_kg.base.errors import RecipeFileError, SplitError
from wordcraft_kg.base.records import Count, Record
from wordcraft_kg.graphs.book_check import BookCheck, BookStatistics, Finding, check_book, listed
from wordcraft_kg.graphs.book_files import ReadOptions, write_book
from wordcraft_kg.graphs.library import (
    FETCHABLE,
    KnownBook,
    cache_folder,
    data_folder,
    known_books,
    locate_book,
    open_book,
)
from wordcraft_kg.graphs.reading import Reading
from wordcraft_kg.graphs.recipe_graph import RecipeGraph
from wordcraft_kg.graphs.splits import SplitConfig, make_split

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


class BookList(Record):
    """All known recipe books.

    Attributes:
        books: the books.
        cache: folder for fetched books.
        data_folder: folder of the user's own books; None if not set.
    """

    books: tuple[ListedBook, ...]
    cache: str
    data_folder: str | None


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
    """

    book: str
    path: str
    passed: bool
    reading: Reading | None
    fixed: str | None
    figures: BookStatistics | dict[str, None]
    findings: tuple[Finding, ...]


def view_books() -> BookList:
    """List the known recipe books with their sizes."""
    folder = data_folder()
    return BookList(
        books=tuple(_listed(book) for book in known_books()),
        cache=str(cache_folder()),
        data_folder=None if folder is None else str(folder),
    )


def _listed(book: KnownBook) -> ListedBook:
    size = _size(book)
    return ListedBook(
        name=book.name,
        origin=book.origin,
        path=None if book.path is None else str(book.path),
        note=FETCHABLE[book.name].note if book.name in FETCHABLE else "",
        entities=size[0] if size else None,
        recipes=size[1] if size else None,
    )


def _size(book: KnownBook) -> tuple[int, int] | None:
    if book.path is None or book.path.stat().st_size > MAX_COUNTED:
        return None
    try:
        content = open_book(book.name)
    except RecipeFileError:
        # A damaged file in the data folder must not hide all other books.
        return None
    return len(content.entities), len(content.recipes)


def view_check(
    book: str,
    base: list[str] | None,
    against: str | None,
    *,
    fix: Path | None = None,
    **options: Unpack[ReadOptions],
) -> CheckedBook:
    """Check a book, its words without vectors, and its overlap with another book.

    Without the packages for word vectors, as in the light installation, words are not checked.

    Args:
        book: file, folder or known name.
        base: labels of the base entities; None for the book's own, or else inferred ones.
        against: another book to compare with; None for no comparison.
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
    # Opened before the check, which may take seconds: a wrong name fails at once.
    other = None if against is None else open_book(against)
    check = check_book(path, base or located.base, located.name, **options)
    graph = check.graph
    if fix is not None:
        if check.book is None:
            raise RecipeFileError(
                f"{path}: no recipe is readable, so nothing was written to {fix}."
            )
        with made_folder(fix.parent):
            write_book(check.book, fix)
    if graph is not None:
        try:
            check = _with_words(check, graph)
        except ImportError as error:
            message = f"words were not checked for word vectors, which need {error.name}"
            check = check.adding([Finding("vector", "note", (), message)])
    if graph is not None and other is not None:
        counted = ~graph.makes_half_product
        shared = len(set(graph.recipe_labels(graph.recipes[counted])) & set(other.recipes))
        share = shared / int(np.sum(counted))
        check = check.adding((), against=other.name, shared_recipes=shared, shared=share)
    return CheckedBook(
        book,
        str(path),
        check.passed,
        check.reading,
        None if fix is None else str(fix),
        check.figures or {},
        check.findings,
    )


def _with_words(check: BookCheck, graph: RecipeGraph) -> BookCheck:
    # Imported late: the list of books needs neither torch nor word vectors.
    from wordcraft_kg.models.scorers.features import glove_features
    from wordcraft_kg.models.scorers.near_synonyms import NEAR_SYNONYM, near_synonym_recipes

    features = glove_features(graph.entities)
    # The label of a half-product is no text of the file: its plus signs and dots are no words.
    is_text = ~graph.is_half_product
    texts = features if is_text.all() else glove_features(graph.labels(np.flatnonzero(is_text)))
    words = texts.words
    missing = texts.missing_words
    message = f"{len(missing)} of {len(words)} words have no word vector: {listed(missing)}"
    findings = [Finding("vector", "note", (), message)] if missing else []
    check = check.adding(
        findings, words=len(words), words_with_vector=1 - len(missing) / len(words)
    )
    try:
        split = make_split(graph, SplitConfig())
    except SplitError:  # too few recipes to split
        return check
    is_counted = split.is_in("test") & ~graph.makes_half_product
    if not is_counted.any():
        return check
    share = float(near_synonym_recipes(split, features)[is_counted].mean())
    return check.adding((), near_synonym_share=share, near_synonym_cosine=NEAR_SYNONYM)
