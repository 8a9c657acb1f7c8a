"""The cache: what can be fetched or computed again, in ``~/.cache/wordcraft-kg`` or where ``XDG_CACHE_HOME`` says."""

import os
import shutil
from pathlib import Path
from typing import Literal, get_args

CachePart = Literal["books", "vectors", "opinions"]
"""Fetched recipe books; vectors of the words of a graph, read from a file of word vectors; and answers of language
models."""


def cache_folder(part: CachePart) -> Path:
    """Return the folder of a part of the cache; it may not exist yet."""
    root = os.environ.get("XDG_CACHE_HOME")
    return (Path(root) if root else Path.home() / ".cache") / "wordcraft-kg" / part


def clear_cache() -> None:
    """Remove all parts of the cache."""
    for part in get_args(CachePart):
        folder = cache_folder(part)
        if folder.exists():
            shutil.rmtree(folder)
