"""Look up sources by name: built-in, installed and registered."""

from collections.abc import Iterable
from dataclasses import replace

from wordcraft_kg.base import ConfigError, NotRegisteredError, check_memory
from wordcraft_kg.base.registry import REMEDY
from wordcraft_kg.graphs.tasks import TaskSet
from wordcraft_kg.models.policies.sources import (
    SOURCES,
    short_name,
    source_names,
    with_letters,
)
from wordcraft_kg.models.policies.sources.pairs import (
    CombinesWith,
    ComponentOf,
    PairSource,
    SetTable,
)
from wordcraft_kg.models.policies.sources.recipe import BestRecipe
from wordcraft_kg.models.policies.sources.source import AS_IS, ScoreView, Source
from wordcraft_kg.models.scorers.cross_fitting import folds_of
from wordcraft_kg.models.scorers.protocol import FactoredScorer, TripleScorer
from wordcraft_kg.models.scorers.scales import FACTORED_SCALES
from wordcraft_kg.models.scorers.score_limits import TABLE_LIMIT, Scale

_BUILT_IN: dict[str, type[Source]] = {
    kind.label.name: kind for kind in (CombinesWith, ComponentOf, BestRecipe, SetTable)
}


def source_class(name: str) -> type[Source]:
    """Return the class of a source, loading an installed package only when needed.

    Args:
        name: either name of the source, such as ``combines`` or ``u``.

    Raises:
        ConfigError: if no source has this name.
    """
    name = short_name(name)
    if name in _BUILT_IN:
        return _BUILT_IN[name]
    if name not in SOURCES:
        raise NotRegisteredError(
            f"the source '{name}' is not registered; expected a name among "
            f"{with_letters(source_names())}. {REMEDY}"
        )
    kind: type[Source] = SOURCES[name]
    return kind


def tables_are_too_large(
    names: Iterable[str],
    scorer: TripleScorer,
    scale: Scale,
) -> bool:
    """Return whether score tables would be too large, so that sources must score without them.

    Checked before any table is computed.

    Args:
        names: names of the sources.
        scorer: their scorer.
        scale: common scale of the scores.

    Raises:
        ConfigError: for an unknown name; if the tables would be too large, and the scorer or the
            scale needs them (the message gives their size and the alternatives); or if a
            cross-fitted scorer's tables, one for each fold and two more, do not fit into memory.
    """
    size = len(scorer.entities)
    num_tables = sum(issubclass(source_class(name), PairSource) for name in names)
    num_bytes = num_tables * (size + 1) ** 2 * 4
    if num_bytes <= TABLE_LIMIT:
        folded = folds_of(scorer)
        if folded is not None:
            # A table each: trained on all folds, without each fold, and the empty model's.
            in_all = num_bytes * (folded.count + 2)
            check_memory("folds", folded.count, "score tables, a table for each", in_all)
        return False
    cost = (
        f"score tables for {size:,} entities take {num_bytes / 2**20:,.0f} MiB; expected at most "
        f"{TABLE_LIMIT / 2**20:.0f} MiB"
    )
    if not isinstance(scorer, FactoredScorer):
        raise ConfigError(
            f"{cost}; only ComplEx, DistMult and recipe scorers work without tables. Use one, or "
            "`use` recipe of a model of sets."
        )
    if scale not in FACTORED_SCALES:
        raise ConfigError(
            f"`scale` {scale}: {cost}. Choose {' or '.join(FACTORED_SCALES)}, which need no tables."
        )
    return True


def make_sources(
    names: Iterable[str],
    scorer: TripleScorer,
    view: ScoreView = AS_IS,
    *,
    tasks: TaskSet | None = None,
) -> list[Source]:
    """Make sources, functions that score table slots, by name from a scorer.

    Args:
        names: names of the sources: ``["combines", "component"]``, or short, ``["u", "v"]``.
        scorer: model whose scores the sources use.
        view: scale of the scores and treatment of self edges; by default raw scores.
        tasks: tasks to score, such as ``world.tasks``, which replace the view's. Without tasks
            (None), sources of a cross-fitted scorer score only tasks that use no train recipe.

    Returns:
        One source for each name, in the given order.

    Raises:
        ConfigError: for an unknown name, or if the scorer cannot serve a source, or would need a
            table that is too large.
        LeakError: if a model has seen all recipes of a task's plan.
        GraphMismatchError: if the tasks belong to another graph or split than the scorer's folds.

    Example:
        >>> u, v = make_sources(["combines", "component"], load_scorer("models/kitchen"))
        >>> u.label.symbol, v.graph_hash == open_graph("kitchen").graph.hash
        ('u', True)
    """
    names = tuple(names)  # read twice below
    if tasks is not None:
        view = replace(view, tasks=tasks)
    # Before any table is computed, which may take the memory of the machine.
    if tables_are_too_large(names, scorer, view.scale):
        view = replace(view, without_tables=True)
    sources = [source_class(name).of_scorer(scorer, view) for name in names]
    # Not in `of_scorer`, so that no subclass can forget it.
    for source in sources:
        source.graph_hash = scorer.graph_hash
        if view.tasks is not None:
            source.bind(view.tasks)
    return sources
