"""A map of discoveries: one cell for each entity, by crafting round, shaded by its attempt."""

import math
from collections import defaultdict
from collections.abc import Sequence
from typing import NamedTuple

from markupsafe import Markup

from wordcraft_kg.reports.charts.chart import element, titled

CELL = 10
"""Distance between the corners of two cells, in pixels."""
_SIZE = 9
_WIDTH = 460
"""Width of the map, as that of the other charts."""
_LEFT = 62  # room for "round 10"
_STEP = 3  # pixels between two rounds
_LIGHTEST = 0.2
"""Opacity of the last attempt; the first attempt is opaque."""


class Found(NamedTuple):
    """An entity on the map.

    Attributes:
        label: the entity.
        round: crafting round from which on it can be made, 0 for the base.
        attempt: attempt at which it became known, 0 for the base; None if it stayed unknown.
        share: share of the runs that learnt it.
    """

    label: str
    round: int
    attempt: float | None
    share: float


def found_map(entities: Sequence[Found], attempts: int, number: int, description: str) -> Markup:
    """Draw a map of discoveries: a line of cells for each round, early attempts in strong colour.

    Entities that stayed unknown are empty frames. A cell's tooltip names entity and attempt.

    Args:
        entities: the entities that can be made.
        attempts: attempts of a run, for the shades.
        number: colour of the cells.
        description: text alternative for people who do not see the map.
    """
    columns = (_WIDTH - _LEFT) // CELL
    by_round = defaultdict[int, list[Found]](list)
    for entity in entities:
        by_round[entity.round].append(entity)
    parts = []
    top = 4
    for round_number in sorted(by_round):
        name = f"round {round_number}"
        parts.append(element("text", name, x=0, y=top + 9, class_="small"))
        # The early ones first, then the unknown ones, each in alphabetical order.
        cells = sorted(by_round[round_number], key=_order)
        for place, entity in enumerate(cells):
            row, column = divmod(place, columns)
            x = _LEFT + column * CELL
            y = top + row * CELL
            parts.append(_cell(entity, x, y, attempts, number))
        num_rows = math.ceil(len(cells) / columns)
        top += num_rows * CELL + _STEP
    return element(
        "svg",
        *parts,
        viewBox=f"0 0 {_WIDTH} {top + 4}",
        role="img",
        aria_label=description,
    )


def _order(entity: Found) -> tuple[float, str]:
    if entity.attempt is None:
        return float("inf"), entity.label
    return entity.attempt, entity.label


def _cell(entity: Found, x: int, y: int, attempts: int, number: int) -> Markup:
    """Return an entity's square with its tooltip."""
    look = {"class_": "grid"}
    if entity.attempt is None:
        tooltip = f"{entity.label}: not found"
    else:
        attempt = "known at the start"
        if entity.attempt > 0:
            attempt = f"attempt {entity.attempt:g}"
        tooltip = f"{entity.label}: {attempt}"
        if entity.share < 1:
            tooltip += f", in {entity.share:.0%} of the runs"
        # By the square root: half of all entities are found in the first quarter of a run.
        late = (entity.attempt / attempts) ** 0.5
        opacity = 1 - (1 - _LIGHTEST) * late
        look["class_"] = f"series-{number}"
        look["fill_opacity"] = f"{opacity:.2f}"
    return element(
        "rect",
        titled(tooltip),
        x=x,
        y=y,
        width=_SIZE,
        height=_SIZE,
        **look,
    )
