"""A language model behind the chat completions API, as a player of many games at a time.

The key comes from the environment alone, and no message shows it. A redirection is refused, since
it would carry the key to another server.
"""

import json
import os
import time
from collections.abc import Callable
from http.client import HTTPException
from typing import Any
from urllib.error import HTTPError, URLError
from urllib.parse import urlsplit
from urllib.request import HTTPRedirectHandler, Request, build_opener

from wordcraft_kg.apps.text_agents.conversation import Conversation
from wordcraft_kg.base import ConfigError, PlayerError, for_terminal

KEY = "OPENAI_API_KEY"
"""Environment variable with the key; servers on this machine need none."""
_TRIES = 5
"""Requests for an answer, with pauses of 1, 2, 4 and 8 seconds."""
_BUSY = (408, 409, 429, 500, 502, 503, 504)
"""Statuses after which another request may succeed."""
_MOST_TOKENS = 1_000
_LONGEST_REPLY = 1_000_000
"""Bytes of a server's reply that are read."""


class _NoRedirects(HTTPRedirectHandler):
    def redirect_request(self, *_: Any) -> None:
        """Redirect nowhere: the reply becomes an HTTPError."""


def _is_address(text: str) -> bool:
    try:
        parts = urlsplit(text)
        # Reading a port raises ValueError for one that is no number.
        return parts.scheme in ("http", "https") and bool(parts.hostname) and parts.port != 0
    except ValueError:
        return False


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
            pause: seconds before the second request; each further pause is twice as long.

        Raises:
            ConfigError: if the address is none of HTTP, or the key cannot be sent.
        """
        if not _is_address(base_url):
            raise ConfigError(
                f"`base_url` '{base_url[:100]}': expected the address of a chat completions API, "
                "such as http://127.0.0.1:8000/v1."
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

    def speaker(self, talk: Conversation) -> Callable[[str], str]:
        """Begin a game: return a function from a prompt in this conversation to the answer."""
        messages: list[dict[str, str]] = []

        def answer(prompt: str) -> str:
            messages.append({"role": "user", "content": prompt})
            text = self.ask(messages)
            messages.append({"role": "assistant", "content": text})
            return text

        return answer

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
        for number in range(_TRIES):
            try:
                with self._opener.open(request, timeout=self._timeout) as response:
                    return self._read(response.read(_LONGEST_REPLY))
            except HTTPError as error:
                content = error.read(_LONGEST_REPLY).decode("utf-8", "replace")
                failure = f"answers with {error.code}: {content or error.reason}"
                is_final = error.code not in _BUSY
            except TimeoutError:
                failure = f"has not answered in {self._timeout:g} seconds"
                is_final = False
            except (URLError, HTTPException, OSError) as error:
                failure = f"does not answer ({getattr(error, 'reason', error)}). Start the server"
                is_final = True
            if is_final or number + 1 == _TRIES:
                break
            time.sleep(self._pause * 2**number)
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
