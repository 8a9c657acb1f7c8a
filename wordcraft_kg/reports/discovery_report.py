"""A page for open-ended play: the entities that each player discovers."""

import numpy as np
from markupsafe import Markup
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
    pictures: dict[str, charts.Chart | Markup] = {"known": picture}
    if repeats:
        share = "share of the attempts so far"
        about = f"Mean {share} that combined a pair tried before"
        pictures["repeated"] = charts.curves(
            repeats, "attempts", share, about, percent=True, colours=colours
        )
    best = best_player(view)
    if best is not None and view.reachable <= MOST_MAPPED:
        learnt = plays.learnt[plays.players.index(best)]
        pictures["found"] = discovery_map(graph, view, learnt, best, colours[best])
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
    graph: RecipeGraph,
    view: DiscoveryView,
    learnt: NDArray[np.int32],
    player: str,
    number: int,
) -> Markup:
    """Draw when a player's runs learnt each entity: the median of the runs that did.

    Args:
        graph: the explored graph.
        view: the results, for base and attempts.
        learnt: attempt of each entity in each run, shape (runs, E).
        player: name of the player, for the text alternative.
        number: colour of the player.
    """
    layer = layers(graph, view.base)
    entities = []
    for entity in np.flatnonzero(layer >= 0).tolist():
        attempts = learnt[:, entity]
        made_attempts = attempts[attempts != NEVER]
        share = len(made_attempts) / len(attempts)
        attempt = float(np.median(made_attempts)) if len(made_attempts) else None
        label = graph.entities[entity]
        crafting_round = int(layer[entity])
        entities.append(charts.Found(label, crafting_round, attempt, share))
    about = f"Entities that {player} discovered, by crafting round; early ones in strong colour"
    return charts.found_map(entities, view.attempts, number, about)
