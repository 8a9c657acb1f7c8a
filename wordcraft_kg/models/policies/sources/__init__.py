"""Sources: the one way in which knowledge enters a decision.

A source scores how good it is to pick each slot of a table: ``source(goal, selection, table) -> (B, A)``. A policy
mixes the sources that it is made with, wrappers put their scores into observations, scripted players follow them, and
explanations and reports name their columns after them. The policy's own attention logits are called :data:`ALPHA`.

A new source is a module here with a subclass of :class:`~wordcraft_kg.models.policies.sources.source.Source`, and a
line in :data:`SOURCES`. Importing this package imports no torch::

    sources = make_sources(["u", "v"], load_scorer("models/mine"))
    sources[0](goal, selection, table)
"""

from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from wordcraft_kg.models.policies.sources.source import Source

SOURCES = {
    "u": "combines_with:CombinesWith",
    "v": "component_of:ComponentOf",
    "w": "recipe:BestRecipe",
}
"""Module and class of each source by name, in the order in which policies mix them."""


@dataclass(frozen=True)
class Label:
    """The names of a source.

    Attributes:
        name: its name in settings and records.
        symbol: its symbol in formulas.
        about: meaning of the scores, for the head of a column; ``{held}`` stands for the entity held.
    """

    name: str
    symbol: str
    about: str

    @property
    def needs_held(self) -> bool:
        """Whether the scores are meaningful only while an entity is held."""
        return "{held}" in self.about

    @property
    def coefficient(self) -> str:
        """The symbol of its mixing coefficient."""
        return f"λ{self.symbol}"

    def title(self, held: str | None) -> str:
        """Return the head of a column of its scores, given the entity held, None for nothing."""
        return f"{self.about.format(held=held or 'nothing')} ({self.symbol})"


ALPHA = Label("alpha", "α", "attention")
"""The attention's own logits."""


def source_class(name: str) -> "type[Source]":
    """Return the class of a source by its name, one of :data:`SOURCES`."""
    module, _, kind = SOURCES[name].partition(":")
    found: type[Source] = getattr(import_module(f"{__name__}.{module}"), kind)
    return found


def label_of(name: str) -> Label:
    """Return the label of a source by its name; ``alpha`` has one too."""
    return ALPHA if name == ALPHA.name else source_class(name).label
