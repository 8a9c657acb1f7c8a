"""Handle Ctrl-C as a request to save and stop."""

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any


@contextmanager
def first_interrupt() -> Iterator[threading.Event]:
    """Yield an event that the first Ctrl-C sets; the second Ctrl-C stops at once."""
    requested, before = threading.Event(), signal.getsignal(signal.SIGINT)

    def request(signum: int, frame: Any) -> None:
        requested.set()
        signal.signal(signal.SIGINT, before)

    with _handling(signal.SIGINT, request):
        yield requested


@contextmanager
def sigterm_as_interrupt() -> Iterator[None]:
    """Treat SIGTERM (the stop signal of cluster and service managers) as Ctrl-C in this block."""
    with _handling(signal.SIGTERM, signal.default_int_handler):
        yield


@contextmanager
def _handling(number: signal.Signals, handler: Callable[[int, Any], None]) -> Iterator[None]:
    """Handle a signal in this block; nothing changes outside the main thread, which cannot set handlers."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(number, handler)
    try:
        yield
    finally:
        signal.signal(number, before)


def interruption_message(folder: Path, unit: str, number: int) -> str:
    """Return the message for an interrupted run: the saved checkpoint (such as epoch 20), and how to resume."""
    return f"interrupted; {unit} {number:,} is saved in '{folder}'. Repeat the command to resume from there."
