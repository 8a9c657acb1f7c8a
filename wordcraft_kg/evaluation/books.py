"""The recipe books known by name, and the check of a book."""

from wordcraft_kg.base.cache import cache_folder
from wordcraft_kg.base.errors import RecipeFileError, SplitError
from wordcraft_kg.base.records import Count, Record
from wordcraft_kg.graphs.book_check import BookCheck, BookFigures, Finding, check_book, listed
from wordcraft_kg.graphs.library import FETCHABLE, KnownBook, data_folder, known_books, locate_book, open_book
from wordcraft_kg.graphs.recipe_graph import RecipeGraph
from wordcraft_kg.graphs.splits import SplitConfig, make_split

MAX_COUNTED = 8 * 2**20
"""Bytes. A larger book is listed without its size, because reading it would take seconds."""


class ListedBook(Record):
    """A book's name, origin, file if it has one, and note.

    Attributes:
        entities: number of its entities; None if it is not on this machine, cannot be read, or is very large.
    """

    name: str
    origin: str
    path: str | None
    note: str
    entities: Count | None
    recipes: Count | None


class BookList(Record):
    """All books known by name, and the folders that are searched for them."""

    books: tuple[ListedBook, ...]
    cache: str
    data_folder: str | None


class CheckedBook(Record):
    """The result of checking a book.

    Attributes:
        book: the book as the user named it.
        passed: whether there are no problems.
        figures: counts; empty if no recipe could be read.
        findings: problems first.
    """

    book: str
    path: str
    passed: bool
    figures: BookFigures | dict[str, None]
    findings: tuple[Finding, ...]


def view_books() -> BookList:
    """List the known books."""
    books = tuple(
        ListedBook(
            name=book.name,
            origin=book.origin,
            path=None if book.path is None else str(book.path),
            note=FETCHABLE[book.name].note if book.name in FETCHABLE else "",
            entities=size[0] if size else None,
            recipes=size[1] if size else None,
        )
        for book in known_books()
        for size in [_size(book)]
    )
    folder = data_folder()
    return BookList(books, str(cache_folder("books")), None if folder is None else str(folder))


def _size(book: KnownBook) -> tuple[int, int] | None:
    """Return how many entities and recipes a book has, if that is known at once."""
    if book.path is None or book.path.stat().st_size > MAX_COUNTED:
        return None
    try:
        content = open_book(book.name)
    except RecipeFileError:
        return None
    return len(content.entities), len(content.recipes)


def view_check(
    book: str, base: list[str] | None, against: str | None, *, single_ingredient: str | None = None
) -> CheckedBook:
    """Check a book, also for words without vectors, and for recipes that it shares with another book.

    Args:
        book: file, folder or known name.
        base: base entities; None takes the book's own, or infers them.
        against: another book to compare with, or None.
        single_ingredient: see :func:`~wordcraft_kg.graphs.book_files.read_book`.
    """
    located = locate_book(book)
    path = located.path / "graph.json" if (located.path / "graph.json").is_file() else located.path
    other = None if against is None else open_book(against)
    found = check_book(path, base or located.base, located.name, single_ingredient=single_ingredient)
    graph = found.graph
    if graph is not None:
        found = _with_words(found, graph)
    if graph is not None and other is not None:
        shared = len(set(graph.recipe_labels()) & set(other.recipes))
        found = found.adding((), against=other.name, shared_recipes=shared, shared=shared / graph.num_recipes)
    return CheckedBook(book, str(path), found.passed, found.figures or {}, found.findings)


def _with_words(found: BookCheck, graph: RecipeGraph) -> BookCheck:
    """Add what needs word vectors: words without one, and test recipes that nearly repeat a train recipe."""
    from wordcraft_kg.models.scorers.features import glove_features
    from wordcraft_kg.models.scorers.near_synonyms import NEAR_SYNONYM, near_synonym_recipes

    features = glove_features(graph.entities)
    words, missing = features.words, features.missing_words
    message = f"{len(missing)} of {len(words)} words have no word vector: {listed(missing)}"
    findings = [Finding("vector", "note", (), message)] if missing else []
    found = found.adding(findings, words=len(words), words_with_vector=1 - len(missing) / len(words))
    try:
        split = make_split(graph, SplitConfig())
    except SplitError:  # too few recipes to split
        return found
    share = float(near_synonym_recipes(split, features)[split.is_in("test")].mean())
    return found.adding((), near_synonym_share=share, near_synonym_cosine=NEAR_SYNONYM)
