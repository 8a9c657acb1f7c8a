"""Asking an endpoint that speaks as OpenAI's, again and again where that helps, and never saying its key."""

import logging
import os
import random
import threading
import time
from datetime import UTC, datetime
from email.utils import parsedate_to_datetime
from typing import Any

import msgspec

from wordcraft_kg.apps.elicitation.answers import Answer
from wordcraft_kg.apps.elicitation.config import OPENAI_KEY, AskingConfig, OpinionsConfig
from wordcraft_kg.apps.elicitation.prompts import Request
from wordcraft_kg.base.errors import ConfigError, EndpointError
from wordcraft_kg.base.extras import check_extra

FIRST_WAIT, LONGEST_WAIT = 0.5, 30.0
"""Seconds before the first retry, and the most that the wait grows to; it doubles each time."""
LONGEST_ASKED = 300.0
"""Seconds that an endpoint may tell us to wait; if it wants more, we stop."""
BUSY = (408, 409, 425, 429)
"""Refusals that pass; so do all errors of the server, from 500."""
NO_MONEY = "insufficient_quota"
HIDDEN = "(key)"
LEAST_KEY = 6
"""Letters of a key from which on it is taken out of texts; a shorter one, such as "none", is a word and no secret."""
MOST_SAID = 300
"""Characters of an endpoint's own words that are repeated."""


class Stopped(Exception):
    """A prompt was given up, because nothing more is asked."""


class Endpoint:
    """An endpoint, and how it is asked; several threads may ask at once.

    Attributes:
        stop: ends waiting, so that nothing more is asked.
    """

    def __init__(self, config: OpinionsConfig):
        """Read the key and prepare a client; nothing is sent.

        Raises:
            MissingExtraError: if the client's library is not installed.
            ConfigError: if there is no such key, or it is none.
        """
        check_extra("opinions")
        import openai

        self.config = config
        self.stop = threading.Event()
        self._settings: AskingConfig = config.settings
        self._key = _key_of(config)
        self._has_answered = False
        self._told: set[str] = set()
        self._openai = openai
        self._client = openai.OpenAI(
            api_key=self._key or "none",
            base_url=config.endpoint,
            timeout=self._settings.timeout,
            max_retries=0,  # what is worth asking again is decided here
        )

    def ask(self, request: Request) -> Answer:
        """Return the answer to a request.

        Raises:
            EndpointError: if the endpoint refuses it, or has not answered after all retries.
            Stopped: if :attr:`stop` was set before it was answered.
        """
        for attempt in range(self._settings.retries + 1):
            if self.stop.is_set():
                raise Stopped
            try:
                answer = self._ask_once(request)
            except _AgainError as problem:
                is_last = attempt == self._settings.retries
                if problem.wait > LONGEST_ASKED:
                    raise self._error(f"{problem}, and asks us to wait for {problem.wait:,.0f} seconds.") from None
                if is_last:
                    raise self._error(f"{problem} ({attempt + 1} times in a row).") from None
                self._tell(str(problem))
                # As several prompts wait at the same time, they do not come back at the same time.
                backoff = min(FIRST_WAIT * 2**attempt, LONGEST_WAIT) * random.uniform(0.5, 1.0)
                self.stop.wait(max(backoff, problem.wait))
            else:
                self._has_answered = True
                return answer
        raise Stopped

    def _tell(self, problem: str) -> None:
        """Warn of a problem, once: with a busy endpoint there would be a line for each prompt."""
        level = logging.INFO if problem in self._told else logging.WARNING
        self._told.add(problem)
        logging.getLogger(__name__).log(level, "the endpoint %s; asking again", problem)

    def _ask_once(self, request: Request) -> Answer:
        given: dict[str, Any] = {"temperature": request.temperature, "seed": request.seed}
        openai = self._openai
        try:
            raw = self._client.chat.completions.with_raw_response.create(
                model=request.model,
                messages=[{"role": one.role, "content": one.content} for one in request.messages],  # type: ignore[misc]
                **{name: value for name, value in given.items() if value is not None},
            )
            body = raw.http_response.content
        except openai.APITimeoutError:
            raise _AgainError(f"has not answered within {self._settings.timeout:g} seconds") from None
        except openai.APIStatusError as error:
            raise self._refusal(error.status_code, error.body, error.response.headers) from None
        except openai.APIConnectionError as error:
            if not self._has_answered and _was_refused(error):
                raise EndpointError(
                    f"nothing answers at {self.config.endpoint}. Is the server running, and the address right?"
                ) from None
            raise _AgainError("has broken off the connection") from None
        except openai.OpenAIError as error:
            raise self._error(f"cannot be asked{self._said(str(error))}.") from None
        return self._parsed(body)

    def _parsed(self, body: bytes) -> Answer:
        try:
            found = msgspec.json.decode(body, type=_Completion)
        except (msgspec.DecodeError, UnicodeDecodeError, RecursionError):
            raise _AgainError(f"has answered with something that is no answer of a chat{self._said(body)}") from None
        usage = found.usage if isinstance(found.usage, dict) else {}
        choice = found.choices[0]
        return Answer(
            text=self._redacted(choice.message.content or ""),
            model=self._redacted(found.model or ""),
            finish=self._redacted(choice.finish_reason or ""),
            tokens_in=_count(usage.get("prompt_tokens")),
            tokens_out=_count(usage.get("completion_tokens")),
        )

    def _refusal(self, status: int, body: object, headers: Any) -> "_AgainError | EndpointError":
        details = body if isinstance(body, dict) else {}
        said = self._said(details.get("message") or body)
        if NO_MONEY in (details.get("code"), details.get("type")):
            return self._error(f"says that the account has no money left (status {status}).")
        if status in BUSY or status >= 500:
            return _AgainError(f"is busy or fails (status {status}{said})", wait_of(headers))
        # What a server says about a key may hold a part of it.
        if status in (401, 403):
            there = "the key is refused" if self._key else "it needs a key"
            return self._error(f"says {status}: {there}. Put one into the variable that `key_variable` names.")
        if status == 404:
            return self._error(
                f"says 404{said}. Is the address right (most end in /v1), and is there a model '{self.config.model}'?"
            )
        hint = " If it takes no temperature or no seed, use `sampling` default." if status in (400, 422) else ""
        return self._error(f"refuses what it is asked (status {status}{said}).{hint}")

    def _error(self, what: str) -> EndpointError:
        return EndpointError(f"the endpoint {self.config.endpoint} {what}")

    def _said(self, body: object) -> str:
        """Return what an endpoint said, short and without the key, as the end of a sentence."""
        text = body.decode(errors="replace") if isinstance(body, bytes) else str(body or "")
        text = " ".join("".join(letter if letter.isprintable() else " " for letter in text).split())
        text = self._redacted(text)
        return f": {text[:MOST_SAID]}" if text else ""

    def _redacted(self, text: str) -> str:
        return text.replace(self._key, HIDDEN) if len(self._key) >= LEAST_KEY else text


def _key_of(config: OpinionsConfig) -> str:
    """Return the key; empty if there is none and none is asked for.

    Raises:
        ConfigError: if there is no such variable, or what it holds is no key.
    """
    name = config.settings.key_variable
    if name is None and not config.endpoint.startswith("https:"):
        return ""
    key = os.environ.get(name or OPENAI_KEY, "").strip()
    if not key and name is not None:
        raise ConfigError(
            "`key_variable` names an environment variable that is not set, or empty. Set it to the endpoint's key."
        )
    # A library further down would repeat a key that it cannot send.
    if not (key.isascii() and key.isprintable()) or " " in key:
        raise ConfigError(
            "`key_variable` names an environment variable that holds no key: there are spaces, line breaks or letters "
            "outside ASCII in it."
        )
    return key


class _AgainError(Exception):
    """Something that may pass; ``wait`` is how many seconds the endpoint asks us to wait for, 0 if it does not say."""

    def __init__(self, what: str, wait: float = 0.0):
        super().__init__(what)
        self.wait = wait


class _Message(msgspec.Struct):
    content: str | None = None


class _Choice(msgspec.Struct):
    message: _Message
    finish_reason: str | None = None


class _Completion(msgspec.Struct):
    """What is needed of an answer; servers differ in the rest."""

    choices: tuple[_Choice]
    model: str | None = None
    usage: Any = None


def _count(value: object) -> int | None:
    return value if isinstance(value, int) and not isinstance(value, bool) and value >= 0 else None


def wait_of(headers: Any) -> float:
    """Return the seconds that a Retry-After header asks for, which may be a date; 0 without one."""
    said = headers.get("retry-after")
    try:
        return max(float(said), 0.0)
    except (TypeError, ValueError):
        pass
    try:
        when = parsedate_to_datetime(said)
    except (TypeError, ValueError):
        return 0.0
    when = when if when.tzinfo else when.replace(tzinfo=UTC)
    return max(when.timestamp() - datetime.fromtimestamp(time.time(), UTC).timestamp(), 0.0)


def _was_refused(error: BaseException | None) -> bool:
    """Return whether nothing listened at the address, or there is no such host."""
    while error is not None:
        if isinstance(error, ConnectionRefusedError) or type(error).__name__ == "ConnectError":
            return True
        error = error.__cause__ or error.__context__
    return False
