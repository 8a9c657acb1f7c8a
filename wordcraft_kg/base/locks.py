"""Locks on folders: one process at a time works in a folder, and others can tell."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from wordcraft_kg.base.errors import ArtefactError


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
