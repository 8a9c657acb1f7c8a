"""Zip archives and gzip data that anybody may have made, read within limits.

Nothing is unpacked to the disk, and a member of an archive is read by its exact name, so names such
as ``../run.json`` have no effect. Damaged data raise many exceptions, and :data:`DAMAGE` is the one
list of them. Every reader names the class of its errors, or a function that makes one of a message.
"""

import codecs
import gzip
import io
import lzma
import struct
import zipfile
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path

from wordcraft_kg.base.errors import ArtefactError, WordCraftKGError, reason

MakeError = Callable[[str], WordCraftKGError]
"""Class of an error, or a function that returns an error for a message."""
DAMAGE = (
    *(zipfile.BadZipFile, zipfile.LargeZipFile, zlib.error, lzma.LZMAError, struct.error),
    *(EOFError, IndexError, MemoryError, NotImplementedError, OSError, OverflowError),
    RuntimeError,  # an encrypted member
    ValueError,  # a name that is not UTF-8, or a place before the begin of the file
)
"""Exceptions that damaged archives and compressed data raise when Python's modules read them."""
MAX_RATIO = 200
"""Most bytes from a compressed byte.

A book of repeated words compresses about 20 times, zeros 1,000 times.
"""
MAX_MEMBERS = 100_000
"""Most members of a zip archive."""
MAX_LINE = 2**20
"""Most bytes in a line; a longer line suggests another kind of file, and could fill the memory."""
_LEAST_OF_LINE = 16
"""Bytes that a line counts at least: millions of empty lines would take minutes."""
_FREE = 2**20
"""Bytes that may come out of compressed data whatever the ratio."""
_ZIP_METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
_GZIP_MAGIC = b"\x1f\x8b"
_ENCRYPTED = 0x1
"""Bit of a member's flags."""


@contextmanager
def damage_as(error: MakeError, where: str | Path) -> Iterator[None]:
    """Raise an exception of :data:`DAMAGE` in the block as an error that says where it happened.

    Args:
        error: class of the error.
        where: the file, for the message, perhaps with a member.

    Raises:
        WordCraftKGError: the error; one that the block raises itself stays as it is.
    """
    try:
        yield
    except WordCraftKGError:
        raise
    except DAMAGE as exception:
        raise error(
            f"{where} is damaged: {reason(exception)}. Make it again, or restore a copy."
        ) from None


def is_zip(data: bytes) -> bool:
    """Return whether bytes are a zip archive, also an empty one."""
    return data[:4] in (b"PK\x03\x04", b"PK\x05\x06")


def is_gzip(data: bytes) -> bool:
    """Return whether bytes are gzip data; no UTF-8 text starts with these bytes."""
    return data[:2] == _GZIP_MAGIC


class ZipArchive:
    """A zip archive in memory: no file stays open, and nothing is unpacked to the disk.

    Attributes:
        path: the archive's file, for errors.
        members: the entries of the archive's list by name, in its order; what they say of
            themselves may be wrong.
    """

    def __init__(self, path: Path, data: bytes, error: MakeError = ArtefactError):
        """Read the list of members; no member is unpacked.

        Args:
            path: the file, for errors.
            data: its bytes.
            error: class of the errors.

        Raises:
            WordCraftKGError: if the archive is damaged, has too many members, an empty name or a
                name twice.
        """
        self.path = path
        self._error = error
        with damage_as(error, path):
            self._file = zipfile.ZipFile(io.BytesIO(data))
        entries = self._file.infolist()
        if len(entries) > MAX_MEMBERS:
            raise error(f"{path} has {len(entries):,} members; the limit is {MAX_MEMBERS:,}.")
        self.members: dict[str, zipfile.ZipInfo] = {}
        for entry in entries:
            if not entry.filename or entry.filename in self.members:
                raise self._refuse(entry.filename, "has no name of its own")
            self.members[entry.filename] = entry

    def check(self, name: str, largest: int) -> None:
        """Check what the archive's list says of a member, before anything is unpacked.

        Args:
            name: exact name of the member.
            largest: limit of its size after unpacking, in bytes.

        Raises:
            WordCraftKGError: if the archive lacks the member, or if the member is encrypted, too
                large, or compressed by another method than deflate.
        """
        if name not in self.members:
            raise self._refuse(name, "is missing")
        entry = self.members[name]
        if entry.flag_bits & _ENCRYPTED:
            raise self._refuse(name, "is encrypted")
        if entry.compress_type not in _ZIP_METHODS:
            raise self._refuse(
                name,
                f"has the compression method {entry.compress_type}; expected none or deflate",
            )
        if entry.file_size > largest:
            raise self._refuse(name, f"has {entry.file_size:,} bytes; the limit is {largest:,}")
        if entry.file_size > most_unpacked(entry.compress_size):
            raise self._refuse(name, f"expands more than {MAX_RATIO} times")

    def read(self, name: str, largest: int) -> bytes:
        """Return a member's bytes.

        Args:
            name: exact name of the member.
            largest: limit of its size, in bytes.

        Raises:
            WordCraftKGError: if the member is damaged, and see :meth:`check`.
        """
        self.check(name, largest)
        entry = self.members[name]
        with damage_as(self._error, f"{self.path}, member {name[:80]!r},"):
            with self._file.open(entry) as member:
                # Without a number, zipfile unpacks everything before it looks at the size.
                data = member.read(entry.file_size)
            if len(data) < entry.file_size:
                raise EOFError(f"{len(data):,} of {entry.file_size:,} bytes")
        return data

    def _refuse(self, name: str, fault: str) -> WordCraftKGError:
        return self._error(
            f"{self.path}, member {name[:80]!r}, {fault}. Make the archive again, or use another."
        )


def most_unpacked(packed: int) -> int:
    """Return the most bytes that may come out of so many compressed bytes."""
    return max(_FREE, MAX_RATIO * packed)


def gunzip(path: Path, data: bytes, largest: int, error: MakeError = ArtefactError) -> bytes:
    """Return the content of gzip data, of one or several members, one after the other.

    Args:
        path: the file, for errors.
        data: its bytes, see :func:`is_gzip`.
        largest: limit of the size after unpacking, in bytes.
        error: class of the errors.

    Raises:
        WordCraftKGError: if the data are damaged, end too early, go on after their end, or expand
            too much.
    """
    limit = min(largest, most_unpacked(len(data)))
    with damage_as(error, path), gzip.GzipFile(fileobj=io.BytesIO(data)) as file:
        content = file.read(limit + 1)
    if len(content) > limit:
        raise error(
            f"{path} has more than {limit:,} bytes after unpacking; expected at most {largest:,}, "
            f"and at most {MAX_RATIO} from a compressed byte. Use another file."
        )
    return content


def read_lines(path: Path, error: MakeError = ArtefactError) -> Iterator[tuple[int, bytes]]:
    """Yield lines of a plain or gzipped text file with their ends, numbered from 1.

    The file is read as it is iterated, so that the memory never holds more than a line. A byte
    order mark is left out.

    Args:
        path: the file; its first bytes tell whether it is gzipped.
        error: class of the errors.

    Raises:
        WordCraftKGError: while iterating, for damaged gzip data, for data that expand too much, and
            for lines above :data:`MAX_LINE` bytes.
        OSError: if the file cannot be opened.
    """
    number = num_bytes = 0
    limit = most_unpacked(path.stat().st_size)
    with path.open("rb") as raw, damage_as(error, path):
        is_packed = is_gzip(raw.peek(2))
        file = io.BufferedReader(gzip.GzipFile(fileobj=raw)) if is_packed else raw
        # At most so many bytes at once: a file without line ends would fill the memory.
        for number, line in enumerate(iter(partial(file.readline, MAX_LINE), b""), 1):
            # A line takes time, even an empty one.
            num_bytes += max(len(line), _LEAST_OF_LINE)
            if len(line) == MAX_LINE:
                raise error(
                    f"{path}, line {number:,}: {MAX_LINE:,} bytes or more; expected shorter lines. "
                    "Use a text file."
                )
            if num_bytes > limit:
                raise error(
                    f"{path}, line {number:,}: more than {MAX_RATIO} bytes from a compressed byte. "
                    "Use another file."
                )
            yield number, line.removeprefix(codecs.BOM_UTF8) if number == 1 else line
