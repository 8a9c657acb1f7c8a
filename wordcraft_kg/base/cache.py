"""The user's cache for recipe books and language-model answers: ``wordcraft-kg`` in ~/.cache or ``XDG_CACHE_HOME``."""

import os
import shutil
from pathlib import Path
from typing import Literal, get_args

CachePart = Literal["books", "elicited"]
"""Parts: downloaded recipe books (books), and answers from language models (elicited)."""


def cache_folder(part: CachePart) -> Path:
    """Return the cache folder for a part, ``books`` or ``elicited``; the folder may not exist yet."""
    root = os.environ.get("XDG_CACHE_HOME")
    return (Path(root) if root else Path.home() / ".cache") / "wordcraft-kg" / part


def clear_cache() -> None:
    """Delete the whole cache: downloaded recipe books and stored language-model answers."""
    for part in get_args(CachePart):
        folder = cache_folder(part)
        if folder.exists():
            shutil.rmtree(folder)
