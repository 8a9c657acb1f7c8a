"""All runs of agents side by side."""

from wordcraft_kg.apps.explorer.explored import Explored
from wordcraft_kg.apps.explorer.page import Page, State, has_runs
from wordcraft_kg.apps.explorer.played import followed, is_done
from wordcraft_kg.apps.explorer.views.runs import RunList, view_runs


class Runs(State):
    """There is one only."""


def _view(explored: Explored, _: Runs) -> RunList:
    return view_runs(dict(followed(explored, name) for name in explored.runs))


def _is_live(explored: Explored, _: Runs) -> bool:
    return not all(is_done(followed(explored, name)[1]) for name in explored.runs)


PAGE = Page("runs", Runs, _view, title="Runs", is_there=has_runs, is_live=_is_live)
