"""Progress of long computations: functions name stages and count steps, for a listener.

As with logging, no argument has to be passed down, and without a listener the work is silent::

    with listening(lambda stage, done, total: print(f"{stage}: {done} of {total}")):
        view_links(rank_links(scorer, opened))
"""

from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import TypeVar

T = TypeVar("T")
_Listener = Callable[[str, int, int], None]
"""Called with a stage's name, the finished steps (first 0, last the total), and the total."""

# A context variable and not a global: two threads of a server may listen to different work.
_listener: ContextVar[_Listener | None] = ContextVar("listener", default=None)


@contextmanager
def listening(listener: _Listener | None) -> Iterator[None]:
    """Call a listener during this ``with`` block, instead of any listener outside.

    Args:
        listener: called with stage, finished steps and total steps; None reports nothing.
    """
    token = _listener.set(listener)
    try:
        yield
    finally:
        _listener.reset(token)


def steps(stage: str, items: Collection[T]) -> Iterator[T]:
    """Yield the items of a named stage and report progress.

    An item is finished when the next item is requested. The total is reported at the end even if
    the loop is left early, so that no listener waits for ever.
    """
    listener = _listener.get()
    if listener is None:
        yield from items
        return
    # finally: a stage that ends with an error or a break ends for its listener, too.
    try:
        for number, item in enumerate(items):
            listener(stage, number, len(items))
            yield item
    finally:
        listener(stage, len(items), len(items))


@contextmanager
def stage(name: str) -> Iterator[None]:
    """Report the start and the end of this ``with`` block, or the decorated function."""
    yield from steps(name, [None])
