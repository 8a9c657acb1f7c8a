"""Settings of asking for opinions: every setting, default and allowed value; imports no torch."""

import re
from dataclasses import dataclass
from typing import ClassVar, Literal, get_args
from urllib.parse import urlsplit

from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.base.settings import number_in, one_of, whole
from wordcraft_kg.runs.config_file import RunConfig

Sampling = Literal["greedy", "default"]
"""What an endpoint is asked for: temperature 0 and a seed; or nothing, for models that refuse these."""
OPENAI_KEY = "OPENAI_API_KEY"


@dataclass(frozen=True)
class AskingConfig:
    """How an endpoint is asked.

    Attributes:
        goals_per_prompt: things that one prompt asks about.
        pairs: most pairs that are asked for of each thing.
        sampling: greedy (temperature 0 and `seed`) or default, what the model does by itself, for models that refuse
            to be told.
        seed: seed that the endpoint is given; many ignore it.
        at_once: prompts under way at the same time.
        key_variable: name of the environment variable that holds the endpoint's key; the key itself is written nowhere.
            Default: OPENAI_API_KEY for an address with https, and no key for one with http.
        timeout: seconds after which a prompt that is not answered is asked again.
        retries: how often a prompt is asked again if the endpoint is busy, fails, or answers by half.

    Example:
        >>> AskingConfig(goals_per_prompt=20).pairs
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
                "`key_variable` is no name of an environment variable (letters, digits and _). What was given is not "
                "shown, in case it is the key itself: put that into a variable, and give the variable's name."
            )


@dataclass(frozen=True)
class OpinionsConfig(RunConfig):
    """All settings of a model folder of opinions.

    Attributes:
        endpoint: address of an endpoint that speaks as OpenAI's, such as ``http://localhost:8080/v1``.
        model: name of the language model there.
        settings: how it is asked.

    Example:
        >>> OpinionsConfig("kitchen", "http://localhost:8080/v1/", "some-model").endpoint
        'http://localhost:8080/v1'
    """

    commands: ClassVar[tuple[str, ...]] = ("ask-opinions",)

    endpoint: str
    model: str
    settings: AskingConfig = AskingConfig()

    def __post_init__(self) -> None:
        object.__setattr__(self, "endpoint", checked_endpoint(self.endpoint))
        if not self.model.strip() or not self.model.isprintable() or len(self.model) > 300:
            raise ConfigError(f"`model` {self.model[:300]!r}: expected the name of a model, as the endpoint knows it.")


def checked_endpoint(address: str) -> str:
    """Return the address of an endpoint without a slash at its end.

    Raises:
        ConfigError: if it is none, or holds a password, a query or a fragment, in which a key might be.
    """
    expected = "expected an address such as http://localhost:8080/v1 or https://api.openai.com/v1"
    try:
        parts = urlsplit(address.strip())
        port_is_sound = parts.port is None or parts.port > 0
        (parts.hostname or "").encode("idna")
    except ValueError:
        raise ConfigError(f"`endpoint` is no address: {expected}.") from None
    if parts.username is not None or parts.password is not None or parts.query or parts.fragment:
        raise ConfigError(
            f"`endpoint` holds a user, a password, a query or a fragment, and none of these may be written down: "
            f"{expected}, and put a key into the environment variable that `key_variable` names."
        )
    if parts.scheme not in ("http", "https") or not parts.hostname or not port_is_sound or not address.isprintable():
        raise ConfigError(f"`endpoint` '{address[:100]}': {expected}.")
    if any(letter.isspace() for letter in address.strip()):
        raise ConfigError(f"`endpoint` '{address[:100]}': {expected}.")
    return address.strip().rstrip("/")
