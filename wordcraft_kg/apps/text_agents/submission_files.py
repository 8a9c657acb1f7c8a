"""The files of a submission.

They lie in a folder, as ``bench run`` writes it, or in a ZIP archive.

An archive keeps a leaderboard in one file for each submission; its other members have no effect.
"""

from collections.abc import Iterator
from pathlib import Path

from wordcraft_kg.apps.text_agents.records import GAMES_FILE
from wordcraft_kg.base.archives import ZipArchive
from wordcraft_kg.base.artefacts import SMALL_FILE, read_small_file
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
    archive = ZipArchive(submission, read_small_file(submission))
    if name not in archive.members:
        raise ArtefactError(
            f"{submission} has no {name}; expected the files {SUBMISSION_FILE} and {GAMES_FILE} of "
            "`wordcraft-kg bench run`."
        )
    return archive.read(name, SMALL_FILE)
