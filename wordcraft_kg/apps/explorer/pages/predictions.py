"""The ranks of all triples by a model, to filter and to sort."""

from collections.abc import Iterator
from typing import Literal

from wordcraft_kg.apps.explorer import asked
from wordcraft_kg.apps.explorer.explored import Explored
from wordcraft_kg.apps.explorer.page import Page, State, has_models
from wordcraft_kg.apps.explorer.views.link_ranks import Knowledge, LinkRanks, RankFilter, RankOrder, view_link_ranks
from wordcraft_kg.graphs.splits import Part
from wordcraft_kg.graphs.triples import RELATIONS, Relation
from wordcraft_kg.models.scorers.roles import Side


class Queries(State):
    """Some of the queries that models are ranked on.

    Attributes:
        relation: relation of the triples; both if it is empty.
        side: the side that is asked for; both if it is empty.
        part: the part whose recipes give the triple; any if it is empty.
        known: whether the model was trained on the triple; of two, both, or neither.
        entity: head or tail of the triple; any if it is empty.
        page: number of the page.
    """

    relation: Relation | Literal[""] = ""
    side: Side | Literal[""] = ""
    part: Part | Literal[""] = ""
    known: Knowledge = "unseen"
    entity: str = ""
    page: int = 1

    @property
    def chosen(self) -> RankFilter:
        """Which queries these are."""
        return RankFilter(self.relation, self.side, self.part, self.known, self.entity)


class Predictions(Queries):
    """Some of a model's ranks.

    Attributes:
        model: the model; the first if it is empty.
        sort: by what they are sorted.
    """

    model: str = ""
    sort: RankOrder = "best"


def _view(explored: Explored, state: Predictions) -> LinkRanks:
    return view_link_ranks(asked.ranked(explored, state.model), state.chosen, state.sort, state.page)


def _exported(explored: Explored) -> Iterator[Predictions]:
    for name in ("", *list(explored.models)[1:]):
        for sort in ("best", "worst"):
            yield Predictions(model=name, sort=sort)
            yield from (Predictions(model=name, relation=relation, sort=sort) for relation in RELATIONS)


PAGE = Page("predictions", Predictions, _view, title="Predictions", exported=_exported, is_there=has_models)
