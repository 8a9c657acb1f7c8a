"""Sources: knowledge as a score for each table slot.

A source scores table slots: ``source(goal, selection, table) -> (B, A)``. Policies mix sources, environment wrappers
add source scores to observations, scripted players follow scores, and reports have a column per source. A policy's own
attention logits are called :data:`ALPHA`.

To add a source, subclass :class:`~wordcraft_kg.models.policies.sources.source.Source`. An entry point in the group
``wordcraft_kg.sources`` makes the source known to all commands;
:func:`~wordcraft_kg.models.policies.sources.registry.register_source` registers in the running process only. This
package imports no torch::

    sources = make_sources(["u", "v"], load_scorer("models/mine"))
    sources[0](goal, selection, table)
"""

from dataclasses import dataclass
from functools import cache
from importlib.metadata import EntryPoint, entry_points

GROUP = "wordcraft_kg.sources"
"""Entry point group of sources: name and class."""


@dataclass(frozen=True)
class Label:
    """The names under which a source appears in settings, formulas and reports.

    Attributes:
        name: name in settings and records.
        symbol: symbol in formulas.
        about: column header in tables; ``{selection}`` is replaced by the selected entity.
        words: name in running text; by default ``name``.
        meaning: explanatory sentence for reports.
    """

    name: str
    symbol: str
    about: str
    words: str = ""
    meaning: str = ""

    def __post_init__(self) -> None:
        object.__setattr__(self, "words", self.words or self.name)

    @property
    def needs_selection(self) -> bool:
        """Whether the source scores slots only with a selected entity, as u does."""
        return "{selection}" in self.about

    @property
    def coefficient(self) -> str:
        """Symbol of the source's mixing weight λ."""
        return f"λ{self.symbol}"

    def title(self, selection: str | None) -> str:
        """Return the column header for tables, given the selected entity (None without selection)."""
        return f"{self.about.format(selection=selection or 'nothing')} ({self.symbol})"


ALPHA = Label(
    "alpha",
    "α",
    "attention",
    "attention",
    "What the agent's own network gives a slot, without any knowledge graph.",
)
"""The attention's own logits."""
U = Label(
    "u",
    "u",
    "combinesWith {selection}",
    "combination score",
    "The scorer's combinesWith score for a slot with the selection.",
)
V = Label(
    "v",
    "v",
    "componentOf goal",
    "ingredient score",
    "The scorer's componentOf score for a slot with the goal.",
)
W = Label(
    "w",
    "w",
    "makes the goal with its best partner",
    "recipe score",
    "How plausible a slot and the selection are as a recipe for the goal; without selection, with the best partner.",
)
BUILT_IN = {label.name: label for label in (U, V, W)}
LABELS = dict(BUILT_IN)
"""Labels by name, for built-in and registered sources."""


@cache
def installed_sources() -> dict[str, EntryPoint]:
    """Return installed packages' entry points for slot scores (sources) that a policy may mix, by name."""
    return {point.name: point for point in entry_points(group=GROUP)}


def source_names() -> tuple[str, ...]:
    """Return the names of all slot scores (sources) that policies mix: u, v, w, then plug-ins by name."""
    plug_ins = {*LABELS, *installed_sources()} - BUILT_IN.keys()
    return (*BUILT_IN, *sorted(plug_ins))


def label_of(name: str) -> Label:
    """Return the label for a source's name, or for ``alpha``, the attention's logits; KeyError for unknown names."""
    if name == ALPHA.name:
        return ALPHA
    if name in LABELS:
        return LABELS[name]
    label: Label = installed_sources()[name].load().label
    return label
