"""The files of a submission.

They lie in a folder, as ``bench run`` writes it, or in a ZIP archive.

An archive keeps a leaderboard in one file for each submission. Nothing is unpacked to disk: a
member is read by its exact name, so the other members of an archive, whatever their names, have no
effect.
"""

import zipfile
import zlib
from collections.abc import Iterator
from pathlib import Path

from wordcraft_kg.apps.text_agents.records import GAMES_FILE
from wordcraft_kg.base.artefacts import SMALL_FILE, check_file, read_small_file
from wordcraft_kg.base.errors import ArtefactError

SUBMISSION_FILE = "submission.json"
ARCHIVE = ".zip"
"""Ending of an archive with a submission; ``python -m zipfile -c ARCHIVE FILES`` makes one."""


def is_submission(path: Path) -> bool:
    """Return whether a path is a folder with a submission, or could be an archive with one."""
    if path.is_file():
        return path.suffix == ARCHIVE
    return (path / SUBMISSION_FILE).is_file()


def submissions_below(folder: Path) -> list[Path]:
    """Return all folders and archives with a submission below a folder, at any depth.

    They are in the order of their names without the ending, whether packed or not.
    """
    return sorted(_found(folder), key=lambda path: path.parent / path.name.removesuffix(ARCHIVE))


def _found(folder: Path) -> Iterator[Path]:
    for path in folder.rglob(SUBMISSION_FILE):
        yield path.parent
    for path in folder.rglob(f"*{ARCHIVE}"):
        if path.is_file():
            yield path


def read_submission_file(submission: Path, name: str) -> bytes:
    """Return the bytes of a file of a submission.

    Args:
        submission: a folder or an archive.
        name: :data:`SUBMISSION_FILE` or :data:`~wordcraft_kg.apps.text_agents.records.GAMES_FILE`.

    Raises:
        ArtefactError: if the file is missing, too large or damaged.
    """
    if not submission.is_file():
        return read_small_file(submission / name)
    check_file(submission, SMALL_FILE)
    try:
        with zipfile.ZipFile(submission) as archive, archive.open(name) as member:
            # One byte more than allowed: the size that the archive declares may be a lie.
            data = member.read(SMALL_FILE + 1)
    except KeyError:
        raise ArtefactError(
            f"{submission} has no {name}; expected the files {SUBMISSION_FILE} and {GAMES_FILE} of "
            "`wordcraft-kg bench run`."
        ) from None
    # Damaged, encrypted, or compressed by a method that this Python does not know.
    except (zipfile.BadZipFile, zlib.error, EOFError, OSError, RuntimeError, ValueError) as error:
        raise ArtefactError(
            f"{submission} is damaged: {error}. Make it again, or restore a copy."
        ) from None
    if len(data) > SMALL_FILE:
        raise ArtefactError(f"{submission}: {name} has more than {SMALL_FILE:,} bytes.")
    return data
