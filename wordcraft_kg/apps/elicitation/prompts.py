"""Prompts for a language model: texts about an entity that a related label may follow."""

from pathlib import Path
from typing import Literal

from wordcraft_kg.base import (
    ArtefactError,
    Record,
    as_values,
    dump_json,
    parse_record,
    read_small_file,
    what_is,
)
from wordcraft_kg.models.knowledge.folder import Role

_IN_PHRASE = {"part": ("{ingredient}", "{result}"), "pair": ("{a}", "{b}")}
"""Places that the phrase of a table needs, by role."""


class Prompt(Record, frozen=True, kw_only=True):
    """A text about an entity; the probabilities of the next words make a table.

    Attributes:
        name: name of the table.
        role: role of the table: ``part``, ingredient and result, or ``pair``, two ingredients.
        about: role of the entity in the text, ingredient or result; the next words have the other
            role.
        template: text with ``{e}``, a label, or ``{E}``, a label with a capital letter.
        neutral: texts with a general word, such as "something", in place of the label.
        phrase: evidence in explanations, with ``{ingredient}`` and ``{result}``, or ``{a}`` and
            ``{b}``.
    """

    name: str
    role: Role
    about: Literal["ingredient", "result"] = "ingredient"
    template: str
    neutral: tuple[str, ...]
    phrase: str

    def __post_init__(self) -> None:
        texts = (self.template, *self.neutral)
        if "{e}" not in self.template.lower():
            raise ValueError(
                f"template '{self.template}' has no {{e}}; expected a place for the label"
            )
        if not self.neutral or any(not text or text != text.strip() for text in texts):
            raise ValueError(
                f"prompt '{self.name}' needs neutral texts; texts neither start nor end with a "
                "blank"
            )
        if any(part not in self.phrase for part in _IN_PHRASE[self.role]):
            raise ValueError(f"phrase '{self.phrase}' lacks {' or '.join(_IN_PHRASE[self.role])}")

    def text(self, label: str) -> str:
        """Return the text about a label."""
        return self.template.replace("{e}", label).replace("{E}", label[:1].upper() + label[1:])


class _Prompts(Record, frozen=True):
    prompts: tuple[Prompt, ...]

    def __post_init__(self) -> None:
        names = {prompt.name for prompt in self.prompts}
        if not names or len(names) < len(self.prompts):
            raise ValueError("expected prompts with different names")


DEFAULT = Path(__file__).with_name("prompts.json")
"""Default prompts, a table each, chosen on validation recipes of Little Alchemy 2.

The splits have the seeds 10 and 11, so the results of other seeds are not tuned.
"""


def read_prompts(path: Path) -> tuple[Prompt, ...]:
    """Read prompts from a JSON file, ``{"prompts": [...]}``.

    Raises:
        ArtefactError: if the file is missing, not JSON, or a prompt is invalid.
    """
    if not path.is_file():
        raise ArtefactError(
            f"`prompts` '{path}' {what_is(path)}; expected a file such as prompts.json of an "
            "elicit folder."
        )
    return parse_record(read_small_file(path), _Prompts, path).prompts


def prompts_text(prompts: tuple[Prompt, ...]) -> str:
    """Return prompts as JSON text for :func:`read_prompts`."""
    return dump_json(as_values(_Prompts(prompts)))
