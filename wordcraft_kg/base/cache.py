"""The user's cache for recipe books: ``wordcraft-kg`` in ~/.cache or ``XDG_CACHE_HOME``."""

import os
import shutil
from pathlib import Path


def cache_folder() -> Path:
    """Return the folder with downloaded recipe books; the folder may not exist yet."""
    root = os.environ.get("XDG_CACHE_HOME")
    return (Path(root) if root else Path.home() / ".cache") / "wordcraft-kg" / "books"


def clear_cache() -> None:
    """Delete all downloaded recipe books."""
    if (folder := cache_folder()).exists():
        shutil.rmtree(folder)
