"""Handle Ctrl-C as a request to save and stop."""

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any


@contextmanager
def first_interrupt(action: Callable[[], None] | None = None) -> Iterator[threading.Event]:
    """Yield an event that the first Ctrl-C sets; the second Ctrl-C stops at once.

    The training looks at the event after each step or epoch, where its state is whole.

    Args:
        action: called by the first Ctrl-C, for a wait that looks at no event.
    """
    requested = threading.Event()
    before = signal.getsignal(signal.SIGINT)

    def request(signum: int, frame: Any) -> None:
        requested.set()
        if action is not None:
            action()
        signal.signal(signal.SIGINT, before)

    with _handling(signal.SIGINT, request):
        yield requested


@contextmanager
def sigterm_as_interrupt() -> Iterator[None]:
    """Treat SIGTERM (the stop signal of cluster and service managers) as Ctrl-C in this block."""

    def interrupt(signum: int, frame: Any) -> None:
        signal.raise_signal(signal.SIGINT)

    with _handling(signal.SIGTERM, interrupt):
        yield


@contextmanager
def _handling(number: signal.Signals, handler: Callable[[int, Any], None]) -> Iterator[None]:
    """Handle a signal in this block; only the main thread can, others change nothing."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(number, handler)
    try:
        yield
    finally:
        signal.signal(number, before)


def interruption_message(
    folder: Path,
    unit: str,
    number: int,
) -> str:
    """Return the message for an interrupted run.

    Args:
        folder: the run folder.
        unit: epoch or step.
        number: number of the saved checkpoint.
    """
    saved = f"{unit} {number:,} is saved in '{folder}'"
    return f"interrupted; {saved}. Repeat the command to resume from there."
