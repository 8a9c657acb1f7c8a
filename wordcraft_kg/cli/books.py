"""``wordcraft-kg books``."""

import os
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.base.wording import counted
from wordcraft_kg.cli.console import Flag, Output, aligned
from wordcraft_kg.cli.options import FetchableBook
from wordcraft_kg.graphs.library import DATA_VARIABLE, FETCHABLE, cache_folder, fetch_book
from wordcraft_kg.graphs.library import clear_cache as clear_book_cache

if TYPE_CHECKING:
    from wordcraft_kg.evaluation.books import BookList

EXAMPLES = ("wordcraft-kg books", "wordcraft-kg books --fetch little-alchemy-2", "wordcraft-kg books --cache")

PYKEEN = "PyKEEN's own folder"


def books(
    *,
    fetch: FetchableBook = None,
    show_cache: Annotated[Flag, Parameter(name="--cache")] = False,
    clear_cache: Flag = False,
    output: Output = Output(),
) -> None:
    """List the recipe books known by name, download a published book, or manage the cache.

    Commands accept a book's name in place of a path.

    Args:
        fetch: book to download into the cache; the SHA-256 is checked.
        show_cache: list the cache folders with sizes.
        clear_cache: remove downloaded books; PyKEEN's folder is kept.
    """
    if (fetch is not None) + (show_cache or clear_cache) > 1:
        raise ConfigError("`fetch` cannot be combined with the cache options; leave out either.")
    if fetch is not None:
        path, book = fetch_book(fetch), FETCHABLE[fetch]
        values = {"book": fetch, "path": str(path), "sha256": book.sha256, "url": book.url, "note": book.note}
        output.result(values, [f"{fetch} is in {path} ({book.note})", f"next: wordcraft-kg build-graph {fetch}"])
    elif show_cache or clear_cache:
        _cache(clear_cache, output)
    else:
        from wordcraft_kg.evaluation.books import view_books

        view = view_books()
        output.result(view, _text(view))


def _text(view: "BookList") -> Iterator[str]:
    rows: list[tuple[str, ...]] = [("book", "origin", "entities", "recipes", "")]
    for book in view.books:
        place = "" if book.origin == "built in" else book.path or f"get it: wordcraft-kg books --fetch {book.name}"
        note = f"  ({book.note})" if book.note else ""
        sizes = ["" if size is None else f"{size:,}" for size in (book.entities, book.recipes)]
        rows.append((book.name, book.origin, *(f"{size:>8}" for size in sizes), f"{place}{note}".lstrip()))
    yield from aligned(rows)
    yield "with invented words: made-up:BOOK, such as made-up:everyday; made-up-3:BOOK with seed 3"
    yield f"your own: any path, or files in the folder that {DATA_VARIABLE} names ({view.data_folder or 'not set'})"


def _cache(clear: bool, output: Output) -> None:
    from rich.filesize import decimal

    if clear:
        clear_book_cache()
    places = {
        "fetched recipe books": cache_folder(),
        PYKEEN: Path(os.environ.get("PYSTOW_HOME") or Path.home() / ".data") / "pykeen",
    }
    folders: list[dict[str, Any]] = []
    for holds, folder in places.items():
        sizes = [path.stat().st_size for path in folder.rglob("*") if path.is_file()]
        counts = {"files": len(sizes), "bytes": sum(sizes)}
        folders.append({"holds": holds, "path": str(folder), **counts, "is_ours": holds != PYKEEN})
    rows = ((one["holds"], f"{counted(one['files'], 'file')}, {decimal(one['bytes'])}", one["path"]) for one in folders)
    text = [*aligned(rows), *(["cleared all but PyKEEN's"] if clear else [])]
    output.result({"folders": folders, "cleared": clear}, text)
