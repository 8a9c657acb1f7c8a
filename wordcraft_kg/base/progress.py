"""How far long work has come: functions name their stages and count their steps, and whoever wants to know listens.

As with logging, nothing has to be handed down through all that lies between, and without a listener it is silent::

    with listening(lambda stage, done, total: print(f"{stage}: {done} of {total}")):
        make_link_report(scorer, opened)
"""

from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import TypeVar

T = TypeVar("T")
Listener = Callable[[str, int, int], None]
"""Called with the name of a stage, the number of its steps that are done (first 0, last the total), and their total.

Stages may be nested: another one may begin and end before the next step."""

_listener: ContextVar[Listener | None] = ContextVar("listener", default=None)


@contextmanager
def listening(listener: Listener | None) -> Iterator[None]:
    """Tell a listener of the stages of the work in this block; None tells nobody."""
    token = _listener.set(listener)
    try:
        yield
    finally:
        _listener.reset(token)


def steps(stage: str, items: Collection[T]) -> Iterator[T]:
    """Yield the items of a stage one by one; an item is a step, done when the next one is asked for."""
    listener = _listener.get()
    if listener is None:
        yield from items
        return
    try:
        for done, item in enumerate(items):
            listener(stage, done, len(items))
            yield item
    finally:
        listener(stage, len(items), len(items))


@contextmanager
def stage(name: str) -> Iterator[None]:
    """Name the work in this block, or in the function decorated with it, a stage of one step."""
    yield from steps(name, [None])
