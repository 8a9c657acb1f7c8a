"""Prompts that request recipes from a language model; the content of a request identifies its stored answer."""

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass

from wordcraft_kg.apps.elicitation.config import ElicitationConfig, RequestConfig
from wordcraft_kg.base.records import Record

LISTED = 1_500
"""Entities in a prompt, at most; for a larger graph, the model names things freely."""
TASK = """\
In a crafting game, players combine two items to make a new item. Recipes follow common sense or wordplay.
An item may be combined with itself.
For each item in the question, list up to {pairs} pairs of items that could make it, most likely first.
Write one line per pair in exactly this format, and nothing else:
item: first + second
"""
ITEMS = """
These are all the items in the game. Use only these items, spelled exactly as shown:
{items}
"""
QUESTION = """\
Which pairs of items make each of these items?
{goals}
"""
TEMPLATE_HASH = hashlib.sha256("\0".join((TASK, ITEMS, QUESTION)).encode()).hexdigest()
"""SHA-256 of the prompt template, to tell prompt versions apart."""
_CHARACTERS_PER_TOKEN = 4  # approximately, for English


class Message(Record, frozen=True):
    """A chat message: role (system or user) and text."""

    role: str
    content: str


class Request(Record, frozen=True, kw_only=True):
    """The content of a request to an endpoint, without the key; None leaves a setting to the endpoint's default."""

    endpoint: str
    model: str
    messages: tuple[Message, ...]
    temperature: float | None
    seed: int | None

    @property
    def hash(self) -> str:
        """SHA-256 of the content, in hexadecimal."""
        values = [self.endpoint, self.model, [[one.role, one.content] for one in self.messages]]
        return hashlib.sha256(json.dumps([*values, self.temperature, self.seed]).encode()).hexdigest()

    @property
    def tokens(self) -> int:
        """Approximate number of tokens in the messages."""
        return sum(len(message.content) for message in self.messages) // _CHARACTERS_PER_TOKEN + 1


@dataclass(frozen=True)
class Prompt:
    """A request for the recipes of some goals (labels), with the approximate number of tokens in the answer."""

    goals: tuple[str, ...]
    request: Request
    answer_tokens: int


def make_prompts(config: ElicitationConfig, entities: Sequence[str]) -> list[Prompt]:
    """Return prompts that together request recipes for all entities; ``entities`` are labels in id order.

    Example:
        >>> config = ElicitationConfig("kitchen", "http://localhost:8080/v1", "some-model")
        >>> [prompt.goals for prompt in make_prompts(config, ["earth", "mud", "water"])]
        [('earth', 'mud', 'water')]
    """
    settings = config.settings
    task = TASK.format(pairs=settings.pairs)
    if len(entities) <= LISTED:
        task += ITEMS.format(items="\n".join(entities))
    return [
        _prompt(config, task, tuple(entities[begin : begin + settings.goals_per_prompt]))
        for begin in range(0, len(entities), settings.goals_per_prompt)
    ]


def _prompt(config: ElicitationConfig, task: str, goals: tuple[str, ...]) -> Prompt:
    settings: RequestConfig = config.settings
    is_greedy = settings.sampling == "greedy"
    # The common part comes first, because servers cache prefixes.
    question = QUESTION.format(goals="\n".join(goals))
    messages = Message("system", task.strip()), Message("user", question.strip())
    request = Request(
        endpoint=config.endpoint,
        model=config.model,
        messages=messages,
        temperature=0.0 if is_greedy else None,
        seed=settings.seed if is_greedy else None,
    )
    letters = sum(3 * len(goal) + 6 for goal in goals) * settings.pairs
    return Prompt(goals, request, letters // _CHARACTERS_PER_TOKEN + 1)
