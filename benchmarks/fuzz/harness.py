"""Running a command on bad input in this process, and what must hold afterwards whatever the input
was."""

import faulthandler
import gc
import io
import json
import logging
import os
import resource
import signal
import sys
import time
import traceback
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, redirect_stderr, redirect_stdout
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import Any
from unittest.mock import patch

from wordcraft_kg import cli

INTERRUPT_AFTER, TIME_LIMIT = (
    (4, 7),
    10,
)  # seconds of computing until Ctrl-C, Ctrl-C again, and failure
WAIT_LIMIT = 30  # seconds without computing until a command counts as waiting for ever
SERVERS = ("explore",), ("people", "serve"), ("mcp",), ("serve", "openenv")
"""Commands that wait for requests."""
SERVED = 1  # seconds of waiting until Ctrl-C for a server
MEMORY_LIMIT = 2 * 2**30  # bytes for a command
EXIT_CODES = (0, 1, 2, 130)
IN = "in"  # folder of the sandbox that a command must not change,
CONTINUED = f"{IN}/continued"  # except for the run to continue


class Hang(BaseException):
    """A command did not end; no ``except Exception`` of the package holds it."""


@dataclass(frozen=True)
class Trial:
    """A case: what was done to the input, and the commands that are given it, one after another."""

    what: str
    commands: tuple[tuple[str, ...], ...]  # paths are relative to the sandbox
    may_be_interrupted: bool = (
        False  # the amount of work may have been spoilt, so that Ctrl-C is a fair end
    )
    typed: bytes = b"1\n" * 40 + b"q\n"


@dataclass(frozen=True)
class Outcome:
    """How a command ended."""

    code: int | None
    out: str
    err: str
    problem: str = ""


@contextmanager
def limits(*, is_server: bool = False) -> Iterator[None]:
    """Press Ctrl-C for a command that computes for long; end one that does not heed it, or waits
    for ever."""
    seconds, computed, is_pressed = 0, time.process_time(), False

    def tick(signum: int, frame: FrameType | None) -> None:
        nonlocal seconds
        seconds += 1
        if seconds >= TIME_LIMIT:
            raise Hang(f"more than {TIME_LIMIT} s of computing")
        if seconds in INTERRUPT_AFTER:
            signal.raise_signal(signal.SIGINT)

    def alarm(signum: int, frame: FrameType | None) -> None:
        nonlocal computed, is_pressed
        before, computed = computed, time.process_time()
        if is_server and not is_pressed:
            if computed - before < 0.1:
                is_pressed = True
                signal.raise_signal(signal.SIGINT)
        elif computed - before < 0.01:
            raise Hang(f"waits for ever: {WAIT_LIMIT} s")
        signal.alarm(SERVED if is_server and not is_pressed else WAIT_LIMIT)

    handlers = {
        signal.SIGPROF: tick,
        signal.SIGALRM: alarm,
        signal.SIGINT: signal.default_int_handler,
    }
    before = {number: signal.signal(number, handler) for number, handler in handlers.items()}
    memory = resource.getrlimit(resource.RLIMIT_AS)
    in_use = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (in_use + MEMORY_LIMIT, memory[1]))
    signal.setitimer(signal.ITIMER_PROF, 1, 1)
    signal.alarm(SERVED if is_server else WAIT_LIMIT)
    # For what does not come back from C: then nothing else can be tried in this process.
    faulthandler.dump_traceback_later(20 * WAIT_LIMIT, exit=True, file=sys.__stderr__)  # type: ignore[arg-type]
    try:
        yield
    finally:
        faulthandler.cancel_dump_traceback_later()
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.alarm(0)
        resource.setrlimit(resource.RLIMIT_AS, memory)
        for number, handler in before.items():
            signal.signal(number, handler)


@contextmanager
def as_in_a_new_process(folder: Path, typed: bytes) -> Iterator[tuple[io.BytesIO, io.BytesIO]]:
    """Work in a folder, with streams that are as strict as the real ones, and put all global state
    back."""
    out, err = io.BytesIO(), io.BytesIO()
    streams = (io.TextIOWrapper(out, "utf-8"), io.TextIOWrapper(err, "utf-8", "backslashreplace"))
    where, collection, stdin = Path.cwd(), gc.get_threshold(), sys.stdin
    handlers = list(logging.root.handlers)
    logging.root.handlers.clear()
    _log_to(streams[1])
    os.chdir(folder)
    sys.stdin = io.TextIOWrapper(io.BytesIO(typed), "utf-8")
    try:
        with redirect_stdout(streams[0]), redirect_stderr(streams[1]):
            yield out, err
    finally:
        for stream in streams:
            stream.detach()  # flushes it, and leaves its bytes readable
        logging.captureWarnings(False)
        _log_to(sys.__stderr__)
        logging.root.handlers[:] = handlers
        gc.set_threshold(*collection)
        sys.stdin = stdin
        os.chdir(where)


def _log_to(stream: Any) -> None:
    """Let the handlers that libraries made for themselves write to a stream: they keep the one they
    began with."""
    for logger in logging.root.manager.loggerDict.values():
        for handler in getattr(logger, "handlers", ()):
            if type(handler) is logging.StreamHandler:
                handler.stream = stream  # not setStream, which flushes one that may be gone
                if hasattr(handler.formatter, "stream"):  # colorlog asks whether it is a terminal
                    handler.formatter.stream = stream


def call(arguments: Sequence[str], folder: Path, typed: bytes = b"") -> Outcome:
    """Run a command in a folder."""
    code: int | None = None
    problem = ""
    with ExitStack() as stack:
        out, err = stack.enter_context(as_in_a_new_process(folder, typed))
        try:
            is_server = any(tuple(arguments[: len(words)]) == words for words in SERVERS)
            offline = patch("huggingface_hub.constants.HF_HUB_OFFLINE", True)
            with limits(is_server=is_server), offline:
                code = cli.main(list(arguments))
        except Hang as hang:
            problem = f"{hang}\n{traceback.format_exc(limit=-8)}"
        except BaseException:
            problem = traceback.format_exc(limit=-8)
    texts = [stream.getvalue().decode("utf-8", "replace") for stream in (out, err)]
    return Outcome(code, *texts, problem)


def state_of(folder: Path) -> dict[str, tuple[Any, ...]]:
    """Return what lies in a folder, by path, with what changes when it is written."""
    entries: dict[str, tuple[Any, ...]] = {}
    for path in folder.rglob("*"):
        stat = path.lstat()
        if path.is_symlink():
            entry: tuple[Any, ...] = ("link", os.readlink(path))
        else:
            entry = (
                (stat.st_mode, stat.st_size, stat.st_mtime_ns, stat.st_ino)
                if path.is_file()
                else (stat.st_mode,)
            )
        entries[str(path.relative_to(folder))] = entry
    return entries


def problems_of(trial: Trial, sandbox: Path) -> list[str]:
    """Run a case's commands in its sandbox and return what is wrong with their answers; nothing
    should be."""
    problems = []
    after = state_of(sandbox)
    for number, command in enumerate(trial.commands):
        before = after
        outcome = call(command, sandbox, trial.typed)
        after = state_of(sandbox)
        wrong = [*_of_answer(outcome, trial), *_of_files(outcome, before, after, sandbox)]
        shown = " ".join(map(repr, command))
        problems += [
            f"{trial.what}\n  {number + 1}: wordcraft-kg {shown}\n  {reason}" for reason in wrong
        ]
    return problems


def _of_answer(outcome: Outcome, trial: Trial) -> Iterator[str]:
    if outcome.problem:
        yield outcome.problem
        return
    if outcome.code not in EXIT_CODES:
        yield f"exit code {outcome.code}"
    for sign in ("Traceback (most recent call last)", "MemoryError", "<class '", "object at 0x"):
        if sign in outcome.err or sign in outcome.out:
            yield f"says {sign!r}: {outcome.err[:1000]} ... {outcome.err[-1000:]}"
    if outcome.code == 130 and not trial.may_be_interrupted:
        yield f"still at work after {INTERRUPT_AFTER[0]} s"
    if outcome.code in (1, 2, 130) and not (outcome.err or outcome.out).strip():
        yield f"exit code {outcome.code} without a word"


def _of_files(
    outcome: Outcome,
    before: dict[str, tuple[Any, ...]],
    after: dict[str, tuple[Any, ...]],
    sandbox: Path,
) -> Iterator[str]:
    """Name inputs that changed, temporary files that stayed, and outputs that a failed command left
    behind."""
    changed = [path for path in before | after if before.get(path) != after.get(path)]
    for path in changed:
        if path.startswith(f"{IN}/") and not path.startswith(CONTINUED):
            yield f"the input {path} was changed"
        if path not in before and any(part.startswith(".") for part in path.split("/")):
            yield f"the temporary {path} was left behind"
        is_new_output = "/" not in path and path not in before and not outcome.problem
        if is_new_output and outcome.code != 0 and not _may_stay(outcome, sandbox / path):
            yield f"exit code {outcome.code}, but {path} was written ({outcome.err[-300:]})"


def _may_stay(outcome: Outcome, out: Path) -> bool:
    """Return whether an output of a command that failed is whole nevertheless, or a run that can be
    resumed."""
    if "CHECK FAILED" in outcome.err or (outcome.code == 1 and (out / "report.json").is_file()):
        return True
    if (
        out.suffix == ".jsonl" or (out / "games.jsonl").is_file()
    ):  # answers and games are kept one by one
        return True
    try:
        return bool(
            json.loads((out / "run.json").read_text())["status"]
            in ("interrupted", "failed", "done")
        )
    except (OSError, ValueError, KeyError):
        return False
