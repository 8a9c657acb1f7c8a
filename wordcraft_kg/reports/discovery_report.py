"""The page for open-ended play: entities that each player discovers."""

from typing import TYPE_CHECKING

from wordcraft_kg.agents.discovery import DISCOVERERS, HUMAN_CURVE, summarise_curves
from wordcraft_kg.evaluation.discovery import DiscoveryView
from wordcraft_kg.reports import charts
from wordcraft_kg.reports.pages import render_page

if TYPE_CHECKING:
    import pandas as pd

_PEOPLE = "people (another game)"


def discovery_page(view: DiscoveryView, curves: "pd.DataFrame") -> str:
    """Render results of open-ended play as an HTML page.

    Args:
        view: the results.
        curves: known entities after each attempt of each run, by
            :func:`~wordcraft_kg.agents.discovery.discovery_curves`.
    """
    # Every attempt, and not only the marks of the view: a curve needs all its points.
    table = summarise_curves(curves, range(view.attempts + 1))
    # People come last, so that the players have the colours of the other charts.
    drawn = (*view.players, _PEOPLE)
    colours = {name: number for number, name in enumerate(drawn)}
    known: dict[str, list[charts.CurvePoint]] = {}
    repeated: dict[str, list[charts.CurvePoint]] = {}
    for name in view.players:
        known[name] = []
        repeated[name] = []
    names = ("player", "attempt", "mean", "low", "high", "repeated")
    columns = [table[name].tolist() for name in names]
    for player, attempt, mean, low, high, share in zip(*columns, strict=True):
        # Bounds are equal if all runs agree, and NaN for a single run.
        bounds = (low, high) if low < high else (None, None)
        known[player].append((attempt, mean, *bounds))
        repeated[player].append((attempt, share, None, None))
    known[_PEOPLE] = [
        (attempt, mean, None, None)
        for attempt, mean in HUMAN_CURVE.items()
        if attempt <= view.attempts
    ]
    # Players that never repeat a pair are named in the text: their curves would all lie at 0.
    repeats = {}
    for name, points in repeated.items():
        if any(share for _, share, _, _ in points):
            repeats[name] = points
    about = "Mean number of entities known after each attempt"
    picture = charts.curves(known, "attempts", "entities known", about, colours=colours)
    pictures = {"known": picture}
    if repeats:
        share = "share of the attempts so far"
        about = f"Mean {share} that combined a pair tried before"
        pictures["repeated"] = charts.curves(
            repeats, "attempts", share, about, percent=True, colours=colours
        )
    return render_page(
        "discovery_report.html.j2",
        report=view,
        pictures=pictures,
        about=DISCOVERERS,
        never_repeat=[name for name in view.players if name not in repeats],
    )
