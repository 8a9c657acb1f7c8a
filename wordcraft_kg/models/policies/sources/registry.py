"""Sources by name: those of this package, of installed packages, and those that a program registers."""

from collections.abc import Iterable
from dataclasses import replace
from typing import TypeVar

from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.base.settings import check_memory
from wordcraft_kg.graphs.tasks import TaskSet
from wordcraft_kg.models.policies.sources import ALPHA, BUILT_IN, LABELS, installed_sources, source_names
from wordcraft_kg.models.policies.sources.pairs import CombinesWith, ComponentOf
from wordcraft_kg.models.policies.sources.recipe import BestRecipe
from wordcraft_kg.models.policies.sources.source import AS_IS, ScoreView, Source
from wordcraft_kg.models.scorers.config import TABLE_LIMIT, Scale
from wordcraft_kg.models.scorers.cross_fitting import folds_of
from wordcraft_kg.models.scorers.protocol import FactoredScorer, TripleScorer
from wordcraft_kg.models.scorers.scales import FACTORED_SCALES

SourceT = TypeVar("SourceT", bound=type[Source])

_CLASSES: dict[str, type[Source]] = {kind.label.name: kind for kind in (CombinesWith, ComponentOf, BestRecipe)}


def register_source(kind: SourceT) -> SourceT:
    """Make a source known by the name in its label, in this process; a decorator of its class.

    Commands and their worker processes find a source by an entry point in the group ``wordcraft_kg.sources`` instead.

    Raises:
        ConfigError: if a source of this package has the name.
    """
    name = kind.label.name
    if name == ALPHA.name or name in BUILT_IN:
        raise ConfigError(f"the source '{name}' is built in; give the label of {kind.__name__} another name.")
    _CLASSES[name], LABELS[name] = kind, kind.label
    return kind


def source_class(name: str) -> type[Source]:
    """Return the class of a source by its name.

    Raises:
        ConfigError: if no source of that name is registered or installed.
    """
    if name not in _CLASSES:
        point = installed_sources().get(name)
        if point is None:
            raise ConfigError(
                f"there is no source '{name}'; expected one of {', '.join(source_names())}. Install the package that "
                "has it, or register its class."
            )
        register_source(point.load())
    return _CLASSES[name]


def pairs_need_factors(names: Iterable[str], scorer: TripleScorer, scale: Scale) -> bool:
    """Return whether tables of all pairs would be too large, so that sources have to score by factors.

    Raises:
        ConfigError: if they have to and cannot.
    """
    size = len(scorer.entities)
    needed = sum(source_class(name).num_bytes(scorer) for name in names)
    if needed <= TABLE_LIMIT:
        if (folded := folds_of(scorer)) is not None:
            what = "tables of the scores of all pairs, one for each"
            check_memory("folds", folded.count, what, needed * (folded.count + 2))
        return False
    cost = (
        f"the scores of all pairs of {size:,} entities take {needed / 2**20:,.0f} MiB; expected at most "
        f"{TABLE_LIMIT / 2**20:.0f} MiB, because sources look them up in tables"
    )
    if not isinstance(scorer, FactoredScorer):
        raise ConfigError(
            f"{cost}; only the scores of ComplEx, DistMult and the recipe kernel of low rank can be computed without. "
            "Take one of these."
        )
    if scale not in FACTORED_SCALES:
        raise ConfigError(f"`scale` {scale}: {cost}. Choose {' or '.join(FACTORED_SCALES)}, which need none.")
    return True


def make_sources(
    names: Iterable[str], scorer: TripleScorer, view: ScoreView = AS_IS, *, tasks: TaskSet | None = None
) -> list[Source]:
    """Return sources of a scorer by name, reading it as ``view`` says.

    ``tasks`` are those that will be scored, such as ``world.tasks``; without them, sources of a cross-fitted scorer
    answer for test tasks only.

    Raises:
        ConfigError: if the scorer cannot serve one, or only by a table that would be too large (before it is computed).
        LeakError: if a task would be scored by a model that has been trained on its recipes.
        GraphMismatchError: if the tasks are of another graph or split than the scorer's folds.

    Example:
        >>> u, v = make_sources(["u", "v"], load_scorer("models/kitchen"))
        >>> u.label.symbol, v.graph_hash == open_graph("kitchen").graph.hash
        ('u', True)
    """
    names = tuple(names)
    if tasks is not None:
        view = replace(view, tasks=tasks)
    if pairs_need_factors(names, scorer, view.scale):
        view = replace(view, by_factors=True)
    sources = [source_class(name).of_scorer(scorer, view) for name in names]
    for source in sources:
        source.graph_hash = scorer.graph_hash
    return sources
