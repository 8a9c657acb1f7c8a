"""A run of an agent: how far it has come, its curves, its settings, and where it comes from."""

from collections.abc import Iterator

from wordcraft_kg.apps.explorer.explored import Explored
from wordcraft_kg.apps.explorer.page import Page, State, has_runs
from wordcraft_kg.apps.explorer.played import followed, is_done
from wordcraft_kg.apps.explorer.views.runs import RunView, view_run
from wordcraft_kg.reports.agent_pictures import picture_of_lambdas, picture_of_success, pictures_of_figures


class Run(State):
    """A run; by default the first one."""

    run: str = ""


def _view(explored: Explored, state: Run) -> RunView:
    return view_run(*followed(explored, state.run))


def _draw(view: RunView, *_: object) -> dict[str, object]:
    name = view.row.name
    # Success on test tasks has a picture of its own.
    figures = dict(view.training)
    figures.pop("test_success", None)
    return {
        "success": picture_of_success({name: view.curves}) if view.curves else "",
        "lambdas": picture_of_lambdas(name, view.lambdas) if view.lambdas else "",
        "training": pictures_of_figures({name: figures}),
    }


def _is_live(explored: Explored, state: Run) -> bool:
    return not is_done(followed(explored, state.run)[1])


def _exported(explored: Explored) -> Iterator[Run]:
    return (Run(name) for name in explored.runs)


PAGE = Page("run", Run, _view, subject="run", draw=_draw, exported=_exported, is_there=has_runs, is_live=_is_live)
