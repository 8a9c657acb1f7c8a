"""The bytes of a recipe book: from a plain file, gzip, or an archive; nothing is unpacked to disk.

Compressed data may expand a thousandfold, so the size and the ratio are limited while it is read.
"""

import io
import lzma
import stat
import zipfile
import zlib
from collections.abc import Iterator
from operator import attrgetter
from pathlib import Path, PurePosixPath
from typing import NamedTuple

from wordcraft_kg.base.artefacts import what_is
from wordcraft_kg.base.errors import RecipeFileError
from wordcraft_kg.graphs.book_files.guide import refusal

MAX_BOOK_SIZE = 2**30
"""Largest file that is read, in bytes, also after decompression; about 40 million recipes."""
_MAX_RATIO = 200  # a book of repeated words compresses about 20 times, zeros 1,000 times
_FREE = 2**20  # bytes that may come out of compressed data whatever the ratio
_CHUNK = 2**20
_INPUT = 2**12  # compressed bytes at a time: what follows a member's end is copied
_DAMAGED = (
    *(zipfile.BadZipFile, zlib.error, lzma.LZMAError),
    *(EOFError, NotImplementedError, OSError),
)
_MAX_MEMBERS = 100_000
_TEXT_ENDINGS = (".csv", ".tsv", ".tab", ".txt", ".json", ".jsonl", ".ndjson", ".ic")
_SIGNATURES = {
    b"SQLite format 3\x00": "an SQLite database; export its table of recipes as CSV",
    b"PAR1": "a Parquet file; save it as CSV",
    b"%PDF": "a PDF document",
    b"\x89PNG": "an image",
    b"\xff\xd8\xff": "an image",
    b"GIF8": "an image",
    b"BZh": "compressed with bzip2; decompress it, or use gzip",
    b"\xfd7zXZ": "compressed with xz; decompress it, or use gzip",
    b"\x28\xb5\x2f\xfd": "compressed with zstd; decompress it, or use gzip",
    b"7z\xbc\xaf": "a 7z archive; unpack it, or use zip",
    b"Rar!": "a RAR archive; unpack it, or use zip",
    b"\xd0\xcf\x11\xe0": "an old Office document; save the sheet as CSV",
    b"\x93NUMPY": "a NumPy array",
    b"\x7fELF": "a program",
}


class Content(NamedTuple):
    """A file's bytes.

    Attributes:
        name: file name that stands for the content, such as ``book.csv`` for ``book.csv.gz``.
        data: the bytes, decompressed.
        container: compression or archive around it, for people; empty without one.
    """

    name: str
    data: bytes
    container: str = ""


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


def is_zip(data: bytes) -> bool:
    """Return whether bytes are a zip archive, also an empty one."""
    return data[:4] in (b"PK\x03\x04", b"PK\x05\x06")


def opened(path: Path, data: bytes) -> Content:
    """Return a book's content, out of gzip or an archive with one book if it is in one.

    Args:
        path: the file, for its name and for errors.
        data: its bytes.

    Raises:
        RecipeFileError: for other compressed or binary files, which it names, for a damaged or
            encrypted archive, for an archive without one book, and for data that expand too much.
    """
    if data[:2] == b"\x1f\x8b":
        name = path.stem if path.suffix.lower() in (".gz", ".gzip") else path.name
        return Content(name, _checked(path, _gunzipped(path, data)), "gzip")
    if is_zip(data):
        members = [entry for entry in _members(path, data) if _may_be_book(entry.filename)]
        if len(members) != 1:
            names = ", ".join(repr(entry.filename[:80]) for entry in members[:5]) or "none"
            raise refusal(
                path,
                f"a zip archive with {len(members):,} files that may be recipe books ({names}); "
                "expected one",
                "compressed",
                "Unpack it and give one file.",
            )
        inside = members[0].filename
        content = _member_bytes(path, zipfile.ZipFile(io.BytesIO(data)), members[0])
        name = PurePosixPath(inside).name
        container = f"zip ({inside})"
        # A gzip file within the archive, by its first bytes: names of members are often wrong.
        if content[:2] == b"\x1f\x8b":
            content = _gunzipped(path, content)
            container = f"{container}, gzip"
            if name.lower().endswith(".gz"):
                name = PurePosixPath(name).stem
        return Content(name, _checked(path, content), container)
    return Content(path.name, _checked(path, data))


def json_members(path: Path, data: bytes) -> Iterator[tuple[str, bytes]]:
    """Yield names and bytes of all JSON files in a zip archive, in the order of their names.

    Args:
        path: the file, for errors.
        data: its bytes, see :func:`is_zip`.

    Raises:
        RecipeFileError: while iterating, for a damaged or encrypted archive, one with links or
            paths out of it, and for data that expand too much.
    """
    members = sorted(_members(path, data), key=attrgetter("filename"))
    archive = zipfile.ZipFile(io.BytesIO(data))
    total = 0
    for entry in members:
        if not entry.filename.lower().endswith(".json"):
            continue
        content = _member_bytes(path, archive, entry)
        total += len(content)
        if total > MAX_BOOK_SIZE:
            raise _too_large(path)
        yield entry.filename, content


def zip_names(path: Path, data: bytes) -> list[str]:
    """Return the names of the files in a zip archive, without hidden files.

    Args:
        path: the file, for errors.
        data: its bytes, see :func:`is_zip`.

    Raises:
        RecipeFileError: for a damaged archive, one with links, paths out of it or too many files,
            and for a spreadsheet or document, which is a zip archive, too.
    """
    return [entry.filename for entry in _members(path, data)]


def _may_be_book(name: str) -> bool:
    lower = name.lower().removesuffix(".gz")
    return lower.endswith(_TEXT_ENDINGS) and "readme" not in lower and "license" not in lower


def _members(path: Path, data: bytes) -> list[zipfile.ZipInfo]:
    """Return the files in an archive that may be content, see :func:`zip_names` for errors."""
    try:
        entries = zipfile.ZipFile(io.BytesIO(data)).infolist()
    except (zipfile.BadZipFile, ValueError, OSError, NotImplementedError, UnicodeError) as error:
        raise refusal(path, f"a damaged zip archive ({error})", "compressed") from None
    if len(entries) > _MAX_MEMBERS:
        raise RecipeFileError(f"{path}: {len(entries):,} files; the limit is {_MAX_MEMBERS:,}.")
    names = {entry.filename for entry in entries}
    if "[Content_Types].xml" in names or "mimetype" in names:
        raise refusal(
            path, "a spreadsheet or document, not a text file", "table", "Save the sheet as CSV."
        )
    kept = []
    for entry in entries:
        parts = PurePosixPath(entry.filename).parts
        if ".." in parts or PurePosixPath(entry.filename).is_absolute():
            raise refusal(
                path,
                f"the archive holds a path that leads out of it, {entry.filename[:80]!r}",
                "compressed",
            )
        # Finder's copies and dotfiles are no content.
        is_hidden = any(part.startswith((".", "__MACOSX")) for part in parts)
        if entry.is_dir() or is_hidden:
            continue
        # A link's content is a path; following it could lead out of the archive.
        if stat.S_ISLNK(entry.external_attr >> 16):
            raise refusal(
                path,
                f"the archive holds a link, {entry.filename[:80]!r}; links are not followed",
                "compressed",
            )
        kept.append(entry)
    return kept


def _member_bytes(path: Path, archive: zipfile.ZipFile, entry: zipfile.ZipInfo) -> bytes:
    if entry.flag_bits & 1:
        raise refusal(
            path,
            f"{entry.filename[:80]!r} in the archive is encrypted",
            "compressed",
            "Unpack it first.",
        )
    out = bytearray()
    try:
        with archive.open(entry) as stream:
            while chunk := stream.read(_CHUNK):
                out += chunk
                _check_ratio(path, len(out), entry.compress_size)
    except _DAMAGED as error:
        raise refusal(
            path, f"{entry.filename[:80]!r} in the archive is damaged ({error})", "compressed"
        ) from None
    return bytes(out)


def _gunzipped(path: Path, data: bytes) -> bytes:
    """Return the content of gzip data, of one or several members, one after the other."""
    out = bytearray()
    at = 0
    try:
        while data[at : at + 2] == b"\x1f\x8b":
            at = _add_member(path, data, at, out)
    except zlib.error as error:
        raise refusal(path, f"damaged gzip data ({error})", "compressed") from None
    # Zeros are padding; anything else after the last member would be lost in silence.
    rest = data[at:]
    if rest.strip(b"\x00"):
        raise refusal(path, f"{len(rest):,} bytes after the end of the gzip data", "compressed")
    return bytes(out)


def _add_member(path: Path, data: bytes, at: int, out: bytearray) -> int:
    """Decompress a gzip member that begins at a place, and return where it ends."""
    engine = zlib.decompressobj(wbits=31)
    while not engine.eof:
        piece = data[at : at + _INPUT]
        if not piece:
            raise refusal(path, "gzip data that end too early", "compressed")
        at += len(piece)
        while piece:
            out += engine.decompress(piece, _CHUNK)
            _check_ratio(path, len(out), len(data))
            piece = engine.unconsumed_tail
    return at - len(engine.unused_data)


def _check_ratio(path: Path, out: int, compressed: int) -> None:
    if out > MAX_BOOK_SIZE:
        raise _too_large(path)
    if out > _FREE and out > _MAX_RATIO * max(compressed, 1):
        raise RecipeFileError(
            f"{path}: the data expand more than {_MAX_RATIO} times, which no recipe book does; "
            "not read further."
        )


def _too_large(path: Path) -> RecipeFileError:
    return RecipeFileError(f"{path}: more than {MAX_BOOK_SIZE:,} bytes after decompression.")


def _checked(path: Path, data: bytes) -> bytes:
    """Return bytes that have no signature of another kind of file."""
    for signature, kind in _SIGNATURES.items():
        if data.startswith(signature):
            raise refusal(path, f"it is {kind}", "table")
    if data[:2] == b"\x1f\x8b" or is_zip(data):
        raise refusal(path, "an archive within an archive or compressed twice", "compressed")
    return data
