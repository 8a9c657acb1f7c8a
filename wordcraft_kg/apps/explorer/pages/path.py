"""The path to a goal: what has to be crafted, layer by layer, and the same as a list."""

from collections.abc import Iterator, Mapping

import numpy as np
from markupsafe import Markup

from wordcraft_kg.apps.explorer import asked
from wordcraft_kg.apps.explorer.explored import Explored
from wordcraft_kg.apps.explorer.page import Addresses, Page, State
from wordcraft_kg.apps.explorer.views.paths import PathView, view_path
from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.graphs.planner import layers
from wordcraft_kg.reports import charts


class Path(State):
    """The path to an entity.

    Attributes:
        entity: the goal; without one, an entity that is the furthest from the base.
        page: page of the list of crafts.
    """

    entity: str = ""
    page: int = 1


def _view(explored: Explored, state: Path) -> PathView:
    graph = explored.opened.graph
    if not graph.num_entities:
        raise ConfigError("The graph has no entities.")
    goal = state.entity or explored.once("furthest", lambda: graph.entities[int(np.argmax(layers(graph)))])
    return view_path(asked.planner(explored), explored.opened.split, goal, state.page)


def _draw(view: PathView, _: Path, address: Addresses) -> Mapping[str, Markup]:
    if not view.drawn:
        return {}
    things = [
        charts.Made(
            label=step.recipe.result,
            href=address(PAGE, Path(entity=step.recipe.result)),
            layer=step.layer,
            of=step.recipe[:2],
            style=" ".join(
                (["goal"] if step.recipe.result == view.entity else []) + (["held"] if step.part != "train" else [])
            ),
            title=f"{step.recipe[0]} + {step.recipe[1]} → {step.recipe[2]} ({step.part})",
        )
        for step in view.drawn
    ]
    return {"layers": charts.layered(things, view.base, f"Crafts that lead to {view.entity}, in layers")}


def _is_there(explored: Explored) -> bool:
    return explored.opened.graph.num_entities > 0


def _exported(explored: Explored) -> Iterator[Path]:
    yield Path()
    yield from (Path(entity=label) for label in explored.opened.graph.entities)


PAGE = Page(
    "path", Path, _view, title="Path to a goal", subject="entity", draw=_draw, exported=_exported, is_there=_is_there
)
