"""``wordcraft-kg fetch``."""

from wordcraft_kg.cli.completion import FetchableBook
from wordcraft_kg.cli.console import Output

EXAMPLES = ("wordcraft-kg fetch little-alchemy-2", "wordcraft-kg fetch little-alchemy-2 --json")


def fetch(book: FetchableBook, *, output: Output = Output()) -> None:
    """Download a published recipe book into the cache, checked against its pinned SHA-256.

    Args:
        book: name of a book that `wordcraft-kg books` lists as available to fetch.
    """
    from wordcraft_kg.graphs.library import FETCHABLE, fetch_book

    path = fetch_book(book)
    known = FETCHABLE[book]
    output.result(
        {"book": book, "path": str(path), "sha256": known.sha256, "url": known.url, "note": known.note},
        [f"{book} is in {path} ({known.note})", f"next: wordcraft-kg build-graph {book}"],
    )
