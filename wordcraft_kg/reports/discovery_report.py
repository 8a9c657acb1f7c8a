"""A page for open-ended play: the entities that each player discovers."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from wordcraft_kg.agents.discovery import (
    DISCOVERERS,
    HUMAN_CURVE,
    NEVER,
    Plays,
    summarise_curves,
)
from wordcraft_kg.evaluation.discovery import ORACLES, DiscoveryView
from wordcraft_kg.graphs.planner import layers
from wordcraft_kg.graphs.recipe_graph import RecipeGraph
from wordcraft_kg.reports import charts
from wordcraft_kg.reports.pages import render_page

_PEOPLE = "people (another game)"
MOST_MAPPED = 2_000
"""Most entities on a map of discoveries; more would make the page too large to open."""
MOST_REASONS = 40
"""Attempts with reasons at the start of a run; of later ones only those that made something."""
_CELL = 10
"""Distance between the corners of two squares of a map, in pixels; the map is 460 pixels wide."""
_LEFT = 62  # room for "round 10"
_COLUMNS = (460 - _LEFT) // _CELL
_STEP = 3  # pixels between two rounds


class Square(NamedTuple):
    """An entity on a map of discoveries.

    Attributes:
        label: the entity.
        round: crafting round from which on it can be made, 0 for the base.
        x, y: upper left corner, in pixels.
        attempt: median attempt at which it became known, 0 for the base; infinite if it stayed
            unknown.
        share: share of the runs that learnt it.
    """

    label: str
    round: int
    x: int
    y: int
    attempt: float
    share: float


def discovery_page(view: DiscoveryView, plays: Plays, graph: RecipeGraph) -> str:
    """Render results of open-ended play as an HTML page.

    Args:
        view: the results.
        plays: the runs, by :func:`~wordcraft_kg.agents.discovery.play_runs`.
        graph: the explored graph.
    """
    # Every attempt, and not only the marks of the view: a curve needs all its points.
    table = summarise_curves(plays.frame(), range(view.attempts + 1))
    # People come last, so that the players have the colours of the other charts.
    drawn = (*view.players, _PEOPLE)
    colours = {name: number for number, name in enumerate(drawn)}
    curves: dict[str, list[charts.CurvePoint]] = {name: [] for name in drawn}
    repeated: dict[str, list[charts.CurvePoint]] = {name: [] for name in view.players}
    names = ("player", "attempt", "mean", "low", "high", "repeated")
    columns = [table[name].tolist() for name in names]
    for player, attempt, mean, low, high, share in zip(*columns, strict=True):
        # Bounds are equal if all runs agree, and NaN for a single run.
        bounds = (low, high) if low < high else (None, None)
        curves[player].append((attempt, mean, *bounds))
        repeated[player].append((attempt, share, None, None))
    for attempt, mean in HUMAN_CURVE.items():
        if attempt <= view.attempts:
            curves[_PEOPLE].append((attempt, mean, None, None))
    # Players that never repeat a pair are named in the text: their curves would all lie at 0.
    repeats = {}
    for name, points in repeated.items():
        if any(share for _, share, _, _ in points):
            repeats[name] = points
    about = "Mean number of entities known after each attempt"
    picture = charts.curves(curves, "attempts", "entities known", about, colours=colours)
    pictures = {"known": picture}
    if repeats:
        share = "share of the attempts so far"
        about = f"Mean {share} that combined a pair tried before"
        pictures["repeated"] = charts.curves(
            repeats, "attempts", share, about, percent=True, colours=colours
        )
    best = best_player(view)
    squares: list[Square] = []
    height = 0
    if best is not None and view.reachable <= MOST_MAPPED:
        squares, height = discovery_map(graph, view, plays.learnt[plays.players.index(best)])
    reasons = []
    for tried in view.tried:
        if tried.made or tried.attempt <= MOST_REASONS:
            reasons.append(tried)
    return render_page(
        "discovery_report.html.j2",
        report=view,
        pictures=pictures,
        about=DISCOVERERS,
        best=best,
        best_colour=None if best is None else colours[best],
        squares=squares,
        height=height,
        reasons=reasons,
        never_repeat=[name for name in view.players if name not in repeats],
    )


def best_player(view: DiscoveryView) -> str | None:
    """Return the player with the most entities at the end, oracles apart; None without any."""
    last = str(view.marks[-1])
    means = {}
    for name, results in view.players.items():
        if name not in ORACLES:
            means[name] = results[last].mean
    return max(means, key=lambda name: means[name], default=None)


def discovery_map(
    graph: RecipeGraph, view: DiscoveryView, learnt: NDArray[np.int32]
) -> tuple[list[Square], int]:
    """Return a map of when a player's runs learnt each entity: the median of the runs that did.

    Args:
        graph: the explored graph.
        view: the results, for base and attempts.
        learnt: attempt of each entity in each run, shape (runs, E).

    Returns:
        A square for each entity that can be made, in lines by crafting round, and the height of
        the map.
    """
    layer = layers(graph, view.base)
    shares = (learnt != NEVER).mean(axis=0)
    medians = np.ma.median(np.ma.masked_equal(learnt, NEVER), axis=0).filled(np.inf)
    squares = []
    top = 4
    for crafting_round in range(layer.max() + 1):
        # The early ones first, then the unknown ones, each in alphabetical order.
        members = np.flatnonzero(layer == crafting_round).tolist()
        members.sort(key=lambda entity: (medians[entity], graph.entities[entity]))
        for place, entity in enumerate(members):
            row, column = divmod(place, _COLUMNS)
            square = Square(
                label=graph.entities[entity],
                round=crafting_round,
                x=_LEFT + column * _CELL,
                y=top + row * _CELL,
                attempt=float(medians[entity]),
                share=float(shares[entity]),
            )
            squares.append(square)
        top += math.ceil(len(members) / _COLUMNS) * _CELL + _STEP
    return squares, top + 4
