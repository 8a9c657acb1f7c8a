"""The line protocol for external players: a program reads JSON objects, a line each, and writes a line per answer.

The program reads stdin and writes stdout. The guide to text agents describes the keys of the JSON objects.
"""

import json
import os
import secrets
import shlex
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from queue import Empty, Full, Queue, SimpleQueue
from types import TracebackType
from typing import Self

from wordcraft_kg.apps.text_agents.conversation import Conversation
from wordcraft_kg.apps.text_agents.settings import TIMEOUT
from wordcraft_kg.base.errors import ConfigError, PlayerError
from wordcraft_kg.base.escaping import for_terminal
from wordcraft_kg.base.settings import number_in

MOST_CHARACTERS = 100_000
"""Most characters in an answer line; a language model may include reasoning."""
_MOST_LOG = 1_000_000
"""Most bytes of the program's stderr that are shown."""
_MOST_WAITING = 16
_PATIENCE = 5.0  # seconds between the end of the input and the exit
_MOST_ROUNDS = 20
"""Most searches for processes of a program: each may have started others meanwhile."""
_PASSED_ON = frozenset(
    (
        *(
            "PATH",
            "HOME",
            "USER",
            "LOGNAME",
            "SHELL",
            "LANG",
            "LANGUAGE",
            "TZ",
            "TERM",
            "TMPDIR",
            "TMP",
            "TEMP",
        ),
        *(
            "PYTHONPATH",
            "PYTHONHOME",
            "PYTHONUTF8",
            "PYTHONIOENCODING",
            "PYTHONHASHSEED",
            "VIRTUAL_ENV",
        ),
        *(
            "CONDA_PREFIX",
            "LD_LIBRARY_PATH",
            "DYLD_LIBRARY_PATH",
            "XDG_CACHE_HOME",
            "XDG_DATA_HOME",
        ),
        *("HF_HOME", "HF_HUB_CACHE", "HF_HUB_OFFLINE", "TRANSFORMERS_OFFLINE", "TORCH_HOME"),
        *("CUDA_VISIBLE_DEVICES", "CUDA_HOME", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "NO_PROXY"),
        # Windows starts no program without these.
        *(
            "SYSTEMROOT",
            "SYSTEMDRIVE",
            "COMSPEC",
            "PATHEXT",
            "USERPROFILE",
            "APPDATA",
            "LOCALAPPDATA",
            "WINDIR",
        ),
    )
)
"""Environment variables that a program receives, besides LC_* and WORDCRAFT_KG_*: neither keys nor tokens."""
_OWN_PREFIXES = ("LC_", "WORDCRAFT_KG_")
TAG = "WORDCRAFT_KG_PLAYER"
"""Environment variable of a program with a value of its own, by which all its processes are found."""


class LinePlayer:
    """A running program that plays by the line protocol; its name omits options, which may contain a secret.

    The program receives the environment variables of :func:`player_environment`. It runs as the present user, so this
    keeps keys from a program by mistake, not from one that reads the user's files or the memory of other processes.
    """

    def __init__(self, command: str, *, timeout: float = TIMEOUT):
        """Start a command (ConfigError if invalid) without a shell; ``timeout`` is seconds for an answer."""
        number_in("timeout", timeout, 1e-3, 1e6, "seconds, .001 to a million")
        self._timeout = timeout
        try:
            words = shlex.split(command)
        except ValueError as error:
            raise ConfigError(
                f"`player`: {error} in the command. Quote arguments as in a shell."
            ) from None
        if not words or "\0" in command:
            raise ConfigError(
                "`player` is empty or has a NUL: expected a command, such as 'python my_player.py'."
            )
        self.name = name_of(words)
        self._games = 0
        self._lines: Queue[bytes | None] = Queue(_MOST_WAITING)
        try:
            pipe = subprocess.PIPE
            self._tag = secrets.token_hex(16)
            self._process = subprocess.Popen(
                words,
                stdin=pipe,
                stdout=pipe,
                stderr=pipe,
                start_new_session=True,
                env=player_environment(os.environ) | {TAG: self._tag},
            )
        except OSError as error:
            raise PlayerError(
                f"player '{self.name}' cannot be started: {error.strerror or error}."
            ) from None
        # Direct writing would block on a program that does not read.
        self._unsent: SimpleQueue[bytes | None] = SimpleQueue()
        threads = [
            threading.Thread(target=work, daemon=True)
            for work in (self._read, self._write, self._log)
        ]
        for thread in threads:
            thread.start()
        self._logging = threads[-1]

    def __enter__(self) -> Self:
        """Return the player."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, _: TracebackType | None
    ) -> None:
        """Close the program's input; kill the program if it does not end, and all processes that it has started.

        On Linux these include processes in sessions of their own (``setsid``): descendants of the program, and
        processes with its tag in their environment, whose parents may have ended. A process that has lost its parents
        and also cleared its environment is not found; on other systems, only the program's process group ends.
        """
        self._unsent.put(None)
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(_PATIENCE if kind is None else 0.1)
        # The id of a program that has ended may belong to another process by now.
        is_running = self._process.poll() is None
        _kill_processes(self._process.pid if is_running else None, self._tag)
        with suppress(OSError, AttributeError):  # no process is left; Windows has no process groups
            os.killpg(self._process.pid, signal.SIGKILL)
        self._process.kill()
        self._process.wait()
        self._logging.join(1)

    def speaker(self, talk: Conversation) -> Callable[[str], str]:
        """Return a function that sends a prompt of the conversation ``talk`` to the program, and returns the answer."""
        self._games += 1
        number, is_new = self._games, True

        def answer(prompt: str) -> str:
            nonlocal is_new
            game = talk.game
            line = {
                "game": number,
                "new": is_new,
                "text": prompt,
                "goal": game.goal,
                "table": list(game.labels),
                "attempts_left": game.attempts_left,
            }
            is_new = False
            return self.ask(json.dumps(line, ensure_ascii=False))

        return answer

    def ask(self, line: str) -> str:
        """Send a line, and return the answer; PlayerError if the program has ended, is late or breaks the protocol."""
        if not self._lines.empty():
            self._receive(0)  # raises if the program has ended
            raise self._error(
                "wrote extra lines: expected one line per input line. Write everything else to stderr."
            )
        self._unsent.put(line.encode() + b"\n")
        return self._receive(self._timeout)

    def _receive(self, timeout: float) -> str:
        try:
            answer = self._lines.get(timeout=timeout) if timeout else self._lines.get_nowait()
        except Empty:
            raise self._error(
                f"did not answer within {self._timeout:g} seconds: expected one line per input line. Flush stdout "
                "after each line, or increase --timeout."
            ) from None
        if answer is None:
            code = None
            with suppress(subprocess.TimeoutExpired):
                code = self._process.wait(_PATIENCE)
            raise self._error(
                f"has ended{f' with exit code {code}' if code else ''} before the last game was over: expected "
                "a program that reads until the input ends."
            )
        if len(answer) > MOST_CHARACTERS:
            raise self._error(
                f"wrote a line of more than {MOST_CHARACTERS:,} bytes: expected two items, such as 'water + earth'."
            )
        return answer.decode(errors="replace").rstrip("\r\n")

    def _error(self, problem: str) -> PlayerError:
        return PlayerError(f"player '{self.name}' {problem}")

    def _write(self) -> None:
        stream = self._process.stdin
        assert stream is not None
        with suppress(OSError):  # the program has ended; earlier output may still be an answer
            while (line := self._unsent.get()) is not None:
                stream.write(line)
                stream.flush()
        with suppress(OSError):
            stream.close()

    def _read(self) -> None:
        stream = self._process.stdout
        assert stream is not None
        with suppress(OSError, ValueError, Full):
            while line := stream.readline(MOST_CHARACTERS + 1):
                self._lines.put(line, timeout=self._timeout)
            self._lines.put(None, timeout=self._timeout)
        stream.close()

    def _log(self) -> None:
        stream, room = self._process.stderr, _MOST_LOG
        assert stream is not None
        while line := stream.readline(1_000):
            if room > 0:
                text = line.decode(errors="replace").rstrip("\r\n")
                sys.stderr.write("\t".join(map(for_terminal, text.split("\t"))) + "\n")
                room -= len(line)
                if room <= 0:
                    sys.stderr.write(
                        f"{self.name}: more than {_MOST_LOG:,} bytes on stderr; the rest is not shown\n"
                    )
        stream.close()


def player_environment(variables: Mapping[str, str]) -> dict[str, str]:
    """Return the environment variables that a player's program receives: paths, language, caches and devices.

    Tokens and keys are not among them, because a program may be foreign. Proxies are passed on unless their address
    holds a password.
    """
    kept = {}
    for name, value in variables.items():
        is_proxy = name.upper() in ("HTTP_PROXY", "HTTPS_PROXY", "ALL_PROXY") and "@" not in value
        is_own = name.upper().startswith(_OWN_PREFIXES) and name != TAG
        if name.upper() in _PASSED_ON or is_proxy or is_own:
            kept[name] = value
    return kept


def _kill_processes(pid: int | None, tag: str) -> None:
    """Kill a program with all its processes, repeatedly, until no search finds any."""
    for _ in range(_MOST_ROUNDS):
        found = _processes_of(pid, tag)
        for one in found:
            with suppress(OSError):  # it has ended meanwhile
                os.kill(one, signal.SIGKILL)
        if not found:
            return


def _processes_of(pid: int | None, tag: str) -> set[int]:
    """Return the ids of the running processes that descend from ``pid`` or carry its tag; empty except on Linux."""
    mark = f"{TAG}={tag}".encode()
    parents: dict[int, int] = {}
    tagged: set[int] = set()
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            # Behind the name, which may hold blanks and brackets: state and parent.
            state, parent = (folder / "stat").read_bytes().rpartition(b")")[2].split()[:2]
            if state in (b"Z", b"X"):
                continue
            parents[int(folder.name)] = int(parent)
            if mark in (folder / "environ").read_bytes().split(b"\0"):
                tagged.add(int(folder.name))
        except (OSError, ValueError):  # it has ended, or belongs to another user
            continue
    found = set(tagged)
    if pid in parents:
        found.add(pid)
    while more := {child for child, parent in parents.items() if parent in found} - found:
        found |= more
    return found - {os.getpid()}


def name_of(words: list[str]) -> str:
    """Return a short name for a command: the script name for Python programs, else the program name."""
    is_python = Path(words[0]).stem.startswith("python") or words[0] == sys.executable
    for word in words[1:] if is_python else ():
        with suppress(OSError):  # code may take the place of a file name
            if not word.startswith("-") and Path(word).is_file():
                return Path(word).name
    return Path(words[0]).name
