"""The first page: what there is to look at."""

from wordcraft_kg.apps.explorer.explored import Explored
from wordcraft_kg.apps.explorer.page import Page, State
from wordcraft_kg.apps.explorer.views.overview import Overview, view_overview


class Home(State):
    """There is one only."""


def _view(explored: Explored, _: Home) -> Overview:
    models = {name: one.model for name, one in explored.models.items()}
    return explored.once("overview", lambda: view_overview(explored.opened, models, explored.runs))


PAGE = Page("home", Home, _view)
