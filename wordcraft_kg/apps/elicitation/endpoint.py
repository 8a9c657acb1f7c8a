"""A client for OpenAI-compatible endpoints that removes the API key from all texts; the library ``openai`` retries."""

import asyncio
import os
import sys
from typing import Any

import msgspec

from wordcraft_kg.apps.elicitation.answers import Answer
from wordcraft_kg.apps.elicitation.config import OPENAI_KEY, ElicitationConfig
from wordcraft_kg.apps.elicitation.prompts import Request
from wordcraft_kg.base.errors import ConfigError, EndpointError
from wordcraft_kg.base.extras import check_extra

_NO_MONEY = "insufficient_quota"
_LEAST_KEY = 6
"""Minimum key length for redaction; a shorter key, such as "none", may be a word."""
_MOST_QUOTED = 300
"""Most characters quoted from an error message."""
_MOST_READ = 10_000
LARGEST_ANSWER = 4_000_000
"""Largest body of an answer, in bytes."""
_SENT = {"accept", "authorization", "connection", "content-length", "content-type", "host", "user-agent"}
_OF_BODY = ("content-encoding", "content-length", "transfer-encoding")


class Endpoint:
    """An asynchronous client of a language model's web address; calls to :meth:`ask` may overlap."""

    def __init__(self, config: ElicitationConfig):
        """Read the API key from the environment and create a client; no request is sent.

        Raises:
            MissingExtraError: if the library ``openai`` is not installed.
            ConfigError: if the environment variable for the key is unset or malformed.
        """
        check_extra("elicit")
        import openai

        self.config = config
        self._openai = openai
        self._key = _read_key(config)
        self._client = openai.AsyncOpenAI(
            api_key=self._key or "none",
            base_url=config.endpoint,
            timeout=config.settings.timeout,
            max_retries=config.settings.retries,
            http_client=_http_client(config),
        )

    async def __aenter__(self) -> "Endpoint":
        return self

    async def __aexit__(self, *_: object) -> None:
        await self._client.close()

    async def ask(self, request: Request) -> Answer:
        """Send a request to the endpoint, and return the answer.

        Raises:
            EndpointError: for a rejected request, a malformed answer, or a failure after all retries.
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
            problem = f"has not answered within {self.config.settings.timeout:g} seconds{self._times}"
        except openai.APIStatusError as error:
            problem = self._refusal(error.status_code, error.body)
        except openai.APIConnectionError:
            problem = f"closes connections or is unreachable{self._times} Check that the server runs."
        except openai.OpenAIError as error:
            problem = f"cannot be queried{self._quoted(str(error))}."
        else:
            return self._answer(raw.http_response.content)
        raise EndpointError(f"the endpoint {self.config.endpoint} {problem}")

    @property
    def _times(self) -> str:
        return f" ({self.config.settings.retries + 1} times in a row)."

    def _answer(self, body: bytes) -> Answer:
        try:
            completion = msgspec.json.decode(body, type=_Completion)
        except (msgspec.DecodeError, UnicodeDecodeError, RecursionError):
            sent = f"a malformed chat completion{self._quoted(body[:_MOST_READ])}"
            if len(body) > LARGEST_ANSWER:
                sent = f"an answer with more than {LARGEST_ANSWER:,} bytes"
            raise EndpointError(f"the endpoint {self.config.endpoint} sent {sent}.") from None
        (choice,) = completion.choices
        return Answer(
            text=self._redacted(choice.message.content or ""),
            model=self._redacted(completion.model or ""),
            finish=self._redacted(choice.finish_reason or ""),
        )

    def _refusal(self, status: int, body: object) -> str:
        details = body if isinstance(body, dict) else {}
        quoted = self._quoted(details.get("message") or body)
        if _NO_MONEY in (details.get("code"), details.get("type")):
            return f"reports that the account has no credit (status {status})."
        if status in (401, 403):  # without a quote, which may contain a part of the key
            problem = "the key is rejected" if self._key else "a key is required"
            return f"returned {status}: {problem}. Put a key into the variable named by `key_variable`."
        if status == 404:
            return f"returned 404{quoted}. Check the address (most end in /v1) and the model '{self.config.model}'."
        if status == 429 or status >= 500:
            return f"is busy or fails (status {status}{quoted}){self._times}"
        hint = " If the model supports no temperature or seed, use `sampling` default." if status in (400, 422) else ""
        return f"rejects the prompt (status {status}{quoted}).{hint}"

    def _quoted(self, body: object) -> str:
        text = body.decode(errors="replace") if isinstance(body, bytes) else str(body or "")
        text = self._redacted(" ".join("".join(letter if letter.isprintable() else " " for letter in text).split()))
        return f": {text[:_MOST_QUOTED]}" if text else ""

    def _redacted(self, text: str) -> str:
        return text.replace(self._key, "(key)") if len(self._key) >= _LEAST_KEY else text


def _http_client(config: ElicitationConfig) -> Any:
    import openai

    class Client(openai.DefaultAsyncHttpxClient):
        async def send(self, request: Any, *, stream: bool = False, **options: Any) -> Any:
            given, body = request.headers, bytearray()
            # Without the account in OPENAI_ORG_ID, and without compression, because a small answer may fill the memory.
            sent = {name: value for name, value in given.items() if name in _SENT}
            request.headers = type(given)({**sent, "accept-encoding": "identity"})
            try:
                async with asyncio.timeout(config.settings.timeout):
                    response = await super().send(request, stream=True, **options)
                    try:
                        async for part in response.aiter_raw():
                            body += part
                            if len(body) > LARGEST_ANSWER:
                                break
                    finally:
                        await response.aclose()
            except TimeoutError:
                httpx = sys.modules[type(request).__module__.partition(".")[0]]  # or httpx2
                raise httpx.ReadTimeout("the request takes too long", request=request) from None
            finally:
                request.headers = given  # the library reads its own marks there
            headers = {name: value for name, value in response.headers.items() if name not in _OF_BODY}
            return type(response)(response.status_code, headers=headers, content=bytes(body), request=request)

    # An answer must come from this endpoint; over http, a proxy would see the key.
    return Client(follow_redirects=False, trust_env=config.endpoint.startswith("https:"))


def _read_key(config: ElicitationConfig) -> str:
    name = config.settings.key_variable
    if name is None and not config.endpoint.startswith("https:"):
        return ""
    key = os.environ.get(name or OPENAI_KEY, "").strip()
    if not key and name is not None:
        raise ConfigError(
            "`key_variable` names an unset or empty environment variable. Set the variable to the endpoint's key."
        )
    # A library further down would print a key with such characters.
    if not (key.isascii() and key.isprintable()) or " " in key:
        raise ConfigError(
            "`key_variable` names an environment variable with an invalid key: spaces, line breaks or letters outside "
            "ASCII."
        )
    return key


class _Message(msgspec.Struct):
    content: str | None = None


class _Choice(msgspec.Struct):
    message: _Message
    finish_reason: str | None = None


class _Completion(msgspec.Struct):
    choices: tuple[_Choice]  # other parts differ between servers
    model: str | None = None
