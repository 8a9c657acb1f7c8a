"""Sources: the one way in which knowledge enters a decision.

A source scores how good it is to pick each slot of a table: ``source(goal, selection, table) -> (B, A)``. A policy
mixes the sources that it is made with, wrappers put their scores into observations, scripted players follow them, and
explanations and reports name their columns after them. The policy's own attention logits are called :data:`ALPHA`.

A new source is a subclass of :class:`~wordcraft_kg.models.policies.sources.source.Source`. Of a package that is
installed, an entry point in the group ``wordcraft_kg.sources`` makes it known to every command by its name; in Python,
:func:`~wordcraft_kg.models.policies.sources.registry.register_source` does. Importing this package imports no torch::

    sources = make_sources(["u", "v"], load_scorer("models/mine"))
    sources[0](goal, selection, table)
"""

from dataclasses import dataclass
from functools import cache
from importlib.metadata import EntryPoint, entry_points

GROUP = "wordcraft_kg.sources"
"""Entry points of sources: the name of each, and its class."""


@dataclass(frozen=True)
class Label:
    """The names of a source.

    Attributes:
        name: its name in settings and records.
        symbol: its symbol in formulas.
        about: meaning of the scores, for the head of a column; ``{held}`` stands for the entity held.
        words: its name in running text; by default the name.
        meaning: a sentence that explains the scores, for reports.
    """

    name: str
    symbol: str
    about: str
    words: str = ""
    meaning: str = ""

    def __post_init__(self) -> None:
        object.__setattr__(self, "words", self.words or self.name)

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


ALPHA = Label(
    "alpha", "α", "attention", "attention", "What the agent's own network gives a slot, without any knowledge graph."
)
"""The attention's own logits."""
U = Label(
    "u",
    "u",
    "combinesWith {held}",
    "combination score",
    "The scorer's combinesWith score of a slot with the entity in hand.",
)
V = Label("v", "v", "componentOf goal", "ingredient score", "The scorer's componentOf score of a slot with the goal.")
W = Label(
    "w",
    "w",
    "makes the goal with its best partner",
    "recipe score",
    "How plausible it is that a slot and the entity in hand make the goal; with an empty hand, its best partner.",
)
BUILT_IN = {label.name: label for label in (U, V, W)}
LABELS = dict(BUILT_IN)
"""Labels by name: those above, and those of the classes that have been registered."""


@cache
def installed_sources() -> dict[str, EntryPoint]:
    """Return the entry points of sources in installed packages, by name."""
    return {point.name: point for point in entry_points(group=GROUP)}


def source_names() -> tuple[str, ...]:
    """Return the names of all sources, in the order in which policies mix them: ours, then others by name."""
    others = {*LABELS, *installed_sources()} - BUILT_IN.keys()
    return (*BUILT_IN, *sorted(others))


def label_of(name: str) -> Label:
    """Return the label of a source by its name; ``alpha`` has one too.

    Raises:
        KeyError: if no source of that name is registered or installed.
    """
    if name == ALPHA.name:
        return ALPHA
    if name in LABELS:
        return LABELS[name]
    label: Label = installed_sources()[name].load().label
    return label
