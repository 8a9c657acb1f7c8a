"""How far long work has come: functions count their steps, and whoever wants to know listens.

Like logging, it needs no argument that is handed down through all that lies between, and it is silent by default::

    with listening(lambda stage, done, total: print(f"{stage}: {done} of {total}")):
        make_link_report(scorer, opened)
"""

from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import TypeVar

T = TypeVar("T")
Listener = Callable[[str, int, int], None]
"""Called with the name of a stage, the number of its steps that are done, at first 0, and their total."""

_listener: ContextVar[Listener | None] = ContextVar("listener", default=None)


@contextmanager
def listening(listener: Listener | None) -> Iterator[None]:
    """Tell a listener of the steps that are taken in this block."""
    token = _listener.set(listener)
    try:
        yield
    finally:
        _listener.reset(token)


def steps(stage: str, items: Collection[T]) -> Iterator[T]:
    """Yield the items of a stage of work one by one; each is done when the next one is asked for."""
    listener = _listener.get()
    for done, item in enumerate(items):
        if listener is not None:
            listener(stage, done, len(items))
        yield item
    if listener is not None:
        listener(stage, len(items), len(items))
