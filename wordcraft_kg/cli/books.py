"""``wordcraft-kg books``."""

from collections.abc import Iterator
from typing import TYPE_CHECKING

from wordcraft_kg.cli.console import Output

if TYPE_CHECKING:
    from wordcraft_kg.evaluation.books import BookList

EXAMPLES = ("wordcraft-kg books", "wordcraft-kg books --json")


def books(*, output: Output = Output()) -> None:
    """List the recipe books known by name: built in, in the cache or data folder, or available to fetch.

    A book's name works wherever a path of a recipe book does.
    """
    from wordcraft_kg.evaluation.books import view_books

    view = view_books()
    output.result(view, _text(view))


def _text(view: "BookList") -> Iterator[str]:
    from wordcraft_kg.graphs.library import DATA_VARIABLE

    width = max(len(book.name) for book in view.books)
    yield f"{'book':<{width}}  {'origin':<11}  {'entities':>8}  {'recipes':>9}"
    for book in view.books:
        place = "" if book.origin == "built in" else book.path or f"get it: wordcraft-kg fetch {book.name}"
        note = f"  ({book.note})" if book.note else ""
        sizes = ("" if size is None else f"{size:,}" for size in (book.entities, book.recipes))
        counts = "  ".join(f"{size:>{room}}" for size, room in zip(sizes, (8, 9), strict=True))
        yield f"{book.name:<{width}}  {book.origin:<11}  {counts}  {place}{note}".rstrip()
    folder = view.data_folder or "not set"
    yield f"your own: any path, or files in the folder that {DATA_VARIABLE} names ({folder})"
