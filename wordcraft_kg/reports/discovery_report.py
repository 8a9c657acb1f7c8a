"""Pages for open-ended play: entities that each player discovers, in one world and in many."""

from collections.abc import Mapping, Sequence

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
from wordcraft_kg.evaluation.discovery_worlds import Estimated, PlayedWorld, WorldsView
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
    known: dict[str, list[charts.CurvePoint]] = {name: [] for name in drawn}
    repeated: dict[str, list[charts.CurvePoint]] = {name: [] for name in view.players}
    names = ("player", "attempt", "mean", "low", "high", "repeated")
    columns = [table[name].tolist() for name in names]
    for player, attempt, mean, low, high, share in zip(*columns, strict=True):
        # Bounds are equal if all runs agree, and NaN for a single run.
        bounds = (low, high) if low < high else (None, None)
        known[player].append((attempt, mean, *bounds))
        repeated[player].append((attempt, share, None, None))
    for attempt, mean in HUMAN_CURVE.items():
        if attempt <= view.attempts:
            known[_PEOPLE].append((attempt, mean, None, None))
    # Players that never repeat a pair are named in the text: their curves would all lie at 0.
    repeats = {}
    for name, points in repeated.items():
        if any(share for _, share, _, _ in points):
            repeats[name] = points
    about = "Mean number of entities known after each attempt"
    picture = charts.curves(known, "attempts", "entities known", about, colours=colours)
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
        known = attempts[attempts != NEVER]
        share = len(known) / len(attempts)
        attempt = float(np.median(known)) if len(known) else None
        label = graph.entities[entity]
        crafting_round = int(layer[entity])
        entities.append(charts.Found(label, crafting_round, attempt, share))
    about = f"Entities that {player} discovered, by crafting round; early ones in strong colour"
    return charts.found_map(entities, view.attempts, number, about)


def worlds_page(view: WorldsView, worlds: Sequence[PlayedWorld]) -> str:
    """Render results in many worlds as an HTML page.

    Args:
        view: the results.
        worlds: the runs that they summarise, for the curves of each world.
    """
    colours = {name: number for number, name in enumerate(view.players)}
    known: dict[str, list[charts.CurvePoint]] = {}
    for name, player in view.players.items():
        known[name] = []
        for attempt, value in player.curve.items():
            known[name].append((int(attempt), *_bounds(value)))
    about = "Mean number of entities known after each attempt, over all worlds"
    picture = charts.curves(known, "attempts", "entities known", about, colours=colours)
    pictures = {"known": picture}
    areas = []
    passed = []
    for name, player in view.players.items():
        areas.append((name, _bounds(player.area)))
        if player.passed is not None:
            passed.append((name, _bounds(player.passed)))
    about = "Area under each player's curve, relative to the better oracle of each world"
    pictures["areas"] = charts.intervals(areas, "relative area", about, percent=True)
    if passed:
        about = "Share of the runs that learn the main bottleneck of their world"
        pictures["passed"] = charts.intervals(passed, "runs", about, percent=True)
    by_world = []
    for world, played in zip(view.worlds, worlds, strict=True):
        curves = _world_curves(played, world.name, colours)
        by_world.append((world.name, curves))
    return render_page(
        "worlds_report.html.j2",
        report=view,
        pictures=pictures,
        by_world=by_world,
        oracles=ORACLES,
    )


def _bounds(value: Estimated) -> charts.Estimate:
    """Return a value with its bounds, as charts take it."""
    return value.mean, value.low, value.high


def _world_curves(played: PlayedWorld, name: str, colours: Mapping[str, int]) -> charts.Chart:
    """Draw the mean curves of one world, of each player over runs and fits."""
    series: dict[str, list[charts.CurvePoint]] = {}
    for player in played.fits[0].players:
        runs = []
        for plays in played.fits_of(player):
            number = plays.players.index(player)
            runs.append(plays.known[number])
        mean = np.concatenate(runs).mean(axis=0)
        # A curve of 40 steps is smooth, and twenty worlds fit on a page.
        last = len(mean) - 1
        steps = np.linspace(0, last, 41).round()
        # Short runs have fewer attempts than steps.
        attempts = np.unique(steps.astype(int)).tolist()
        series[player] = [(attempt, float(mean[attempt]), None, None) for attempt in attempts]
    about = f"Mean number of entities known after each attempt in {name}"
    return charts.curves(series, "attempts", "entities known", about, colours=colours)
