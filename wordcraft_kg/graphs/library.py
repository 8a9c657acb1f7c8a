"""Recipe books with a name: built in, in the cache, in the user's data folder, or to download."""

import hashlib
import os
import re
import time
import urllib.request
from collections.abc import Iterator
from dataclasses import dataclass, replace
from http.client import HTTPException
from pathlib import Path
from typing import Any, NamedTuple

from wordcraft_kg.base.artefacts import sha256_of, write_atomically
from wordcraft_kg.base.errors import FetchError, RecipeFileError
from wordcraft_kg.base.progress import stage
from wordcraft_kg.base.settings import nearest
from wordcraft_kg.graphs.book_files import read_book
from wordcraft_kg.graphs.made_up import PREFIX, with_made_up_words
from wordcraft_kg.graphs.recipes import RecipeBook

DATA_VARIABLE = "WORDCRAFT_KG_DATA"
"""Environment variable for the data folder, which holds the user's recipe books."""
ENDINGS = (".csv", ".tsv", ".json")
_BUILT_IN = Path(__file__).parent / "books"
MADE_UP = re.compile(rf"{PREFIX}(?:-(\d+))?:(.+)")
"""Name of a book with invented words; groups: the seed, and the name or file of the original book."""
_SILENCE = 30  # seconds without a byte from the server
_DEADLINE = 300  # seconds for the whole download
_MAX_BYTES = 64 * 2**20


class _NoRedirects(urllib.request.HTTPRedirectHandler):
    """Refuses redirects: the address of a pinned file does not move."""

    def redirect_request(self, *arguments: Any) -> None:
        """Return no further request, so that the redirect is an error."""


@dataclass(frozen=True)
class _Fetchable:
    """A published book that may not be bundled; ``base`` has the base entities, which the file does not name."""

    url: str
    sha256: str
    file_name: str
    base: tuple[str, ...]
    note: str


FETCHABLE = {
    "little-alchemy-2": _Fetchable(
        url="https://raw.githubusercontent.com/minqi/wordcraft/a09887ad8bbfa5b3772b48c420f246919fe443ed"
        "/datasets/alchemy2.json",
        sha256="757422df36f8805b1a56c418e613c6418c905b0956e6f2fb3dff78569933d25d",
        file_name="alchemy2.json",
        base=("air", "earth", "fire", "time", "water"),
        note="no licence given by its authors; for your own use",
    )
}


class KnownBook(NamedTuple):
    """A recipe book's name, origin (built in, cache, data folder, to fetch) and path, None before the download."""

    name: str
    origin: str
    path: Path | None


class LocatedBook(NamedTuple):
    """A recipe book's file, and a known book's name and base entities."""

    path: Path
    name: str | None = None
    base: tuple[str, ...] | None = None


def data_folder() -> Path | None:
    """Return the folder for the user's recipe books in ``WORDCRAFT_KG_DATA``, None if unset."""
    value = os.environ.get(DATA_VARIABLE)
    if not value:
        return None
    return Path(value).parent if Path(value).is_file() else Path(value)


def cache_folder() -> Path:
    """Return the folder with downloaded books, in ~/.cache or ``XDG_CACHE_HOME``; the folder may not exist yet."""
    root = os.environ.get("XDG_CACHE_HOME")
    return (Path(root) if root else Path.home() / ".cache") / "wordcraft-kg" / "books"


def known_books() -> list[KnownBook]:
    """Return all recipe books with a name; for a repeated name, the book that :func:`open_book` opens."""
    books: dict[str, KnownBook] = {}
    for origin, folder in (
        ("built in", _BUILT_IN),
        ("cache", cache_folder()),
        ("data folder", data_folder()),
    ):
        for path in _books_in(folder):
            name = next(
                (name for name, book in FETCHABLE.items() if book.file_name == path.name), path.stem
            )
            books.setdefault(name, KnownBook(name, origin, path))
    for name in FETCHABLE:
        books.setdefault(name, KnownBook(name, "to fetch", None))
    return list(books.values())


def locate_book(name_or_path: str | Path) -> LocatedBook:
    """Find a book by path, else by name; RecipeFileError if unknown, changed, or not downloaded yet."""
    path = Path(name_or_path)
    if made_up := MADE_UP.fullmatch(str(name_or_path)):
        raise RecipeFileError(
            f"'{name_or_path}' has no file, because it is made from '{made_up[2]}'; give that book."
        )
    if path.is_file() or (path / "graph.json").is_file():
        return LocatedBook(path)
    books = {book.name: book for book in known_books()}
    if path.exists() and str(name_or_path) not in books:
        return LocatedBook(path)
    book = books.get(str(name_or_path))
    if book is None:
        raise RecipeFileError(
            f"'{name_or_path}' is neither a file nor a known book.{nearest(str(name_or_path), books)} "
            "`wordcraft-kg books` lists all known books."
        )
    if book.path is None:
        raise RecipeFileError(
            f"'{book.name}' is not on this machine yet. Fetch it: wordcraft-kg books --fetch {book.name}"
        )
    published = FETCHABLE.get(book.name)
    if published and sha256_of(book.path) != published.sha256:
        raise RecipeFileError(
            f"{book.path} is not the published '{book.name}' (its SHA-256 differs). "
            f"Fetch the book again, or give the path to use this file: {book.path}"
        )
    return LocatedBook(book.path, book.name, published.base if published else None)


def open_book(
    name_or_path: str | Path,
    *,
    keep_self_results: bool = False,
    single_ingredient: str | None = None,
) -> RecipeBook:
    """Read a recipe book by path or name, see :func:`locate_book` and :func:`read_book`.

    ``made-up:BOOK`` replaces all words by invented words, ``made-up-SEED:BOOK`` with another seed than 0; see
    :func:`~wordcraft_kg.graphs.made_up.with_made_up_words`.

    Example:
        >>> len(open_book("kitchen").recipes)
        326
    """
    if made_up := MADE_UP.fullmatch(str(name_or_path)):
        book = open_book(
            made_up[2], keep_self_results=keep_self_results, single_ingredient=single_ingredient
        )
        return with_made_up_words(book, int(made_up[1] or 0))
    located = locate_book(name_or_path)
    content = read_book(
        located.path,
        keep_self_results=keep_self_results,
        single_ingredient=single_ingredient,
        name=located.name,
    )
    return replace(content, base=located.base) if content.base is None else content


@stage("downloading")
def fetch_book(name: str) -> Path:
    """Download a published recipe book into the cache once, and return the path; FetchError if that fails."""
    book = FETCHABLE.get(name)
    if book is None:
        raise FetchError(
            f"no book '{name}' to fetch; expected one of {', '.join(FETCHABLE)}.{nearest(name, FETCHABLE)}"
        )
    return fetch_file(name, book.url, book.sha256, cache_folder() / book.file_name)


def fetch_file(name: str, url: str, sha256: str, target: Path) -> Path:
    """Download a published file with a pinned hash once to ``target``; FetchError if that fails."""
    if target.is_file() and sha256_of(target) == sha256:
        return target
    by_hand = f"Or place the file by hand: save {url} as {target}, or into the folder that {DATA_VARIABLE} names."
    try:
        data = _downloaded(url)
    except (OSError, HTTPException, ValueError) as error:
        reason = getattr(error, "reason", error)
        raise FetchError(
            f"could not download '{name}' ({reason}). Try again when online. {by_hand}"
        ) from None
    downloaded = hashlib.sha256(data).hexdigest()
    if downloaded != sha256:
        raise FetchError(
            f"the download of '{name}' has SHA-256 {downloaded[:12]}…, expected {sha256[:12]}…; not kept. {by_hand}"
        )
    target.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(target, data)
    return target


def _opened(url: str) -> Any:
    return urllib.request.build_opener(_NoRedirects).open(url, timeout=_SILENCE)


def _downloaded(url: str) -> bytes:
    ends, data = time.monotonic() + _DEADLINE, bytearray()
    with _opened(url) as response:
        while chunk := response.read1(2**16):
            data += chunk
            if len(data) > _MAX_BYTES:
                raise ValueError(f"more than {_MAX_BYTES:,} bytes")
            if time.monotonic() > ends:
                raise TimeoutError(f"not complete after {_DEADLINE} seconds")
    return bytes(data)


def _books_in(folder: Path | None) -> Iterator[Path]:
    if folder is not None and folder.is_dir():
        yield from sorted(path for path in folder.iterdir() if path.suffix in ENDINGS)
