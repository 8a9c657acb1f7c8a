"""Garbage collections that leave out what was imported."""

import gc
from contextlib import contextmanager


@contextmanager
def frozen():
    """Exempt the objects of this process from collections, which PyKEEN's pipeline asks for.

    Each takes .3 s for all modules that the tests import. `pykeen_guard` does this in the package.
    """
    gc.freeze()
    try:
        yield
    finally:
        gc.unfreeze()
