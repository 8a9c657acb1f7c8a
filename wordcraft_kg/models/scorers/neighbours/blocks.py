"""Blocks of entities that threads share; results do not depend on the number of threads."""

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

from wordcraft_kg.base.settings import cores

ROWS = 2_048
"""Entities of a block. Sums over blocks are rounded by it, so models depend on it."""

B = TypeVar("B")
R = TypeVar("R")


def blocks_of(size: int) -> list[slice]:
    """Return the blocks of ``size`` entities, in order."""
    return [slice(start, min(start + ROWS, size)) for start in range(0, size, ROWS)]


def of_blocks(
    work: Callable[[B], R], blocks: Sequence[B], max_threads: int | None = None
) -> Iterator[R]:
    """Yield ``work(block)`` for each block, in the order of blocks, computed by several threads.

    Args:
        work: called by several threads at once; its time should go to NumPy or compiled loops,
            which run without Python's lock.
        blocks: from :func:`blocks_of`, or others.
        max_threads: None for as many as there are cores.
    """
    threads = min(max_threads or cores(), len(blocks))
    if threads <= 1:
        yield from map(work, blocks)
        return
    with ThreadPoolExecutor(threads) as pool:
        yield from pool.map(work, blocks)


def write_blocks(work: Callable[[slice], None], blocks: Sequence[slice]) -> None:
    """Call ``work(block)`` for each block, as :func:`of_blocks`, and wait for the last one."""
    for _ in of_blocks(work, blocks):
        pass
