"""Players outside of this process: programs by the line protocol, and models behind an address.

Any program that reads and writes lines can play. The program is started once. It reads a JSON
object in a line from stdin, and writes a line with the answer to stdout, until its input ends:

| key | meaning |
|---|---|
| game | number of the game since the program was started, from 1 |
| new | whether the game begins with this line |
| text | prompt: at first the rules, later the last result, and always the state |
| goal | entity to make; null in the open-ended world |
| table | entities that can be combined, in the order of their numbers |
| attempts_left | attempts left, including the current attempt |

A program may be foreign, and it may hang, crash, write without end or leave processes behind. So
each pipe has a thread of its own, every wait has a limit, and the program's environment holds no
keys. Its stderr is that of this process.

A :class:`ChatServer` is a model behind the chat completions API. The key comes from the environment
alone, and no message shows it. A redirection is refused, since it would carry the key to another
server.
"""

import itertools
import json
import os
import re
import shlex
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Mapping
from contextlib import AbstractContextManager, suppress
from http.client import HTTPException
from pathlib import Path
from queue import Empty, Full, Queue, SimpleQueue
from types import TracebackType
from typing import Any
from urllib.error import HTTPError, URLError
from urllib.request import HTTPRedirectHandler, Request, build_opener

from wordcraft_kg.apps.text_agents.conversation import Conversation
from wordcraft_kg.apps.text_agents.settings import TIMEOUT
from wordcraft_kg.base import ConfigError, PlayerError, for_terminal, number_in

MOST_CHARACTERS = 100_000
"""Most characters in an answer line; a language model may include reasoning."""
# Lines that a program has written and nobody has read. There should be one: more are an error, and
# a program that writes without end must not fill the memory.
_MOST_WAITING = 16
_PATIENCE = 5.0
"""Seconds between the end of the input and the exit."""
# A list of what is passed on, not of what is kept back: nobody knows the names of all keys.
_PASSED_ON = frozenset(
    (
        # The user and the machine.
        *("PATH", "HOME", "USER", "LOGNAME", "SHELL", "TERM", "TMPDIR", "TMP", "TEMP"),
        *("LANG", "LANGUAGE", "TZ"),
        # Python, and the environment in which its packages lie.
        *("PYTHONPATH", "PYTHONHOME", "PYTHONUTF8", "PYTHONIOENCODING", "PYTHONHASHSEED"),
        *("VIRTUAL_ENV", "CONDA_PREFIX", "LD_LIBRARY_PATH", "DYLD_LIBRARY_PATH"),
        # Caches of models, and devices; without HF_TOKEN.
        *("XDG_CACHE_HOME", "XDG_DATA_HOME", "HF_HOME", "HF_HUB_CACHE", "HF_HUB_OFFLINE"),
        *("TRANSFORMERS_OFFLINE", "TORCH_HOME", "CUDA_VISIBLE_DEVICES", "CUDA_HOME"),
        *("OMP_NUM_THREADS", "MKL_NUM_THREADS", "NO_PROXY"),
        # Windows starts no program without these.
        *("SYSTEMROOT", "SYSTEMDRIVE", "COMSPEC", "PATHEXT", "WINDIR"),
        *("USERPROFILE", "APPDATA", "LOCALAPPDATA"),
    )
)
"""Environment variables that a program receives, besides LC_* and WORDCRAFT_KG_*."""


class LinePlayer(AbstractContextManager["LinePlayer"]):
    """A running program that plays by the line protocol.

    The program receives the environment variables of :func:`player_environment`. It runs as the
    present user, so this keeps keys from a program by mistake, not from one that reads the user's
    files or the memory of other processes.

    Attributes:
        name: name of the script or program in results; without options, which may hold a secret.

    Example:
        >>> with LinePlayer("python examples/line_player.py") as player:
        ...     player.name
        'line_player.py'
    """

    def __init__(self, command: str, *, timeout: float = TIMEOUT):
        """Start a program without a shell.

        Args:
            command: program and arguments as a user types them, with quotes.
            timeout: seconds for an answer.

        Raises:
            ConfigError: if the command cannot be parsed, or the time is out of range.
            PlayerError: if the program cannot be started.
        """
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
            # A session of its own: Ctrl-C reaches this process alone, which then saves the games
            # and ends the program; and the program's process group can be killed as a whole.
            self._process = subprocess.Popen(
                words,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                start_new_session=True,
                env=player_environment(os.environ),
            )
        except OSError as error:
            raise PlayerError(
                f"player '{self.name}' cannot be started: {error.strerror or error}."
            ) from None
        # Direct writing would block on a program that does not read.
        self._unsent: SimpleQueue[bytes | None] = SimpleQueue()
        # Daemons: a thread that waits for a pipe must not keep this process from ending.
        threading.Thread(target=self._read, daemon=True).start()
        threading.Thread(target=self._write, daemon=True).start()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, _: TracebackType | None
    ) -> None:
        """Close the program's input, and kill what is left of the program.

        A program has a few seconds to end by itself, or none after an error. The processes that it
        has started end with it, apart from those that it put into sessions of their own.
        """
        self._unsent.put(None)
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(_PATIENCE if kind is None else 0.1)
        # No process is left; Windows has no process groups.
        with suppress(OSError, AttributeError):
            os.killpg(self._process.pid, signal.SIGKILL)
        self._process.kill()
        self._process.wait()

    def answer(self, talk: Conversation) -> str:
        """Return the answer to the last message of a game; raises PlayerError as :meth:`ask`."""
        is_new = len(talk.messages) == 1
        self._games += is_new
        game = talk.game
        line = {
            "game": self._games,
            "new": is_new,
            "text": talk.messages[-1],
            "goal": game.goal,
            "table": list(game.labels),
            "attempts_left": game.attempts_left,
        }
        return self.ask(json.dumps(line, ensure_ascii=False))

    def ask(self, line: str) -> str:
        """Send a line, and return the answer.

        Raises:
            PlayerError: if the program has ended, does not answer in time, or writes what is no
                answer to this line.
        """
        # A line that came before the question would be taken for the answer, and all later answers
        # would be one line late.
        if not self._lines.empty():
            # This raises if the program has ended.
            self._receive(0)
            raise self._error(
                "wrote extra lines: expected one line per input line. Write everything else to "
                "stderr."
            )
        self._unsent.put(line.encode() + b"\n")
        return self._receive(self._timeout)

    def _receive(self, timeout: float) -> str:
        try:
            answer = self._lines.get(timeout=timeout)
        except Empty:
            raise self._error(
                f"did not answer within {self._timeout:g} seconds: expected one line per input "
                "line. Flush stdout "
                "after each line, or increase --timeout."
            ) from None
        if answer is None:
            # The output has ended; the exit code comes a little later.
            code = None
            with suppress(subprocess.TimeoutExpired):
                code = self._process.wait(_PATIENCE)
            with_code = f" with exit code {code}" if code else ""
            raise self._error(
                f"has ended{with_code} before the last game was over: expected "
                "a program that reads until the input ends."
            )
        if len(answer) > MOST_CHARACTERS:
            raise self._error(
                f"wrote a line of more than {MOST_CHARACTERS:,} bytes: expected two items, such as "
                "'water + earth'."
            )
        return _message_in(answer.decode(errors="replace").rstrip("\r\n"))

    def _error(self, problem: str) -> PlayerError:
        return PlayerError(f"player '{self.name}' {problem}")

    def _write(self) -> None:
        """Pass on the lines for the program, and close its input at the end; runs in a thread."""
        stream = self._process.stdin
        assert stream is not None
        # The program has ended; earlier output may still be an answer.
        with suppress(OSError):
            while (line := self._unsent.get()) is not None:
                stream.write(line)
                stream.flush()
        with suppress(OSError):
            stream.close()

    def _read(self) -> None:
        """Pass on the program's lines as long as somebody takes them; runs in a thread.

        None is the end of the output.
        """
        stream = self._process.stdout
        assert stream is not None
        with suppress(OSError, ValueError, Full):
            # With a limit: a program may write without a line break.
            while line := stream.readline(MOST_CHARACTERS + 1):
                self._lines.put(line, timeout=self._timeout)
            self._lines.put(None, timeout=self._timeout)
        stream.close()


def player_environment(variables: Mapping[str, str]) -> dict[str, str]:
    """Return the environment variables that a player's program receives.

    These are paths, language, caches and devices. Tokens and keys are not among them, because a
    program may be foreign. Proxies are passed on unless their address holds a password.
    """

    def is_passed(name: str, value: str) -> bool:
        if name in ("HTTP_PROXY", "HTTPS_PROXY", "ALL_PROXY"):
            return "@" not in value
        return name in _PASSED_ON or name.startswith(("LC_", "WORDCRAFT_KG_"))

    return {name: value for name, value in variables.items() if is_passed(name.upper(), value)}


def _message_in(line: str) -> str:
    """Return the message in a line: a JSON string holds one of several lines."""
    with suppress(ValueError, RecursionError):
        message = json.loads(line)
        if isinstance(message, str):
            # Half of a surrogate pair cannot be written into a record.
            return message.encode(errors="replace").decode()
    return line


def name_of(words: list[str]) -> str:
    """Return a short name for a command: for Python programs the script's, else the program's.

    Never an option, which may hold a key: names stand in results.
    """
    is_python = Path(words[0]).stem.startswith("python") or words[0] == sys.executable
    # Code may take the place of a file name.
    scripts = [word for word in words[1:] if os.path.isfile(word)]
    return Path(scripts[0] if is_python and scripts else words[0]).name


KEY = "OPENAI_API_KEY"
"""Environment variable with the key; servers on this machine need none."""
_PAUSES = (0, 1, 2, 4, 8)
"""Seconds before each request for an answer."""
_ADDRESS = re.compile(
    r"https?://(\[[0-9a-fA-F:.]+\]|[^\s/:\[\]]+)(:[0-9]{1,5})?(/\S*)?", re.IGNORECASE
)
"""Addresses of HTTP: a host, by name or number, with a port and a path or without."""
_BUSY = (408, 409, 429, 500, 502, 503, 504)
"""Statuses after which another request may succeed."""
_MOST_TOKENS = 1_000
_LONGEST_REPLY = 1_000_000
"""Bytes of a server's reply that are read."""


class _NoRedirects(HTTPRedirectHandler):
    def redirect_request(self, *_: Any) -> None:
        """Redirect nowhere: the reply becomes an HTTPError."""


def _text_in(content: Any) -> str:
    """Return the text of a message: a text, or a list of parts of which some have text.

    Raises TypeError, LookupError or AttributeError for another content.
    """
    # Reasoning models may leave the answer empty when their tokens run out.
    if content is None:
        return ""
    if isinstance(content, str):
        return content
    return "".join(part["text"] for part in content if part["type"] == "text")


class ChatServer:
    """A model behind an address; games may go on at once.

    Attributes:
        name: the model's name.
    """

    def __init__(self, model: str, base_url: str, timeout: float, pause: float = 1.0):
        """Take an address; nothing is sent yet.

        Args:
            model: the model's name on the server.
            base_url: address of the API, such as ``http://127.0.0.1:8000/v1``.
            timeout: seconds for a reply.
            pause: factor of the pauses between requests.

        Raises:
            ConfigError: if the address is none of HTTP, or the key cannot be sent.
        """
        if not _ADDRESS.fullmatch(base_url):
            raise ConfigError(
                f"`base_url` '{base_url[:100]}': expected the address of a chat completions API, "
                f"such as http://127.0.0.1:8000/v1. Its key is read from {KEY}."
            )
        self.name = model
        self._address = f"{base_url.rstrip('/')}/chat/completions"
        self._timeout = timeout
        self._pause = pause
        # Files of settings often end a key by a line break.
        self._key = os.environ.get(KEY, "").strip()
        if not (self._key.isascii() and (self._key + "0").isprintable()):
            raise ConfigError(
                f"{KEY} has a letter that no key has; expected ASCII letters, digits and signs. "
                "Copy the key again."
            )
        self._opener = build_opener(_NoRedirects())

    def answer(self, talk: Conversation) -> str:
        """Return the answer to the last message of a game; raises PlayerError as :meth:`ask`."""
        roles = itertools.cycle(("user", "assistant"))
        turns = zip(roles, talk.messages, strict=False)
        return self.ask([{"role": role, "content": text} for role, text in turns])

    def ask(self, messages: list[dict[str, str]]) -> str:
        """Return the model's answer to a conversation.

        Raises:
            PlayerError: if the server is down, refuses the request, or replies something else.
        """
        body = {
            "model": self.name,
            "messages": messages,
            "temperature": 0,
            "max_tokens": _MOST_TOKENS,
        }
        headers = {"Content-Type": "application/json"}
        if self._key:
            headers["Authorization"] = f"Bearer {self._key}"
        request = Request(self._address, json.dumps(body).encode(), headers)
        for pause in _PAUSES:
            time.sleep(self._pause * pause)
            try:
                with self._opener.open(request, timeout=self._timeout) as response:
                    return self._read(response.read(_LONGEST_REPLY))
            except HTTPError as error:
                content = error.read(_LONGEST_REPLY).decode("utf-8", "replace")
                failure = f"answers with {error.code}: {content or error.reason}"
                if error.code not in _BUSY:
                    break
            except TimeoutError:
                failure = f"has not answered in {self._timeout:g} seconds"
            except (URLError, HTTPException, OSError, ValueError) as error:
                # A ValueError is of an address that no request can have, such as http://../v1.
                failure = f"does not answer ({getattr(error, 'reason', error)}). Start the server"
                break
        raise PlayerError(f"{self._address} {self._shown(failure)}.")

    def _read(self, data: bytes) -> str:
        try:
            return _text_in(json.loads(data)["choices"][0]["message"]["content"])
        except (LookupError, TypeError, ValueError, AttributeError):
            shown = self._shown(data.decode("utf-8", "replace"))
            raise PlayerError(
                f"{self._address} answers '{shown}'; expected a reply of a chat completions API."
            ) from None

    def _shown(self, text: str) -> str:
        """Return a server's words in one line, without the key, which some servers repeat."""
        public_text = text.replace(self._key, "***") if self._key else text
        return for_terminal(" ".join(public_text.split()))[:2_000].rstrip(".")


TextPlayer = LinePlayer | ChatServer
"""A program or a model that plays by text, several games one after another or at a time."""
