"""How much players discover in open-ended play, as one self-contained HTML page."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from wordcraft_kg.agents.discovery import DISCOVERERS, HUMAN_CURVE
from wordcraft_kg.reports import charts
from wordcraft_kg.reports.pages import render_page
from wordcraft_kg.views.discovery import DiscoveryView

if TYPE_CHECKING:
    import pandas as pd

PEOPLE = "people (another game)"


def discovery_page(view: DiscoveryView, curves: "pd.DataFrame") -> str:
    """Return the page.

    Args:
        view: the discoveries.
        curves: from :func:`wordcraft_kg.agents.discovery.discovery_curves`.
    """
    means = curves.groupby(["player", "attempt"], sort=False)["known"].mean()
    series: dict[str, Sequence[tuple[float, float]]] = {name: list(means[name].items()) for name in view.players}
    series[PEOPLE] = [(attempt, known) for attempt, known in HUMAN_CURVE.items() if attempt <= view.attempts]
    picture = charts.lines(
        series, "attempts", "entities known", "mean number of entities known after each attempt", legend_left=True
    )
    repeats = curves.assign(repeated=curves.groupby(["player", "run"], sort=False)["repeated"].cumsum())
    means = repeats.groupby(["player", "attempt"], sort=False)["repeated"].mean()
    repeated = charts.lines(
        {name: list(means[name].items()) for name in view.players},
        "attempts",
        "attempts repeated",
        "mean number of attempts so far that combined a pair tried before",
        legend_left=True,
    )
    return render_page("discovery_report.html.j2", report=view, picture=picture, repeated=repeated, about=DISCOVERERS)
