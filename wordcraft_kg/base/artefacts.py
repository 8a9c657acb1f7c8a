"""Files that are either complete or absent, locks on folders, and archives from anybody.

Files are written through a temporary sibling and a rename, and folders appear only when complete,
so that readers never see incomplete content. With a lock, one process at a time works in a folder,
and others can tell.

Zip archives and gzip data that anybody may have made are read within limits. Nothing is unpacked
to the disk, and a member of an archive is read by its exact name, so names such as ``../run.json``
have no effect. Damaged data raise many exceptions, and :data:`DAMAGE` is the one list of them.
Every reader names the class of its errors, or a function that makes one of a message.
"""

import codecs
import gzip
import hashlib
import io
import json
import lzma
import os
import secrets
import shutil
import stat
import struct
import zipfile
import zlib
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import Any

from wordcraft_kg.base.errors import ArtefactError, OutputExistsError, WordCraftKGError, reason


@contextmanager
def locked(folder: Path, use: str = "trained") -> Iterator[None]:
    """Keep other processes from working in a folder during this block.

    The lock is the system's, so it ends at the latest with this process; no file is left behind.
    Without such locks, as on Windows, the block runs unlocked.

    Args:
        folder: an existing folder.
        use: what is done with the folder, for the error of another process.

    Raises:
        ArtefactError: if another process has locked or just replaced the folder.
    """
    try:
        import fcntl
    except ImportError:  # Windows
        yield
        return
    # The folder itself is locked: no lock file has to be removed after a crash.
    handle = os.open(folder, os.O_RDONLY)
    try:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise in_use(folder, use) from None
        # The lock is on a folder that another process may have replaced in between.
        if not os.path.exists(folder) or not os.path.samestat(os.fstat(handle), os.stat(folder)):
            raise in_use(folder, use)
        yield
    finally:
        os.close(handle)


def is_locked(folder: Path) -> bool:
    """Return whether a process works in a folder; False if the system cannot tell."""
    try:
        import fcntl

        handle = os.open(folder, os.O_RDONLY)
    except (ImportError, OSError):  # Windows, or no folder
        return False
    try:
        # Shared, so that two readers do not take each other for a training.
        fcntl.flock(handle, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except OSError as error:
        return isinstance(error, BlockingIOError)
    finally:
        os.close(handle)
    return False


def in_use(folder: Path, use: str = "trained") -> ArtefactError:
    """Return the error for a folder in which another process works.

    Args:
        folder: the folder.
        use: what is done with the folder.
    """
    return ArtefactError(
        f"'{folder}' is being {use} by another process; wait, or stop the process."
    )


_OWN_FILES = (
    "graph.json",
    "run.json",
    "report.json",
    "sets.json",
    "site.json",
    "submission.json",
)
"""Files that mark a folder as written by this package; ``force`` may replace such a folder."""
TEMPORARY = ".wordcraft-kg"
"""Suffix of hidden temporary files and folders; later commands remove those of killed processes."""
SMALL_FILE = 2**28
"""Largest file with records, logs or settings, in bytes."""
LARGE_FILE = 2**36
"""Largest file with model weights or recipes, in bytes."""
# Checked in this order, for the description of a path in an error.
_KINDS = {
    "graph.json": "is a graph folder",
    "run.json": "is the folder of a run whose run.json is damaged",
    "report.json": "is the folder of a report",
    "sets.json": "is the report of a model of sets",
    "study.json": "is the folder of a study with people",
    "games.jsonl": "is the folder of a text agent",
}


def with_a_name(path: Path) -> Path:
    """Return a path that ends in a name, for sibling paths; ``.`` and ``..`` are resolved."""
    return path if path.name not in ("", "..") else path.resolve()


def sha256_of(path: Path) -> str:
    """Return a file's SHA-256 hash, in hexadecimal."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def json_text(value: Any, **settings: Any) -> str:
    """Return a value as JSON text in a line; names keep their order.

    Args:
        value: dictionaries, lists, strings and numbers.
        settings: of :func:`json.dumps`.

    Raises:
        ArtefactError: for NaN and infinity; JSON has no such numbers.
    """
    try:
        return json.dumps(value, **({"ensure_ascii": False} | settings), allow_nan=False)
    except ValueError as error:
        raise ArtefactError(
            f"a result is NaN or infinite ({error}); expected numbers that JSON can hold. If a "
            "model made it, train the model again, with a smaller learning rate."
        ) from None


def dump_json(value: Any) -> str:
    """Return a value as indented JSON text with a final newline, see :func:`json_text`.

    Raises:
        ArtefactError: for NaN and infinity.
    """
    return json_text(value, indent=2) + "\n"


def check_file(path: Path, largest: int = LARGE_FILE) -> None:
    """Check that a path can be read to its end: a regular file of at most ``largest`` bytes.

    Devices and pipes have no end, and a small file may stand for any number of empty bytes.

    Raises:
        ArtefactError: if the file is missing, not a regular file, or too large.
    """
    if not os.path.lexists(path):
        raise ArtefactError(
            f"{path} is missing; the folder is incomplete or not of the expected kind."
        )
    if not path.is_file():
        raise ArtefactError(f"{path} is damaged: not a regular file. Restore a copy.")
    size = path.stat().st_size
    if size > largest:
        raise ArtefactError(
            f"{path} is damaged: {size:,} bytes; the limit is {largest:,}. Restore a copy."
        )


def read_small_file(path: Path) -> bytes:
    """Return the content of a file with records, metrics or settings, see :func:`check_file`.

    The limit is :data:`SMALL_FILE` bytes.

    Raises:
        ArtefactError: if the file is missing, not a regular file, or too large.
    """
    check_file(path, SMALL_FILE)
    return path.read_bytes()


def read_large_file(path: Path) -> bytes:
    """Return the content of a file with weights, see :func:`check_file`.

    The limit is :data:`LARGE_FILE` bytes.

    Raises:
        ArtefactError: if the file is missing, not a regular file, or too large.
    """
    check_file(path)
    return path.read_bytes()


def read_json(path: Path, largest: int = SMALL_FILE) -> Any:
    """Return the value in a JSON file written by this package.

    Args:
        path: the file.
        largest: limit of its size in bytes.

    Raises:
        ArtefactError: if the file is missing, too large, not UTF-8 or not JSON.
    """
    check_file(path, largest)
    data = path.read_bytes()
    try:
        return json.loads(data.decode())
    # ValueError: not UTF-8, not JSON, or a number of 5,000 digits; RecursionError: too deep.
    except (ValueError, RecursionError) as error:
        raise ArtefactError(
            f"{path} is damaged: {error}. Make it again, or restore a copy."
        ) from None


def what_is(path: Path) -> str:
    """Return a phrase that describes a path in an error message, such as "is a graph folder"."""
    if not path.exists():
        return "does not exist"
    if not path.is_dir():
        return "is a file"
    with suppress(ArtefactError, LookupError, TypeError):
        return f"was written by {read_json(path / 'run.json')['kind']}"
    for name, kind in _KINDS.items():
        if (path / name).is_file():
            return kind
    if not any(path.iterdir()):
        return "is an empty folder"
    return f"has none of {', '.join(_OWN_FILES)}"


def output_target(out: Path, setting: str = "out") -> Path:
    """Return the path that an output replaces: the end of a link, otherwise ``out`` itself.

    The link stays. Only outputs that a user names are followed through links. Files in a folder are
    not: a folder that somebody else made may hold links to any file of the user's.

    Args:
        out: file or folder to write.
        setting: the setting that names it, for errors.

    Raises:
        OutputExistsError: if ``out`` is a device, a pipe or a socket, or if it or a folder above it
            is a link that leads nowhere.
    """
    _refuse_special(out, setting)
    for path in (out, *out.parents):
        if path.is_symlink() and not os.path.exists(path):
            target = os.path.realpath(path)
            fault = f"to '{target}', which does not exist"
            if os.path.islink(target):
                fault = "in a loop of links"
            raise OutputExistsError(
                f"'{path}' is a link {fault}. Remove the link, or choose another `{setting}`."
            )
    return Path(os.path.realpath(out)) if out.is_symlink() else out


def _refuse_special(path: Path, setting: str = "out") -> None:
    """Raise OutputExistsError for a device, pipe or socket: a rename would replace it by a file."""
    try:
        mode = path.stat().st_mode
    except OSError:  # missing, or a link that leads nowhere
        return
    if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):
        raise OutputExistsError(
            f"'{path}' is a device, a pipe or a socket; expected a file or a folder. Choose "
            f"another `{setting}`."
        )


def write_atomically(
    path: Path, content: str | bytes | Iterable[str], *, durable: bool = False
) -> None:
    """Write a file through a temporary file and a rename.

    Readers see either the old content or the new content, never a part of the new content. A link
    at ``path`` is replaced, not followed, see :func:`output_target`.

    Args:
        path: file to write; its folder exists.
        content: bytes, or text written as UTF-8, perhaps in parts.
        durable: flush the file to the disk before the rename, so that not even a power failure
            leaves an empty file.

    Raises:
        OutputExistsError: if ``path`` is a device, a pipe or a socket.
    """
    if not path.is_symlink():
        _refuse_special(path)
    temporary = _beside(path)
    try:
        parts = [content] if isinstance(content, str | bytes) else content
        with temporary.open("xb") as file:
            for part in parts:
                file.write(part if isinstance(part, bytes) else part.encode())
            if durable:
                file.flush()
                os.fsync(file.fileno())
        os.replace(temporary, path)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise


def _beside(path: Path) -> Path:
    """Return a new name for a temporary file or folder that will take the place of ``path``.

    It is in the same folder, because a rename is atomic only within a file system.
    """
    return path.with_name(f".{path.name}.{secrets.token_hex(4)}{TEMPORARY}")


def has_only_temporary(folder: Path) -> bool:
    """Return whether a folder is empty, apart from temporary files of a killed process."""
    return all(path.match(f".*{TEMPORARY}") for path in folder.iterdir())


def drop_temporary(folder: Path) -> None:
    """Remove temporary files and folders that a killed process has left in ``folder``.

    No other process may write there: its temporary files would be removed as well.
    """
    for path in folder.glob(f".*{TEMPORARY}"):
        if path.is_dir():
            shutil.rmtree(path)
        else:
            path.unlink(missing_ok=True)


def check_output(out: Path, *, force: bool) -> None:
    """Check, before any work, that an output may be written to the folder ``out``.

    Raises:
        OutputExistsError: if ``out`` exists and ``force`` is False. A file, a device, or a
            non-empty folder that this package did not write, is never replaced; a link must lead
            to a folder.
    """
    output_target(out)
    if out.is_file():
        raise OutputExistsError(
            f"'{out}' is a file, but the output is a folder. Choose another `out`."
        )
    if not out.exists():
        return
    if not has_only_temporary(out) and not any((out / name).is_file() for name in _OWN_FILES):
        raise OutputExistsError(
            f"'{out}' exists and does not look like an output of wordcraft-kg (without "
            f"{', '.join(_OWN_FILES)}); the folder is not replaced, even with `force`. Choose "
            "another `out`."
        )
    if not force:
        raise OutputExistsError(
            f"'{out}' exists. Choose another `out`, or replace it with `force`."
        )


@contextmanager
def staged_folder(out: Path, *, force: bool = False) -> Iterator[Path]:
    """Yield a temporary folder, renamed to ``out`` if the block succeeds, and removed if it fails.

    An earlier ``out`` stays untouched until the very end, whatever happens in the block, Ctrl-C
    included. If ``out`` is a link, the folder at its end is replaced, and the link stays.

    Raises:
        OutputExistsError: see :func:`check_output`.
    """
    check_output(out, force=force)
    with _staged(out, force=force) as staging:
        yield staging


@contextmanager
def staged_file(out: Path, *, force: bool = False) -> Iterator[Path]:
    """Yield a path in a temporary folder; the file there becomes ``out`` if the block succeeds.

    If ``out`` is a link, the file at its end is replaced, and the link stays.

    Raises:
        OutputExistsError: see :func:`check_output_file`.
    """
    check_output_file(out, force=force)
    # The name as given: formats and titles come from it.
    with _staged(out, out.name, force=force) as staging:
        yield staging


def check_output_file(out: Path, *, force: bool, setting: str = "out") -> None:
    """Check, before any work, that an output may be written to the file ``out``.

    Args:
        out: file to write.
        force: whether an existing file may be replaced.
        setting: the setting that names it, for errors.

    Raises:
        OutputExistsError: if ``out`` is a folder or a device, or exists and ``force`` is False.
    """
    output_target(out, setting)
    if out.is_dir():
        raise OutputExistsError(
            f"'{out}' is a folder, but the output is a file. Choose another `{setting}`."
        )
    if out.exists() and not force:
        raise OutputExistsError(
            f"'{out}' exists. Choose another `{setting}`, or replace it with `force`."
        )


@contextmanager
def made_folder(folder: Path) -> Iterator[None]:
    """Make a folder with its parents; those that are new and empty disappear if the block fails."""
    missing = [path for path in (folder, *folder.parents) if not path.exists()]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        yield
    except BaseException:
        for path in missing:
            # It may have content: of this block, to go on from, or of another process.
            with suppress(OSError):
                path.rmdir()
        raise


@contextmanager
def _staged(out: Path, name: str = "", *, force: bool) -> Iterator[Path]:
    """Yield a temporary folder beside ``out``, or a file there, which becomes ``out`` in the end.

    An earlier ``out`` is moved aside and restored after a failure.

    Args:
        out: file or folder to write.
        name: name of the file in the temporary folder; empty for the folder itself, in which
            relative paths lead to the same places as in ``out``.
        force: whether an existing ``out`` is replaced.

    Raises:
        OutputExistsError: if another process has written ``out`` since it was checked.
    """
    target = with_a_name(output_target(out))
    with made_folder(target.parent):
        temporary = _beside(target)
        earlier = _beside(target)
        temporary.mkdir()
        try:
            staged = temporary / name
            yield staged
            if not force:
                # Unlike a rename, a link replaces nothing. Folders and some disks have no links.
                with suppress(OSError):
                    os.link(staged, target)
                    return
                if os.path.lexists(target):
                    raise OutputExistsError(
                        f"another process has written '{out}' meanwhile, and nothing of this one "
                        "was kept. Choose another `out`, or replace it with `force`."
                    )
            try:
                # A rename replaces a file, but no folder with content. A file never takes the place
                # of a folder.
                if force and not name and target.is_dir():
                    os.rename(target, earlier)
                os.replace(staged, target)
            except BaseException:
                if earlier.exists() and not target.exists():
                    os.rename(earlier, target)
                raise
        finally:
            shutil.rmtree(temporary, ignore_errors=True)
            # An earlier folder that could not be restored stays.
            if target.exists():
                shutil.rmtree(earlier, ignore_errors=True)


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

    def read(self, name: str, largest: int) -> bytes:
        """Return a member's bytes, after a check of what the archive's list says of the member.

        Args:
            name: exact name of the member.
            largest: limit of its size after unpacking, in bytes.

        Raises:
            WordCraftKGError: if the archive lacks the member, or if the member is damaged, too
                large, or compressed by another method than deflate.
        """
        if name not in self.members:
            raise self._refuse(name, "is missing")
        entry = self.members[name]
        if entry.compress_type not in _ZIP_METHODS:
            raise self._refuse(
                name,
                f"has the compression method {entry.compress_type}; expected none or deflate",
            )
        if entry.file_size > largest:
            raise self._refuse(name, f"has {entry.file_size:,} bytes; the limit is {largest:,}")
        if entry.file_size > most_unpacked(entry.compress_size):
            raise self._refuse(name, f"expands more than {MAX_RATIO} times")
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
