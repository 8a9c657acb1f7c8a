"""The bytes and the text of a recipe book: files and folders, gzip and zip, encodings, JSON.

Nothing is unpacked to the disk. Files that cannot be recipe books are named by their first bytes.
No encoding is guessed: many fit the same bytes, and give other labels.
"""

import codecs
import hashlib
import io
import json
import re
import stat
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path, PurePosixPath
from typing import Any

from wordcraft_kg.base import ConfigError, RecipeFileError, for_terminal, what_is
from wordcraft_kg.base.artefacts import ZipArchive, gunzip, is_gzip, is_zip
from wordcraft_kg.graphs.book_files.rows import GUIDE, refusal

MAX_BOOK_SIZE = 2**30
"""Largest file that is read, in bytes, also after decompression; about 40 million recipes."""
_MAX_FILES = 100_000
MAX_FILE = 2**20
"""Largest file of one recipe, in bytes."""
_TEXT_ENDINGS = (".csv", ".tsv", ".tab", ".txt", ".md", ".json", ".jsonl", ".ndjson", ".ic")
_SIGNATURES = {
    b"SQLite format 3\x00": "an SQLite database; export its table of recipes as CSV",
    b"PAR1": "a Parquet file; save it as CSV",
    b"%PDF": "a PDF document",
    b"\x89PNG": "an image",
    b"\xff\xd8\xff": "an image",
    b"GIF8": "an image",
    b"\x1f\x8b": "compressed twice",
    b"PK\x03\x04": "an archive within an archive",
    b"BZh": "compressed with bzip2; decompress it, or use gzip",
    b"\xfd7zXZ": "compressed with xz; decompress it, or use gzip",
    b"\x28\xb5\x2f\xfd": "compressed with zstd; decompress it, or use gzip",
    b"7z\xbc\xaf": "a 7z archive; unpack it, or use zip",
    b"Rar!": "a RAR archive; unpack it, or use zip",
    b"\xd0\xcf\x11\xe0": "an old Office document; save the sheet as CSV",
    b"\x93NUMPY": "a NumPy array",
    b"\x7fELF": "a program",
}


@dataclass(frozen=True)
class Content:
    """A file's text, or the files of a data pack.

    Attributes:
        name: file name that stands for the content, such as ``book.csv`` for ``book.csv.gz``.
        sha256: hash of the file, or of the names and bytes of a folder's files.
        container: compression or archive around it, for people; empty without one.
        pack: names and bytes of the JSON files of a data pack; None for any other file.
        text: the text, without a byte order mark; empty for a data pack.
        encoding: name of its encoding; empty for a data pack.
    """

    name: str
    sha256: str
    container: str = ""
    pack: tuple[tuple[str, bytes], ...] | None = None
    text: str = ""
    encoding: str = ""


def read_bytes(path: Path) -> bytes:
    """Read a file's bytes.

    Args:
        path: a regular file; a device or a pipe might never end.

    Raises:
        RecipeFileError: if it is missing, too large, unreadable or no regular file.
    """
    if path.is_dir():
        raise RecipeFileError(
            f"'{path}' {what_is(path)}; expected a recipe book (.csv, .tsv, .json), a graph "
            "folder, or a folder of Minecraft recipes."
        )
    try:
        if path.exists():
            if not path.is_file():
                raise RecipeFileError(
                    f"{path} is not a regular file; give a recipe book (.csv, .tsv, .json)."
                )
            size = path.stat().st_size
            if size > MAX_BOOK_SIZE:
                raise RecipeFileError(f"{path} has {size:,} bytes; the limit is {MAX_BOOK_SIZE:,}.")
        return path.read_bytes()
    except FileNotFoundError:
        raise RecipeFileError(
            f"{path} does not exist. `wordcraft-kg books` lists the books known by name."
        ) from None
    except OSError as error:
        raise RecipeFileError(f"{path} cannot be read: {error.strerror}.") from None


def read_content(path: Path, encoding: str | None = None) -> Content:
    """Read a file or folder, out of gzip or an archive with one book if it is in one.

    Args:
        path: a file, or a folder of a data pack.
        encoding: the encoding, one that :func:`check_encoding` accepts; None for that of a byte
            order mark, or UTF-8.

    Raises:
        RecipeFileError: if it cannot be read or decoded, for other compressed or binary files,
            which it names, for a damaged or encrypted archive, for an archive without one book, and
            for data that expand too much.
    """
    if path.is_dir():
        files = tuple(_folder_files(path))
        if any(map(_is_recipe_file, dict(files))):
            sums = [f"{hashlib.sha256(content).hexdigest()}  {name}\n" for name, content in files]
            sha256 = hashlib.sha256("".join(sums).encode()).hexdigest()
            return Content(path.name, sha256, pack=files)
    data = read_bytes(path)
    name, container, sha256 = path.name, "", hashlib.sha256(data).hexdigest()
    if is_zip(data):
        archive = ZipArchive(path, data, _error)
        names = _names_of_files(path, archive)
        if _is_pack(names):
            members = [name for name in sorted(names) if _is_pack_file(name)]
            pack = tuple((name, archive.read(name, MAX_FILE)) for name in members)
            return Content(name, sha256, "zip", pack)
        books = list(filter(_may_be_book, names))
        if len(books) != 1:
            shown = ", ".join(repr(name[:80]) for name in books[:5]) or "none"
            problem = f"a zip archive with {len(books):,} files that may be recipe books ({shown})"
            raise refusal(
                path, f"{problem}; expected one", "compressed", "Unpack it and give one file."
            )
        data = archive.read(books[0], MAX_BOOK_SIZE)
        container = f"zip ({books[0]})"
        name = PurePosixPath(books[0]).name
    # By its first bytes, also within an archive: names are often wrong.
    if is_gzip(data):
        data = gunzip(path, data, MAX_BOOK_SIZE, _error)
        container = f"{container}, gzip".removeprefix(", ")
        name = re.sub(r"\.g(?:z|zip)$", "", name, flags=re.IGNORECASE)
    for signature, kind in _SIGNATURES.items():
        if data.startswith(signature):
            raise refusal(path, f"it is {kind}", "table")
    text, used_encoding = _decode(path, data, encoding)
    return Content(name, sha256, container, None, text, used_encoding)


def _error(message: str) -> RecipeFileError:
    return RecipeFileError(f"{message} See {GUIDE}#compressed.")


def _is_pack(names: Sequence[str]) -> bool:
    """Return whether an archive is that of a data pack, by the names of its files."""
    recipes = list(filter(_is_recipe_file, names))
    # A single file in a folder called recipes may be a recipe book.
    return len(recipes) > 1 or any("data" in PurePosixPath(name).parts for name in recipes)


def _is_recipe_file(name: str) -> bool:
    """Return whether a path is that of a recipe in a data pack: a JSON file below ``recipe(s)``."""
    folders = PurePosixPath(name).parts[:-1]
    is_recipe = not {"recipe", "recipes"}.isdisjoint(folders) and "tags" not in folders
    return is_recipe and name.lower().endswith(".json")


def _is_pack_file(name: str) -> bool:
    is_tag = "tags" in PurePosixPath(name).parts[:-1] and name.lower().endswith(".json")
    return is_tag or _is_recipe_file(name)


def _may_be_book(name: str) -> bool:
    lower = name.lower().removesuffix(".gz")
    return lower.endswith(_TEXT_ENDINGS) and "readme" not in lower and "license" not in lower


def _names_of_files(path: Path, archive: ZipArchive) -> list[str]:
    """Return the names of the files in an archive that may be content."""
    if "[Content_Types].xml" in archive.members or "mimetype" in archive.members:
        raise refusal(
            path, "a spreadsheet or document, not a text file", "table", "Save the sheet as CSV."
        )
    names = []
    for name, entry in archive.members.items():
        parts = PurePosixPath(name).parts
        # A link's content is a path; following it could lead out of the archive.
        is_link = stat.S_ISLNK(entry.external_attr >> 16)
        if is_link or ".." in parts or PurePosixPath(name).is_absolute():
            member_kind = "a link" if is_link else "a path that leads out of it"
            raise refusal(path, f"the archive holds {member_kind}, {name[:80]!r}", "compressed")
        # Finder's copies and dotfiles are no content.
        is_hidden = any(part.startswith((".", "__MACOSX")) for part in parts)
        if not entry.is_dir() and not is_hidden:
            names.append(name)
    return names


def _folder_files(folder: Path) -> Iterator[tuple[str, bytes]]:
    """Yield names and bytes of the files of a data pack below a folder; links are not followed.

    Raises:
        RecipeFileError: for too many files, as below a folder that was meant to be another, and for
            a file that cannot be read, or is too large for one recipe.
    """
    # Below a folder called recipes each JSON file is a recipe.
    prefix = "recipes/" if folder.name in ("recipe", "recipes") else ""
    number = 0
    for path in sorted(folder.rglob("*.json")):
        name = prefix + path.relative_to(folder).as_posix()
        is_hidden = any(part.startswith(".") for part in PurePosixPath(name).parts[:-1])
        # A pipe would be waited for without end.
        if is_hidden or not _is_pack_file(name) or not path.is_file() or path.is_symlink():
            continue
        number += 1
        if number > _MAX_FILES:
            raise RecipeFileError(f"{folder}: more than {_MAX_FILES:,} recipe files.")
        if path.stat().st_size > MAX_FILE:
            raise RecipeFileError(f"{path}: more than {MAX_FILE:,} bytes for one recipe.")
        yield name, read_bytes(path)


# --- text ----------------------------------------------------------------------------------------

_MARKS = {
    codecs.BOM_UTF8: "utf-8",
    codecs.BOM_UTF16_LE: "utf-16",
    codecs.BOM_UTF16_BE: "utf-16",
}


_NOT_OF_FILES = frozenset(
    {"punycode", "idna", "unicode_escape", "raw_unicode_escape", "undefined", "mbcs", "oem"}
    | {"unicode-escape", "raw-unicode-escape"}
)
"""Python's encodings of names and source code, not of files."""


def check_encoding(encoding: str | None) -> None:
    """Check that Python knows a text encoding.

    Args:
        encoding: its name; None, for UTF-8 or the encoding of a mark, is always right.

    Raises:
        ConfigError: if it does not, or the encoding is one of names or source code, not of files.
    """
    name = encoding or "utf-8"
    try:
        " ".encode(name)
        is_known = codecs.lookup(name).name not in _NOT_OF_FILES
    except (LookupError, ValueError):
        is_known = False
    if not is_known:
        raise ConfigError(
            f"`encoding` {encoding!r}: expected an encoding that Python knows, such as utf-8, "
            "cp1252 or shift_jis."
        )


def _decode(path: Path, data: bytes, encoding: str | None) -> tuple[str, str]:
    """Return a file's text, without a byte order mark, and its encoding.

    Args:
        path: the file, for errors.
        data: the bytes.
        encoding: the encoding; None for that of a byte order mark, or UTF-8.

    Raises:
        RecipeFileError: for an empty or binary file, and for bytes that do not fit the encoding.
            The message shows the first such line as another encoding reads it.
    """
    mark = next((mark for mark in _MARKS if data.startswith(mark)), b"")
    marked = _MARKS.get(mark, "")
    name = codecs.lookup(encoding or marked or "utf-8").name.removesuffix("-sig")
    if not name.startswith(marked):
        problem = f"it begins with the byte order mark of {marked}, and `encoding` is {encoding}"
        raise refusal(path, problem, "encodings", "Leave --encoding out.")
    if name == "utf-8" and b"\x00" in data:
        problem = "a binary file (it holds zero bytes), not text"
        remedy = "If it is text in UTF-16, name it with --encoding utf-16-le."
        raise refusal(path, problem, "encodings", remedy)
    try:
        text = data.decode(name).removeprefix("\ufeff")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        line_start = data.rfind(b"\n", 0, error.start) + 1
        around = data[line_start : error.start + 30].decode("cp1252", errors="replace")
        shown = for_terminal(around.splitlines()[0][:60])
        problem = (
            f"line {line} is not {name.replace('utf', 'UTF')} (byte 0x{data[error.start]:02x}); as "
            f"cp1252 it begins {shown!r}"
        )
        remedy = "Name the file's encoding, such as --encoding cp1252, or save the file as UTF-8."
        raise refusal(path, problem, "encodings", remedy) from None
    if text.startswith("\ufeff"):
        raise refusal(path, "two byte order marks", "encodings", "Remove them.")
    if not text.strip():
        raise RecipeFileError(f"{path} is empty; a recipe book needs at least one recipe.")
    return text, name


# --- JSON ----------------------------------------------------------------------------------------

_START = re.compile(r'\s*(?:[\[{]\s*)+"')
"""Brackets before a text in quotes, as at the start of lists of labels and of objects."""


def is_json(text: str) -> bool:
    """Return whether a text begins as JSON does, whatever its file's ending."""
    return _START.match(text) is not None


def load_json(path: Path, text: str) -> tuple[Any, bool]:
    """Parse JSON, or JSON lines as a list.

    Args:
        path: the file, for errors.
        text: the whole text.

    Returns:
        The value, and whether it was JSON lines.

    Raises:
        RecipeFileError: if it is neither, with the line of the first fault; or for JSON that no
            book can be, such as an object with a key twice.
    """
    first, *further_lines = islice(filter(str.strip, io.StringIO(text)), 2)
    try:
        is_lines = bool(further_lines) and isinstance(json.loads(first), dict | list)
    except (ValueError, RecursionError):
        is_lines = False
    if not is_lines:
        return parsed_json(path, text), False
    # Only line feeds: other separators, such as U+2028, may stand in a text.
    lines = enumerate(text.split("\n"), start=1)
    return [parsed_json(path, line, number) for number, line in lines if line.strip()], True


def parsed_json(path: Path | str, text: str | bytes, line: int | None = None) -> Any:
    """Parse one JSON value; an object with a key twice is refused, where Python drops the first.

    Args:
        path: the file, for errors.
        text: the value; bytes may begin with a byte order mark.
        line: number of the text's line in the file; None for a text that is the whole file.

    Raises:
        RecipeFileError: if it is not JSON, with the line; or for JSON that no book can be, such as
            an object with a key twice.
    """
    try:
        return json.loads(text, object_pairs_hook=without_repeated_keys)
    except json.JSONDecodeError as error:
        position = f"line {line or error.lineno}, column {error.colno}"
        raise RecipeFileError(f"{path}, {position}: not JSON ({error.msg}).") from None
    except RecursionError:
        raise RecipeFileError(f"{path}: nested too deeply for a recipe book.") from None
    except ValueError as error:  # such as a number of thousands of digits, or another encoding
        raise RecipeFileError(f"{path}: not a recipe book ({error}).") from None


def without_repeated_keys(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """Return a JSON object, for ``object_pairs_hook``.

    Args:
        pairs: keys and values of the object.

    Raises:
        ValueError: if a key occurs twice.
    """
    value = dict(pairs)
    if len(value) < len(pairs):
        counts = Counter(key for key, _ in pairs)
        repeated = next(key for key in value if counts[key] > 1)
        raise ValueError(f"the key '{repeated}' occurs twice in one object")
    return value
