"""The bytes of a recipe book: from a file, gzip or an archive; nothing is unpacked to disk."""

import hashlib
import os
import re
import stat
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from wordcraft_kg.base.archives import ZipArchive, gunzip, is_gzip, is_zip
from wordcraft_kg.base.artefacts import what_is
from wordcraft_kg.base.errors import RecipeFileError
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
    """A file's bytes.

    Attributes:
        name: file name that stands for the content, such as ``book.csv`` for ``book.csv.gz``.
        data: the bytes, decompressed; empty for a data pack.
        sha256: hash of the file, or of the names and bytes of a folder's files.
        container: compression or archive around it, for people; empty without one.
        pack: names and bytes of the JSON files of a data pack; None for any other file.
    """

    name: str
    data: bytes
    sha256: str
    container: str = ""
    pack: tuple[tuple[str, bytes], ...] | None = None


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


def read_content(path: Path) -> Content:
    """Read a file or folder, out of gzip or an archive with one book if it is in one.

    Args:
        path: a file, or a folder of a data pack.

    Raises:
        RecipeFileError: if it cannot be read, for other compressed or binary files, which it names,
            for a damaged or encrypted archive, for an archive without one book, and for data that
            expand too much.
    """
    if path.is_dir():
        files = tuple(_folder_files(path))
        if any(map(_is_recipe_file, dict(files))):
            sums = [f"{hashlib.sha256(each).hexdigest()}  {name}\n" for name, each in files]
            sha256 = hashlib.sha256("".join(sums).encode()).hexdigest()
            return Content(path.name, b"", sha256, pack=files)
    data = read_bytes(path)
    name, container, sha256 = path.name, "", hashlib.sha256(data).hexdigest()
    if is_zip(data):
        archive = ZipArchive(path, data, _error)
        names = _names_of_files(path, archive)
        if _is_pack(names):
            members = [name for name in sorted(names) if _is_pack_file(name)]
            pack = tuple((name, archive.read(name, MAX_FILE)) for name in members)
            return Content(name, b"", sha256, "zip", pack)
        books = list(filter(_may_be_book, names))
        if len(books) != 1:
            shown = ", ".join(repr(name[:80]) for name in books[:5]) or "none"
            seen = f"a zip archive with {len(books):,} files that may be recipe books ({shown})"
            remedy = "Unpack it and give one file."
            raise refusal(path, f"{seen}; expected one", "compressed", remedy)
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
    return Content(name, data, sha256, container)


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
        seen = "a spreadsheet or document, not a text file"
        raise refusal(path, seen, "table", "Save the sheet as CSV.")
    names = []
    for name, entry in archive.members.items():
        parts = PurePosixPath(name).parts
        # A link's content is a path; following it could lead out of the archive.
        is_link = stat.S_ISLNK(entry.external_attr >> 16)
        if is_link or ".." in parts or PurePosixPath(name).is_absolute():
            what = "a link" if is_link else "a path that leads out of it"
            raise refusal(path, f"the archive holds {what}, {name[:80]!r}", "compressed")
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
    for parent, folders, files in os.walk(folder):
        folders[:] = sorted(name for name in folders if not name.startswith("."))
        for path in sorted(Path(parent, name) for name in files):
            name = prefix + path.relative_to(folder).as_posix()
            # A pipe would be waited for without end.
            if _is_pack_file(name) and path.is_file() and not path.is_symlink():
                number += 1
                if number > _MAX_FILES:
                    raise RecipeFileError(f"{folder}: more than {_MAX_FILES:,} recipe files.")
                if path.stat().st_size > MAX_FILE:
                    raise RecipeFileError(f"{path}: more than {MAX_FILE:,} bytes for one recipe.")
                yield name, read_bytes(path)
