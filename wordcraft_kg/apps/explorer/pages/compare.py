"""Two models of the graph on the same queries: which of them is better, and where they differ most."""

from collections.abc import Iterator

from wordcraft_kg.apps.explorer import asked
from wordcraft_kg.apps.explorer.explored import Explored
from wordcraft_kg.apps.explorer.page import Page
from wordcraft_kg.apps.explorer.pages.predictions import Queries
from wordcraft_kg.apps.explorer.views.link_ranks import (
    Better,
    ComparedRanks,
    check_comparable,
    view_compared_ranks,
)
from wordcraft_kg.base.errors import ConfigError, SplitError
from wordcraft_kg.base.records import Record
from wordcraft_kg.evaluation import link_comparison


class Compare(Queries):
    """Two models and some queries.

    Attributes:
        one: a model; the first if it is empty.
        other: another one; the second if it is empty.
        better: queries that one of them ranks better, or all.
    """

    one: str = ""
    other: str = ""
    better: Better = "either"


class ModelsCompared(Record):
    """Two models.

    Attributes:
        headline: the same as ``compare`` says; None if there is too little to say it.
        without_headline: why there is none.
        ranks: the queries.
    """

    headline: link_comparison.LinkComparison | None
    without_headline: str
    ranks: ComparedRanks


def has_two_models(explored: Explored) -> bool:
    """Return whether there is something to compare."""
    return len(explored.models) > 1


def _view(explored: Explored, state: Compare) -> ModelsCompared:
    if not has_two_models(explored):
        raise ConfigError("Two models are compared; start with two of `wordcraft-kg explore GRAPH --model FOLDER`.")
    names = list(explored.models)
    first = state.one or next(name for name in names if name != state.other)
    second = state.other or next(name for name in names if name != first)
    one, other = asked.predictor(explored, first), asked.predictor(explored, second)
    check_comparable(one, other)
    headline, why = explored.once(("compared", one.name, other.name), lambda: _headline(one, other))
    one_ranks, other_ranks = asked.ranked(explored, one.name), asked.ranked(explored, other.name)
    ranks = view_compared_ranks(one_ranks, other_ranks, state.chosen, state.better, state.page)
    return ModelsCompared(headline, why, ranks)


def _headline(
    one: asked.LinkPredictor, other: asked.LinkPredictor
) -> tuple[link_comparison.LinkComparison | None, str]:
    contenders = [link_comparison.Contender(model.name, [model.model]) for model in (one, other)]
    try:
        return link_comparison.compare(contenders), ""
    except SplitError as error:
        return None, str(error)


def _exported(explored: Explored) -> Iterator[Compare]:
    yield from (Compare(better=better) for better in ("either", "one", "other"))


PAGE = Page("compare", Compare, _view, title="Compare", exported=_exported, is_there=has_two_models)
