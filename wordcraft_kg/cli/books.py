"""``wordcraft-kg books``."""

from collections.abc import Iterator
from typing import TYPE_CHECKING

from wordcraft_kg.cli.console import Output, aligned
from wordcraft_kg.cli.options import FetchableBook
from wordcraft_kg.graphs.library import DATA_VARIABLE, FETCHABLE, fetch_book

if TYPE_CHECKING:
    from wordcraft_kg.evaluation.books import BookList

EXAMPLES = (
    "wordcraft-kg books",
    "wordcraft-kg books --fetch little-alchemy-2",
    "wordcraft-kg books --fetch infinite-craft",
)


def books(*, fetch: FetchableBook = None, output: Output = Output()) -> None:
    """List the recipe books known by name, or download a published book into the cache.

    Commands accept a book's name in place of a path.

    Args:
        fetch: book to download into the cache; the SHA-256 is checked.
    """
    # The only command that downloads a book: all others work without a network.
    if fetch is not None:
        path = fetch_book(fetch)
        book = FETCHABLE[fetch]
        values = {
            "book": fetch,
            "path": str(path),
            "sha256": book.sha256,
            "url": book.url,
            "note": book.note,
        }
        output.result(
            values,
            [f"{fetch} is in {path} ({book.note})", f"next: wordcraft-kg build-graph {fetch}"],
        )
    else:
        from wordcraft_kg.evaluation.books import view_books

        view = view_books()
        output.result(view, _text(view))


def _text(view: "BookList") -> Iterator[str]:
    rows: list[tuple[str, ...]] = [("book", "origin", "entities", "recipes", "")]
    for book in view.books:
        # A built-in book is in the package, wherever that is.
        place = ""
        if book.origin != "built in":
            place = book.path or f"get it: wordcraft-kg books --fetch {book.name}"
        note = f"  ({book.note})" if book.note else ""
        # Right-aligned; a book that is not here has no sizes.
        entities = f"{_size(book.entities):>8}"
        recipes = f"{_size(book.recipes):>8}"
        rows.append((book.name, book.origin, entities, recipes, f"{place}{note}".lstrip()))
    yield from aligned(rows)
    yield "with invented words: made-up:BOOK, such as made-up:everyday; made-up-3:BOOK with seed 3"
    own = view.data_folder or "not set"
    yield f"your own: any path, or files in the folder that {DATA_VARIABLE} names ({own})"


def _size(number: int | None) -> str:
    return "" if number is None else f"{number:,}"
