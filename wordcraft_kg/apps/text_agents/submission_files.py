"""The files of submissions: in a folder, as ``bench run`` writes it, or in a ZIP archive.

An archive holds the two files of one submission, or a folder for each of several, as those of a
leaderboard's track. A submission in an archive has the path of the archive and of its folder there,
such as ``craft-8.zip/votes``. Other members have no effect.
"""

from pathlib import Path, PurePosixPath

from wordcraft_kg.apps.text_agents.records import GAMES_FILE
from wordcraft_kg.base.artefacts import SMALL_FILE, ZipArchive, read_small_file
from wordcraft_kg.base.errors import ArtefactError

SUBMISSION_FILE = "submission.json"
ARCHIVE = ".zip"
"""Ending of an archive; ``python -m zipfile -c ARCHIVE FILES`` makes one."""


def is_submission(path: Path) -> bool:
    """Return whether a path is a folder with a submission, or could be an archive's submission."""
    return _archive_of(path) is not None or (path / SUBMISSION_FILE).is_file()


def submissions_at(path: Path) -> list[Path]:
    """Return the submissions at a path, in folders and archives at any depth, in order.

    Args:
        path: a folder or an archive; a folder without a submission and a damaged archive are
            returned as they are, so that reading them says what is wrong.
    """
    if path.is_file() and path.suffix == ARCHIVE:
        return _in_archive(path)
    folders = [file.parent for file in path.rglob(SUBMISSION_FILE)]
    for archive in path.rglob(f"*{ARCHIVE}"):
        if archive.is_file():
            folders += _in_archive(archive)
    return sorted(folders) or [path]


def read_submission_file(submission: Path, name: str) -> bytes:
    """Return the bytes of a file of a submission.

    Args:
        submission: a folder, an archive, or a folder in an archive.
        name: :data:`SUBMISSION_FILE` or :data:`~wordcraft_kg.apps.text_agents.records.GAMES_FILE`.

    Raises:
        ArtefactError: if the file is missing, too large or damaged.
    """
    path = _archive_of(submission)
    if path is None:
        return read_small_file(submission / name)
    archive = ZipArchive(path, read_small_file(path))
    member = (submission.relative_to(path) / name).as_posix()
    if member not in archive.members:
        raise ArtefactError(
            f"{submission} has no {name}; expected the files {SUBMISSION_FILE} and {GAMES_FILE} of "
            f"`wordcraft-kg bench run`, or one of several folders with them, as in "
            f"{path.name}/NAME."
        )
    return archive.read(member, SMALL_FILE)


def _archive_of(submission: Path) -> Path | None:
    """Return the archive that a path names or goes into; None outside of archives."""
    for path in (submission, *submission.parents):
        if path.suffix == ARCHIVE and path.is_file():
            return path
    return None


def _in_archive(archive: Path) -> list[Path]:
    """Return the paths of an archive's submissions; the archive itself if it has or shows none."""
    try:
        members = map(PurePosixPath, ZipArchive(archive, read_small_file(archive)).members)
    except ArtefactError:
        return [archive]
    folders = [archive / member.parent for member in members if member.name == SUBMISSION_FILE]
    return sorted(folders) or [archive]
