"""What is kept outside the folders that commands are given."""

import os
from pathlib import Path

from wordcraft_kg.base.cache import cache_folder
from wordcraft_kg.base.records import Count, Record


class CachedFiles(Record):
    """A folder of kept files.

    Attributes:
        holds: what the files are.
        path: the folder.
        files: number of files; 0 if there is no such folder.
        bytes: their size.
        is_ours: whether ``cache --clear`` removes them.
    """

    holds: str
    path: str
    files: Count
    bytes: Count
    is_ours: bool


class CacheView(Record):
    """All folders in which something is kept, and whether the cache has just been cleared."""

    folders: tuple[CachedFiles, ...]
    cleared: bool = False


def view_cache(*, cleared: bool = False) -> CacheView:
    """Return where files are kept, how many, and their size."""
    pykeen = Path(os.environ.get("PYSTOW_HOME") or Path.home() / ".data") / "pykeen"
    return CacheView(
        (
            _files("fetched recipe books", cache_folder("books"), is_ours=True),
            _files("word vectors read from files", cache_folder("vectors"), is_ours=True),
            _files("answers of language models", cache_folder("opinions"), is_ours=True),
            _files("PyKEEN's own folder", pykeen, is_ours=False),
        ),
        cleared,
    )


def _files(holds: str, folder: Path, *, is_ours: bool) -> CachedFiles:
    sizes = [path.stat().st_size for path in folder.rglob("*") if path.is_file()]
    return CachedFiles(holds, str(folder), len(sizes), sum(sizes), is_ours)
