"""The cache for downloads and computed files: ``~/.cache/wordcraft-kg``, or below ``XDG_CACHE_HOME``."""

import os
import shutil
from pathlib import Path
from typing import Literal, get_args

CachePart = Literal["books", "elicited"]
"""Fetched recipe books, and answers from language models."""


def cache_folder(part: CachePart) -> Path:
    """Return a part's folder, which may not exist yet."""
    root = os.environ.get("XDG_CACHE_HOME")
    return (Path(root) if root else Path.home() / ".cache") / "wordcraft-kg" / part


def clear_cache() -> None:
    """Remove all parts of the cache."""
    for part in get_args(CachePart):
        folder = cache_folder(part)
        if folder.exists():
            shutil.rmtree(folder)
