"""A client of OpenAI-compatible endpoints; the library ``openai`` retries and waits, and no text repeats the key."""

import os
from typing import Any

import msgspec

from wordcraft_kg.apps.elicitation.answers import Answer
from wordcraft_kg.apps.elicitation.config import OPENAI_KEY, OpinionsConfig
from wordcraft_kg.apps.elicitation.prompts import Request
from wordcraft_kg.base.errors import ConfigError, EndpointError
from wordcraft_kg.base.extras import check_extra

NO_MONEY = "insufficient_quota"
HIDDEN = "(key)"
LEAST_KEY = 6
"""Length from which a key is hidden in texts; a shorter one, such as "none", is a word and no secret."""
MOST_SAID = 300
"""Characters of an endpoint's own words that are repeated."""
MOST_TOKENS = 2**53


class Endpoint:
    """A client of an endpoint; :meth:`ask` may run several times at once, and ``async with`` closes the client."""

    def __init__(self, config: OpinionsConfig):
        """Read the key and prepare a client; nothing is sent.

        Raises:
            MissingExtraError: if the client's library is not installed.
            ConfigError: if the key's variable is not set, or holds no key.
        """
        check_extra("opinions")
        import openai

        self.config = config
        self._openai = openai
        self._key = _read_key(config)
        self._client = openai.AsyncOpenAI(
            api_key=self._key or "none",
            base_url=config.endpoint,
            timeout=config.settings.timeout,
            max_retries=config.settings.retries,
            # Another host's answer must not pass for one of this endpoint.
            http_client=openai.DefaultAsyncHttpxClient(follow_redirects=False),
        )

    async def __aenter__(self) -> "Endpoint":
        return self

    async def __aexit__(self, *_: object) -> None:
        await self._client.close()

    async def ask(self, request: Request) -> Answer:
        """Return the answer to a request.

        Raises:
            EndpointError: if the endpoint refuses the request, sends no answer of a chat, or fails after all retries.
        """
        openai = self._openai
        sampling: dict[str, Any] = {"temperature": request.temperature, "seed": request.seed}
        try:
            raw = await self._client.chat.completions.with_raw_response.create(
                model=request.model,
                messages=[{"role": one.role, "content": one.content} for one in request.messages],  # type: ignore[misc]
                **{name: value for name, value in sampling.items() if value is not None},
            )
        except openai.APITimeoutError:
            raise self._error(
                f"has not answered within {self.config.settings.timeout:g} seconds{self._times}"
            ) from None
        except openai.APIStatusError as error:
            raise self._error(self._refusal(error.status_code, error.body)) from None
        except openai.APIConnectionError:
            raise self._error(f"breaks off or nothing answers there{self._times} Does the server run?") from None
        except openai.OpenAIError as error:
            raise self._error(f"cannot be asked{self._said(str(error))}.") from None
        return self._answer(raw.http_response.content)

    @property
    def _times(self) -> str:
        return f" ({self.config.settings.retries + 1} times in a row)."

    def _answer(self, body: bytes) -> Answer:
        try:
            found = msgspec.json.decode(body, type=_Completion)
        except (msgspec.DecodeError, UnicodeDecodeError, RecursionError):
            raise self._error(f"has answered with something that is no answer of a chat{self._said(body)}.") from None
        usage = found.usage if isinstance(found.usage, dict) else {}
        choice = found.choices[0]
        return Answer(
            text=self._redacted(choice.message.content or ""),
            model=self._redacted(found.model or ""),
            finish=self._redacted(choice.finish_reason or ""),
            tokens_in=_count(usage.get("prompt_tokens")),
            tokens_out=_count(usage.get("completion_tokens")),
        )

    def _refusal(self, status: int, body: object) -> str:
        details = body if isinstance(body, dict) else {}
        said = self._said(details.get("message") or body)
        if NO_MONEY in (details.get("code"), details.get("type")):
            return f"says that the account has no money left (status {status})."
        # An endpoint's words about a key may hold a part of it.
        if status in (401, 403):
            there = "the key is refused" if self._key else "it needs a key"
            return f"says {status}: {there}. Put one into the variable that `key_variable` names."
        if status == 404:
            return (
                f"says 404{said}. Is the address right (most end in /v1), and is there a model '{self.config.model}'?"
            )
        if status == 429 or status >= 500:
            return f"is busy or fails (status {status}{said}){self._times}"
        hint = " If it takes no temperature or no seed, use `sampling` default." if status in (400, 422) else ""
        return f"refuses the prompt (status {status}{said}).{hint}"

    def _error(self, what: str) -> EndpointError:
        return EndpointError(f"the endpoint {self.config.endpoint} {what}")

    def _said(self, body: object) -> str:
        """Return an endpoint's words, short and without the key, as the end of a sentence."""
        text = body.decode(errors="replace") if isinstance(body, bytes) else str(body or "")
        text = " ".join("".join(letter if letter.isprintable() else " " for letter in text).split())
        text = self._redacted(text)
        return f": {text[:MOST_SAID]}" if text else ""

    def _redacted(self, text: str) -> str:
        return text.replace(self._key, HIDDEN) if len(self._key) >= LEAST_KEY else text


def _read_key(config: OpinionsConfig) -> str:
    """Return the key; empty if none is set, or none is named for an address without encryption."""
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


class _Message(msgspec.Struct):
    content: str | None = None


class _Choice(msgspec.Struct):
    message: _Message
    finish_reason: str | None = None


class _Completion(msgspec.Struct):
    """The needed parts of an answer; servers differ in the rest, and the library checks none of it."""

    choices: tuple[_Choice]
    model: str | None = None
    usage: Any = None


def _count(value: object) -> int | None:
    is_count = isinstance(value, int) and not isinstance(value, bool) and 0 <= value <= MOST_TOKENS
    return value if is_count else None  # type: ignore[return-value]
