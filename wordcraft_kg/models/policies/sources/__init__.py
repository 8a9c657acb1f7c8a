"""Sources: knowledge as a score for each table slot.

A source scores table slots: ``source(States(goal, selection, table)) -> (B, A)``. Policies mix
sources, environment wrappers add source scores to observations, scripted players follow scores, and
reports have a column per source. A policy's own attention logits are called :data:`ALPHA`.

Read ``source`` first: the base class, and ``FoldedSource`` for sources with a model per
left-out fold, which keeps train tasks from scores that were learned from their own recipes.
``pairs`` holds u, v and t, ``recipe`` holds w, ``registry`` finds sources by name. This module
holds names only, and imports no torch, so that ``--help`` stays fast::

    sources = make_sources(["combines", "component"], load_scorer("models/mine"))
    sources[0](States(goal, selection, table))

To add a source, subclass :class:`~wordcraft_kg.models.policies.sources.source.Source`, or write a
function that scores entities for goals, below ``@source`` of :mod:`wordcraft_kg.plugins`. An entry
point in the group ``wordcraft_kg.sources`` names one, too. Free to change: how a source computes
its scores, and new sources. Not free: a source's name, and the names, types and shapes of its
buffers, which are in the folders of existing policies.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, cast

from wordcraft_kg.base.registry import Registry


@dataclass(frozen=True)
class Label:
    """The names under which a source appears in settings, formulas and reports.

    Attributes:
        name: name in records, and in settings (``--use``) beside the longer one in :data:`SPELLED`.
        symbol: symbol in formulas, such as ``v``.
        about: column header in tables; ``{selection}`` is replaced by the selected entity.
        words: name in running text; by default ``name``.
        meaning: explanatory sentence for reports; empty for none.
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
        """Return the column header for tables, given the selected entity, if any."""
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
T = Label(
    "t",
    "t",
    "in the table with its best partner",
    "table score",
    "The score that a table of scores from elsewhere gives a slot and the selection for the goal; "
    "without selection, with the best partner; 0 where the table has none.",
)
W = Label(
    "w",
    "w",
    "makes the goal with its best partner",
    "recipe score",
    "How plausible a slot and the selection are as a recipe for the goal; "
    "without selection, with the best partner.",
)
BUILT_IN = {label.name: label for label in (U, V, W, T)}
SPELLED = {"combines": "u", "component": "v", "recipe": "w", "table": "t", "plan": "p"}
"""Names for people by name in records. Settings take both; records, addresses and formulas keep the
short ones, so that results from before the longer names stay valid. A dictionary here and not a
field of the label, because the label of p lies in a module that imports torch."""
SOURCES: Registry[Any] = Registry(
    "wordcraft_kg.sources", reserved=(ALPHA.name, *BUILT_IN, *SPELLED, *SPELLED.values())
)
"""Classes of all other sources by name; those of :data:`BUILT_IN` are in ``registry``."""


def need_no_scorer(names: Iterable[str]) -> bool:
    """Return whether sources, by short name, score without a scorer."""
    return all(
        # Built-in ones first: a look for others loads the modules of packages.
        name not in BUILT_IN
        and name in SOURCES
        and not getattr(SOURCES[name], "needs_scorer", True)
        for name in names
    )


def source_names() -> tuple[str, ...]:
    """Return the names of all sources: u, v, w, then those of plug-ins in alphabetical order.

    The order is that of the mixing weights λ in a policy.
    """
    return (*BUILT_IN, *sorted(SOURCES))


def short_name(name: str) -> str:
    """Return a source's name in records: ``u`` for ``combines`` and for ``u``.

    Unknown names stay as they are, so that an error can quote them.
    """
    return SPELLED.get(name, name)


def shown_setting(name: str, value: object) -> str:
    """Return a setting's value for tables: that of ``use`` with the names for people."""
    return with_letters(str(value).split(",")) if name == "use" else str(value)


def with_letters(names: Iterable[str]) -> str:
    """Return the names of sources for people, as in ``combines (u), component (v)``.

    Plug-ins have a single name, without a letter.
    """
    spelled = {short: f"{name} ({short})" for name, short in SPELLED.items()}
    return ", ".join(spelled.get(short_name(name), name) for name in names)


def label_of(name: str) -> Label:
    """Return the label for a source's name, or for ``alpha``, the attention's logits.

    Raises:
        KeyError: if no source has this name.
    """
    name = short_name(name)
    labels = {ALPHA.name: ALPHA, **BUILT_IN}
    return labels[name] if name in labels else cast("Label", SOURCES[name].label)
