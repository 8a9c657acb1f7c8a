"""Recipe books with a name: built in, in the cache, in the user's data folder, or to download.

A built-in book is a file in the folder ``books``; a book to download is an entry of
:data:`FETCHABLE`, with a pinned SHA-256.
"""

import hashlib
import os
import re
import time
import urllib.request
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial
from hashlib import sha256
from http.client import HTTPException
from itertools import chain
from pathlib import Path
from typing import NamedTuple, Unpack

import numpy as np

from wordcraft_kg.base import (
    RecipeFileError,
    made_folder,
    nearest,
    sha256_of,
    stage,
    write_atomically,
)
from wordcraft_kg.base.errors import FetchError
from wordcraft_kg.graphs.book_files import ReadOptions, read_book
from wordcraft_kg.graphs.recipes import Recipe, RecipeBook

PREFIX = "made-up"
_STARTS = [
    "b",
    "d",
    "f",
    "g",
    "k",
    "l",
    "m",
    "n",
    "p",
    "r",
    "s",
    "t",
    "v",
    "z",
    "br",
    "dr",
    "gl",
    "kr",
    "pl",
    "tr",
]
_VOWELS = ["a", "e", "i", "o", "u"]
_ENDS = ["k", "l", "m", "n", "p", "r", "t", "x"]


def with_made_up_words(book: RecipeBook, seed: int = 0) -> RecipeBook:
    """Return a copy of a book in which each word of the labels is an invented, pronounceable word.

    A word gets the same replacement in all labels, so that the last words of "cake" and "birthday
    cake" stay equal. The invented words have the alphabetical order of the words, so that entity
    ids, splits and tasks stay the same. No invented word is a word of the book. Kinds of recipes
    and base entities stay.

    Args:
        book: the book.
        seed: random seed, from 0; another seed gives other words.

    Example:
        >>> print(with_made_up_words(open_book("kitchen")).recipes[0])
        betgegil + lenkrodim -> siksevan
    """
    words = set(chain.from_iterable(map(str.split, book.entities)))
    ordered_words = sorted(words)
    # The words are part of the seed, so that two books do not share invented words.
    digest = sha256("\n".join(ordered_words).encode()).digest()
    rng = np.random.default_rng([seed, *digest])
    # 64 million words with three syllables.
    letters = (_STARTS, _VOWELS, _ENDS, _STARTS, _VOWELS, _STARTS, _VOWELS, _ENDS)
    invented: set[str] = set()
    while len(invented) < len(words):
        word = "".join(str(rng.choice(choices)) for choices in letters)
        if word not in words:
            invented.add(word)
    # Both sorted: the n-th word in the alphabet becomes the n-th invented word.
    replacement = dict(zip(ordered_words, sorted(invented), strict=True))

    def renamed(label: str) -> str:
        return re.sub(r"\S+", lambda word: replacement[word[0]], label)

    recipe_of = {recipe: Recipe.of(*map(renamed, recipe)) for recipe in book.recipes}
    hash_of_book = None
    if book.sha256 is not None:
        # Another book than the original, so another hash; the same for the same original and seed.
        hash_of_book = sha256(f"{PREFIX} {seed} {book.sha256}".encode()).hexdigest()
    return replace(
        book,
        name=f"{PREFIX}-{seed}-{book.name}" if seed else f"{PREFIX}-{book.name}",
        recipes=tuple(sorted(recipe_of.values())),
        base=None if book.base is None else tuple(sorted(map(renamed, book.base))),
        idle=tuple(sorted(map(renamed, book.idle))),
        sha256=hash_of_book,
        kinds={recipe_of[recipe]: kind for recipe, kind in book.kinds.items()},
        quantities={recipe_of[recipe]: numbers for recipe, numbers in book.quantities.items()},
    )


DATA_VARIABLE = "WORDCRAFT_KG_DATA"
"""Environment variable for the data folder, which holds the user's recipe books."""
ENDINGS = (".csv", ".tsv", ".json")
_BUILT_IN = Path(__file__).parent / "books"
MADE_UP = re.compile(rf"{PREFIX}(?:-(\d+))?:(.+)")
"""Name of a book with invented words; groups: the seed, and the original book's name or file."""
_SILENCE = 30  # seconds without a byte from the server
_LONGEST = 600  # seconds of a download
_MAX_BYTES = 64 * 2**20  # of a download


@dataclass(frozen=True)
class _PublishedFile:
    """A published file, such as a split of a book.

    Attributes:
        url: address of the file at a fixed commit.
        sha256: hash of the file's bytes.
        file_name: path in the cache and in data folders, with forward slashes.
    """

    url: str
    sha256: str
    file_name: str


@dataclass(frozen=True)
class _Fetchable(_PublishedFile):
    """A published book that is not bundled: without a licence, or with words of others.

    Attributes:
        base: labels of the base entities, which the file does not name; None for the entities
            that no recipe makes.
        note: licence, for the list of books.
        columns: where the file has ingredients and results, if it has no documented words.
        folds: published splits; ``--split fold-1`` names the first.
    """

    base: tuple[str, ...] | None
    note: str
    columns: tuple[str, ...] | None = None
    folds: tuple[_PublishedFile, ...] = ()


_SYNTHESIS = (
    "https://raw.githubusercontent.com/jschrier/SynthGPT/"
    "24f82b61bd181dc0d722551859e275b2a1cc5f6b/data/cross_validation/random_cv{}.json"
)
_SYNTHESIS_FOLDS = (
    "18c87497f598856ab4d73f0ab5dfcf8b50a46358a70042f31d8e9691180f1f75",
    "9df633436b7074098cd070f44ca88337868396e7a4e2b37192654c236c215086",
    "d2fd830c5fcebfeb4c38aaea37d24ddad738af79e056dc8f61f83e9b89c48387",
    "428fc3a4cb7612e469c88eb18145fec5f23906986f810ccd20ece778a621d7fa",
    "410583dd73121f5b659869077271f073046b732bde49043593a28530e69dbcd8",
)

FETCHABLE = {
    "little-alchemy-2": _Fetchable(
        url="https://raw.githubusercontent.com/minqi/wordcraft/"
        "a09887ad8bbfa5b3772b48c420f246919fe443ed/datasets/alchemy2.json",
        sha256="757422df36f8805b1a56c418e613c6418c905b0956e6f2fb3dff78569933d25d",
        file_name="alchemy2.json",
        base=("air", "earth", "fire", "time", "water"),
        note="no licence given by its authors; for your own use",
    ),
    # In a folder of its own: `recipes.json` alone may be anything.
    "infinite-craft": _Fetchable(
        url="https://raw.githubusercontent.com/onnowhere/infinite-craft-recipe-search/"
        "5c94d576129c1311292bb4111adcda9d7efa286f/recipes.json",
        sha256="84754393c5a44e8e1a32d70b9230ec0cdd7f01c75c72e58c74b41353296265b3",
        file_name="infinite_craft/recipes.json",
        base=("Earth", "Fire", "Water", "Wind"),
        note="collection under MIT; its words were written by the language model of the game",
    ),
    # Each fold holds all recipes: the first is also the book.
    "inorganic-synthesis": _Fetchable(
        url=_SYNTHESIS.format(1),
        sha256=_SYNTHESIS_FOLDS[0],
        file_name="synthesis/random_cv1.json",
        base=None,
        note="precursors of inorganic materials, text-mined from articles; MIT",
        columns=("{}{}[][]", "{}{key}"),
        folds=tuple(
            _PublishedFile(_SYNTHESIS.format(fold), sha256, f"synthesis/random_cv{fold}.json")
            for fold, sha256 in enumerate(_SYNTHESIS_FOLDS, 1)
        ),
    ),
}


class KnownBook(NamedTuple):
    """A recipe book with a name.

    Attributes:
        name: the name.
        origin: built in, cache, data folder or to fetch.
        path: the file; None before the download.
    """

    name: str
    origin: str
    path: Path | None


class LocatedBook(NamedTuple):
    """A recipe book's file.

    Attributes:
        path: the file, or a graph folder.
        name: name of a known book; None for a path.
        base: labels of the base entities of a published book; None if the file decides.
        columns: where a published book has ingredients and results; None if the file tells.
    """

    path: Path
    name: str | None = None
    base: tuple[str, ...] | None = None
    columns: tuple[str, ...] | None = None


def data_folder() -> Path | None:
    """Return the folder for the user's recipe books, from ``WORDCRAFT_KG_DATA``; None if unset.

    The variable may also name a file in the folder.
    """
    value = os.environ.get(DATA_VARIABLE)
    if not value:
        return None
    return Path(value).parent if Path(value).is_file() else Path(value)


def cache_folder() -> Path:
    """Return the folder with downloaded books; it may not exist yet.

    It is in ``XDG_CACHE_HOME``, by default ``~/.cache``.
    """
    root = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(root) / "wordcraft-kg" / "books"


def known_books() -> list[KnownBook]:
    """Return all recipe books with a name.

    Of a repeated name, the book that :func:`open_book` opens: the built-in book, else the
    downloaded one.
    """
    books: dict[str, KnownBook] = {}
    published = {book.file_name: name for name, book in FETCHABLE.items()}
    folders = {"built in": _BUILT_IN, "cache": cache_folder(), "data folder": data_folder()}
    for origin, folder in folders.items():
        if folder is None:
            continue
        for path in _books_in(folder):
            name = published.get(path.relative_to(folder).as_posix(), path.stem)
            books.setdefault(name, KnownBook(name, origin, path))
    for name in FETCHABLE:
        books.setdefault(name, KnownBook(name, "to fetch", None))
    return list(books.values())


def without_prefix(source: str) -> tuple[str, str]:
    """Split the name of a book with invented words into its prefix and the original's name.

    Example:
        >>> without_prefix("made-up-5:book.csv"), without_prefix("book.csv")
        (('made-up-5:', 'book.csv'), ('', 'book.csv'))
    """
    match = MADE_UP.fullmatch(source)
    if match is None:
        return "", source
    original = match[2]
    return source.removesuffix(original), original


def locate_book(name_or_path: str | Path) -> LocatedBook:
    """Find a book by path, else by name.

    Raises:
        RecipeFileError: if there is no such book, or a published book is not downloaded yet or
            differs from the published file.
    """
    path = Path(name_or_path)
    prefix, original = without_prefix(str(name_or_path))
    if prefix:
        raise RecipeFileError(
            f"'{name_or_path}' has no file, because it is made from '{original}'; give that book."
        )
    books = {book.name: book for book in known_books()}
    book = books.get(str(name_or_path))
    # A file or graph folder of this path takes precedence over a book's name. Any other folder
    # gives way to a book of its name, such as a run folder named kitchen.
    is_book = path.is_file() or (path / "graph.json").is_file()
    if is_book or (path.exists() and book is None):
        return LocatedBook(path)
    if book is None:
        hint = nearest(str(name_or_path), books)
        raise RecipeFileError(
            f"'{name_or_path}' is neither a file nor a known book.{hint} "
            "`wordcraft-kg books` lists all known books."
        )
    if book.path is None:
        raise RecipeFileError(
            f"'{book.name}' is not on this machine yet. "
            f"Fetch it: wordcraft-kg books --fetch {book.name}"
        )
    published = FETCHABLE.get(book.name)
    # Results with another file would be compared with the literature under the same name.
    if published and sha256_of(book.path) != published.sha256:
        raise RecipeFileError(
            f"{book.path} is not the published '{book.name}' (its SHA-256 differs). "
            f"Fetch the book again, or give the path to use this file: {book.path}"
        )
    if published is None:
        return LocatedBook(book.path, book.name)
    return LocatedBook(book.path, book.name, published.base, published.columns)


def published_fold(book: str, name: str) -> Path | None:
    """Return the file of a book's published split, such as ``fold-1``; None for any other name.

    Raises:
        RecipeFileError: if the file is not on this machine, or not the published one.
    """
    published = FETCHABLE.get(book)
    folds = published.folds if published else ()
    by_name = {f"fold-{number}": fold for number, fold in enumerate(folds, 1)}
    fold = by_name.get(name)
    if fold is None:
        return None
    path = _placed(fold)
    if path is None:
        raise RecipeFileError(
            f"{name} of '{book}' is not on this machine yet, or is another file. "
            f"Fetch it: wordcraft-kg books --fetch {book}"
        )
    return path


def _placed(file: _PublishedFile) -> Path | None:
    """Return where a published file lies: in the cache, else in the data folder.

    None if neither has it, or it is another file.
    """
    for folder in filter(None, (cache_folder(), data_folder())):
        path = folder / file.file_name
        if path.is_file():
            # Books are opened from the cache first, even if another file lies there.
            return path if sha256_of(path) == file.sha256 else None
    return None


def open_book(
    name_or_path: str | Path,
    *,
    keep_self_results: bool = False,
    **options: Unpack[ReadOptions],
) -> RecipeBook:
    """Read a recipe book by path or name.

    Args:
        name_or_path: a file, a graph folder, or the name of a known book, see :func:`known_books`.
            ``made-up:BOOK`` replaces all words by invented words, ``made-up-SEED:BOOK`` with
            another seed than 0; see :func:`with_made_up_words`.
        keep_self_results: see :func:`~wordcraft_kg.graphs.book_files.read_book`.
        options: what a user says about the file, such as ``columns``, see
            :class:`~wordcraft_kg.graphs.book_files.BookOptions`.

    Raises:
        RecipeFileError: if there is no such book, or it cannot be read.

    Example:
        >>> len(open_book("kitchen").recipes)
        326
    """
    made_up = MADE_UP.fullmatch(str(name_or_path))
    if made_up:
        seed, original = made_up.groups()
        book = open_book(original, keep_self_results=keep_self_results, **options)
        return with_made_up_words(book, int(seed or 0))
    located = locate_book(name_or_path)
    # A user's own columns take precedence.
    if located.columns and not options.get("columns"):
        options["columns"] = list(located.columns)
    content = read_book(
        located.path,
        keep_self_results=keep_self_results,
        name=located.name,
        **options,
    )
    # The published file names no base; a file that does keeps its own.
    return replace(content, base=located.base) if content.base is None else content


@stage("downloading")
def fetch_book(name: str) -> Path:
    """Download a published recipe book into the cache, once.

    A published file in the data folder is used as it is.

    Returns:
        Path of the file.

    Raises:
        FetchError: if the name is unknown, the download fails, or the file is not the published
            one. Nothing is kept then, and the message says how to place the file by hand.
    """
    book = FETCHABLE.get(name)
    if book is None:
        hint = nearest(name, FETCHABLE)
        raise FetchError(
            f"no book '{name}' to fetch; expected one of {', '.join(FETCHABLE)}.{hint}"
        )
    for file in (*book.folds, book):
        # A damaged or outdated download is fetched again.
        path = _placed(file) or fetch_file(
            name, file.url, file.sha256, cache_folder() / file.file_name, file.file_name
        )
    return path


def fetch_file(
    name: str,
    url: str,
    sha256: str,
    target: Path,
    file_name: str | None = None,
) -> Path:
    """Download a published file with a pinned hash.

    Args:
        name: name of the file, for errors.
        url: address.
        sha256: expected hash of the bytes: the content is trusted, whatever the server.
        target: file to write.
        file_name: path in the data folder, for errors; None for the name of ``target``.

    Returns:
        ``target``.

    Raises:
        FetchError: if the download fails or has another hash; nothing is kept then.
    """
    by_hand = (
        f"Or place the file by hand: save {url} as {target}, "
        f"or as {file_name or target.name} into the folder that {DATA_VARIABLE} names."
    )
    try:
        with urllib.request.urlopen(url, timeout=_SILENCE) as response:
            begin = time.monotonic()
            data = bytearray()
            # Each piece as it comes: a server that sends a byte now and then has an end, too.
            for piece in iter(partial(response.read1, 2**16), b""):
                data += piece
                if len(data) > _MAX_BYTES or time.monotonic() - begin > _LONGEST:
                    raise TimeoutError(f"more than {_MAX_BYTES:,} bytes or {_LONGEST} seconds")
    except (OSError, HTTPException) as error:
        reason = getattr(error, "reason", error)
        raise FetchError(
            f"could not download '{name}' ({reason}). Try again when online. {by_hand}"
        ) from None
    downloaded = hashlib.sha256(data).hexdigest()
    if downloaded != sha256:
        raise FetchError(
            f"the download of '{name}' has SHA-256 {downloaded[:12]}…, "
            f"expected {sha256[:12]}…; not kept. {by_hand}"
        )
    with made_folder(target.parent):
        write_atomically(target, bytes(data))
    return target


def _books_in(folder: Path) -> Iterator[Path]:
    if folder.is_dir():
        yield from sorted(path for path in folder.iterdir() if path.suffix in ENDINGS)
        in_folders = [folder / book.file_name for book in FETCHABLE.values()]
        yield from (path for path in in_folders if path.parent != folder and path.is_file())
