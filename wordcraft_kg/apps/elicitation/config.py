"""Settings for the command ``elicit``; importable without torch."""

import re
from dataclasses import dataclass
from typing import ClassVar, Literal, get_args
from urllib.parse import urlsplit

from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.base.settings import number_in, one_of, whole
from wordcraft_kg.runs.config_file import RunConfig

Sampling = Literal["greedy", "default"]
"""Sampling: temperature 0 and a seed, or the model's default."""
OPENAI_KEY = "OPENAI_API_KEY"


@dataclass(frozen=True)
class RequestConfig:
    """Settings for prompts and requests.

    Attributes:
        goals_per_prompt: entities per prompt.
        pairs: requested pairs per entity, at most.
        sampling: greedy (temperature 0 and `seed`), or default for models without these settings.
        seed: seed for the endpoint; many endpoints ignore the seed.
        at_once: concurrent prompts.
        key_variable: environment variable with the endpoint's key, which is never written or printed. Default:
            OPENAI_API_KEY for https addresses, no key for http addresses.
        timeout: seconds until a prompt without a complete answer is repeated.
        retries: repetitions after a timeout, a failure or a truncated answer.

    Example:
        >>> RequestConfig(goals_per_prompt=20).pairs
        5
    """

    goals_per_prompt: int = 10
    pairs: int = 5
    sampling: Sampling = "greedy"
    seed: int = 0
    at_once: int = 4
    key_variable: str | None = None
    timeout: float = 60.0
    retries: int = 5

    def __post_init__(self) -> None:
        whole("goals_per_prompt", self.goals_per_prompt, 1, 100)
        whole("pairs", self.pairs, 1, 100)
        one_of("sampling", self.sampling, get_args(Sampling))
        whole("seed", self.seed, 0)
        whole("at_once", self.at_once, 1, 64)
        number_in("timeout", self.timeout, 0.1, 3_600, "0.1 to 3600 seconds")
        whole("retries", self.retries, 0, 100)
        if self.key_variable is not None and not re.fullmatch(r"[A-Za-z_][A-Za-z0-9_]*", self.key_variable):
            raise ConfigError(
                "`key_variable` is not an environment variable name (letters, digits and _). The value is not shown, "
                "in case it is the key: put the key into a variable, and give the variable name."
            )


@dataclass(frozen=True)
class ElicitationConfig(RunConfig):
    """Settings for a model folder with elicited recipes.

    Attributes:
        endpoint: OpenAI-compatible address, such as ``http://localhost:8080/v1``.
        model: the endpoint's name for the language model.
        settings: prompts and requests.

    Example:
        >>> ElicitationConfig("kitchen", "http://localhost:8080/v1/", "some-model").endpoint
        'http://localhost:8080/v1'
    """

    commands: ClassVar[tuple[str, ...]] = ("elicit",)

    endpoint: str
    model: str
    settings: RequestConfig = RequestConfig()

    def __post_init__(self) -> None:
        object.__setattr__(self, "endpoint", checked_endpoint(self.endpoint))
        if not self.model.strip() or not self.model.isprintable() or len(self.model) > 300:
            raise ConfigError(f"`model` {self.model[:300]!r}: expected a model name of the endpoint.")


def checked_endpoint(address: str) -> str:
    """Check an endpoint's address, and return the address without a final slash.

    Raises:
        ConfigError: if the address is invalid, or has a password, query or fragment, which may contain a key.
    """
    expected = "expected an address such as http://localhost:8080/v1 or https://api.openai.com/v1"
    try:
        parts = urlsplit(address.strip())
        is_valid = parts.scheme in ("http", "https") and bool(parts.hostname) and parts.port != 0
        (parts.hostname or "").encode("idna")
    except ValueError:
        raise ConfigError(f"`endpoint` is not an address: {expected}.") from None
    if parts.username is not None or parts.password is not None or parts.query or parts.fragment:
        raise ConfigError(
            f"`endpoint` has a user, a password, a query or a fragment, which would be written to files: {expected}, "
            "and put a key into the environment variable that `key_variable` names."
        )
    if not is_valid or not address.isprintable() or re.search(r"\s", address.strip()):
        raise ConfigError(f"`endpoint` '{address[:100]}': {expected}.")
    return address.strip().rstrip("/")
