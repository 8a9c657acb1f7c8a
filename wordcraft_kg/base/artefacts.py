"""Reading and writing files that are either complete or absent, and locks on folders.

Files are written through a temporary sibling and a rename, and folders appear only when complete,
so that readers never see incomplete content. With a lock, one process at a time works in a folder,
and others can tell.
"""

import errno
import hashlib
import json
import os
import shutil
import stat
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from wordcraft_kg.base.errors import ArtefactError, OutputExistsError


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


def is_locked(folder: Path) -> bool | None:
    """Return whether a process works in a folder; None if the system cannot tell."""
    try:
        import fcntl
    except ImportError:  # Windows
        return None
    try:
        handle = os.open(folder, os.O_RDONLY)
    except OSError:
        return None
    try:
        # Shared, so that two readers do not take each other for a training.
        fcntl.flock(handle, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError:
        return None
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


_OWN_FILES = ("graph.json", "run.json", "report.json", "site.json", "submission.json")
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
        if is_locked(path.parent):
            raise ArtefactError(
                f"{path} is missing: '{path.parent}' is still being written by another process. "
                "Wait until it is done."
            )
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
    for name, kind in _KINDS.items():
        if (path / name).is_file():
            if name == "run.json":
                with suppress(ArtefactError, LookupError, TypeError):
                    return f"was written by {read_json(path / name)['kind']}"
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
        _refuse_lost_link(path, setting)
    return Path(os.path.realpath(out)) if out.is_symlink() else out


def _refuse_lost_link(path: Path, setting: str) -> None:
    """Raise OutputExistsError for a link that leads nowhere: nothing can be written there."""
    if not path.is_symlink():
        return
    target = Path(os.path.realpath(path))
    if not os.path.lexists(target):
        raise OutputExistsError(
            f"'{path}' is a link to '{target}', which does not exist. Remove the link, or choose "
            f"another `{setting}`."
        )
    if target.is_symlink():
        raise OutputExistsError(
            f"'{path}' is a link in a loop of links. Remove the link, or choose another "
            f"`{setting}`."
        )


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
    # In the same folder: a rename is atomic only within a file system.
    descriptor, temporary = tempfile.mkstemp(
        dir=path.parent, prefix=f".{path.name}.", suffix=TEMPORARY
    )
    try:
        if isinstance(content, bytes):
            with os.fdopen(descriptor, "wb") as binary:
                binary.write(content)
        else:
            with os.fdopen(descriptor, "w", encoding="utf-8", newline="") as text:
                text.writelines([content] if isinstance(content, str) else content)
        if durable:
            with open(temporary, "rb+") as file:
                os.fsync(file.fileno())
        # mkstemp makes private files; outputs have the usual permissions of new files.
        os.chmod(temporary, 0o666 & ~_umask())
        os.replace(temporary, path)
    except BaseException:
        Path(temporary).unlink(missing_ok=True)
        raise


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
    target = output_target(out)
    with _staging(target) as staging:
        os.chmod(staging, 0o777 & ~_umask())
        yield staging
        _replace_folder(staging, target, force=force)


@contextmanager
def staged_file(out: Path, *, force: bool = False) -> Iterator[Path]:
    """Yield a path in a temporary folder; the file there becomes ``out`` if the block succeeds.

    If ``out`` is a link, the file at its end is replaced, and the link stays.

    Raises:
        OutputExistsError: see :func:`check_output_file`.
    """
    check_output_file(out, force=force)
    target = output_target(out)
    with _staging(target) as staging:
        # The name as given: formats and titles come from it.
        yield staging / out.name
        _replace_file(staging / out.name, target, force=force)


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
def _staging(out: Path) -> Iterator[Path]:
    """Make the parents of ``out`` and a temporary folder beside it."""
    with made_folder(out.parent):
        staging = Path(tempfile.mkdtemp(dir=out.parent, prefix=f".{out.name}.", suffix=TEMPORARY))
        try:
            yield staging
        finally:
            shutil.rmtree(staging, ignore_errors=True)


def _replace_folder(staging: Path, out: Path, *, force: bool) -> None:
    """Rename ``staging`` to ``out``; with ``force`` in the place of an earlier folder.

    The earlier folder is restored after a failure.

    Raises:
        OutputExistsError: if another process has written ``out`` since it was checked.
    """
    aside: Path | None = None
    # A rename does not replace a folder with content, so the old folder is moved aside first.
    if force and out.exists():
        aside = Path(tempfile.mkdtemp(dir=out.parent, prefix=f".{out.name}.old.", suffix=TEMPORARY))
        os.rename(out, aside / "was")
    try:
        os.rename(staging, out)
    except BaseException as error:
        is_taken = isinstance(error, OSError) and error.errno in (errno.EEXIST, errno.ENOTEMPTY)
        if is_taken:
            raise _written_meanwhile(out) from None
        if aside is not None:
            os.rename(aside / "was", out)
        raise
    finally:
        if aside is not None:
            shutil.rmtree(aside, ignore_errors=True)


def _replace_file(staged: Path, out: Path, *, force: bool) -> None:
    """Rename ``staged`` to ``out``; only with ``force`` in the place of an earlier file.

    Raises:
        OutputExistsError: if another process has written ``out`` since it was checked.
    """
    if not force:
        try:
            # Unlike a rename, a link never replaces a file.
            os.link(staged, out)
            return
        except FileExistsError:
            raise _written_meanwhile(out) from None
        except OSError:  # a file system without hard links
            pass
    os.replace(staged, out)


def _written_meanwhile(out: Path) -> OutputExistsError:
    return OutputExistsError(
        f"another process has written '{out}' meanwhile, and nothing of this one was kept. Choose "
        "another `out`, or replace it with `force`."
    )


def _umask() -> int:
    # The mask can only be read by setting another one.
    mask = os.umask(0)
    os.umask(mask)
    return mask
