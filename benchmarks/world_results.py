"""Open-ended play in many worlds: means and intervals over worlds, runs and fits.

One world measures luck with one recipe; ``cut_worlds`` cuts many. A player plays each world several times; a player with a trained scorer plays with several fits of it.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from bottlenecks import WorldStatistics, main_statistics
from numpy.typing import NDArray

from wordcraft_kg.agents.discovery import NEVER, Plays
from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.base.records import Count, Hash, Record, Share
from wordcraft_kg.base.statistics import crossed_difference, rate_interval
from wordcraft_kg.evaluation.discovery import ORACLES
from wordcraft_kg.graphs.recipe_graph import RecipeGraph

MARKS = (50, 100, 200, 300, 500)
"""Numbers of attempts at which known entities are reported."""
_POINTS = 50  # points of a mean curve in the results, besides its start


class PlayedWorld(NamedTuple):
    """All runs in a world.

    Attributes:
        graph: the world.
        fits: runs by fit. The first holds all players; others hold the players whose scorer was
            fitted again.
        shared: recipes of the world in the training of each player's scorer; 0 for others.
    """

    graph: RecipeGraph
    fits: Sequence[Plays]
    shared: Mapping[str, int]

    def fits_of(self, player: str) -> list[Plays]:
        """Return the runs of all fits in which a player plays."""
        return [plays for plays in self.fits if player in plays.players]


class Estimated(Record):
    """A mean over worlds, runs and fits.

    Attributes:
        mean: the mean.
        low: lower bound of the 95 % interval; None where nothing varies.
        high: upper bound; None likewise.
    """

    mean: float
    low: float | None
    high: float | None


class WorldResult(Record):
    """A world, and what the players reached in it.

    Attributes:
        name: name of the world.
        hash: content hash of its graph.
        base: labels known at the start.
        statistics: sizes and bottlenecks, the main one first.
        oracle: the better of the players that know the world.
        areas: mean area under each player's curve, relative to the oracle's.
        passed: share of each player's runs that learn the main bottleneck; empty without one.
        passed_at: median attempt of these runs; players without any are left out.
        shared: recipes of the world in the training of a player's scorer; players with none are
            left out.
        more_attempts_than_pairs: whether a run may end before its attempts are used.
    """

    name: str
    hash: Hash
    base: tuple[str, ...]
    statistics: WorldStatistics
    oracle: str
    areas: dict[str, float]
    passed: dict[str, Share]
    passed_at: dict[str, float]
    shared: dict[str, Count]
    more_attempts_than_pairs: bool


class WorldsPlayer(Record):
    """A player's results over all worlds.

    Attributes:
        fits: number of fits of the scorer; 1 for players without one.
        known: known entities by number of attempts.
        area: area under the curve, relative to the oracle's.
        passed: share of the runs that learn their world's main bottleneck; None without any.
        curve: mean number of known entities by number of attempts, with interval.
    """

    fits: Count
    known: dict[str, Estimated]
    area: Estimated
    passed: Estimated | None
    curve: dict[str, Estimated]


class WorldsView(Record):
    """Results of open-ended play in many worlds.

    Attributes:
        attempts: attempts of each run.
        runs: runs of each player in each world, with each fit.
        worlds: the worlds.
        players: results by player.
        differences: difference of the relative area to the best player that does not know the
            world, paired by world, run and fit; without the oracles.
        best: this player; None if only oracles play.
    """

    attempts: int
    runs: int
    worlds: tuple[WorldResult, ...]
    players: dict[str, WorldsPlayer]
    differences: dict[str, Estimated]
    best: str | None


def curve_area(known: NDArray[np.integer]) -> NDArray[np.float64]:
    """Return the mean number of discovered entities over all attempts: the area under a curve.

    ``area = mean_{t = 1..n} (known_t - known_0)``. Unlike the number at the end, it counts early
    discoveries more, and does not depend on the size of the base.

    Args:
        known: number of known entities after each attempt, 0 first, shape (..., n + 1).
    """
    gained = known[..., 1:] - known[..., :1]
    return np.asarray(gained.mean(axis=-1), dtype=np.float64)


def oracle_area(plays: Plays) -> tuple[str, float]:
    """Return the better of the :data:`ORACLES`, and its mean area over runs.

    Raises:
        ConfigError: if neither plays.
    """
    areas = {}
    for number, name in enumerate(plays.players):
        if name in ORACLES:
            areas[name] = float(curve_area(plays.known[number]).mean())
    if not areas:
        raise ConfigError(
            f"`players` {', '.join(plays.players)}: expected one of {', '.join(ORACLES)}, whose "
            "area is the measure of all others."
        )
    best = max(areas, key=lambda name: areas[name])
    return best, areas[best]


def _shapes(world: PlayedWorld) -> list[tuple[tuple[str, ...], tuple[int, ...]]]:
    """Return the players, and the numbers of runs and attempts, of each fit of a world."""
    return [(plays.players, plays.known.shape) for plays in world.fits]


def view_worlds(worlds: Sequence[PlayedWorld]) -> WorldsView:
    """Summarise runs in many worlds.

    Intervals are those of :func:`~wordcraft_kg.base.statistics.crossed_difference`: worlds are
    groups of runs, and fits are seeds, so that a luckily drawn world or fit widens the interval.

    Args:
        worlds: the runs; each world with the same players, runs, attempts and fits.

    Raises:
        ConfigError: without worlds, for worlds with other players, or without an oracle.
    """
    if not worlds:
        raise ConfigError("`worlds`: expected at least one world.")
    first = worlds[0].fits[0]
    # Results of all worlds become one array, (fits, worlds, runs, attempts + 1).
    expected = _shapes(worlds[0])
    for world in worlds:
        if _shapes(world) != expected:
            played = ", ".join(world.fits[0].players)
            wanted = ", ".join(first.players)
            raise ConfigError(
                f"`worlds`: {world.graph.name} was played by {played}; expected {wanted}, with as "
                "many runs, attempts and fits."
            )
    attempts = first.known.shape[2] - 1
    results = tuple(_result_of(world, attempts) for world in worlds)
    # One oracle for all fits and runs of a world, or its luck would change the ratio.
    oracle_areas = np.array([oracle_area(world.fits[0])[1] for world in worlds])
    areas: dict[str, NDArray[np.float64]] = {}
    players = {}
    for name in first.players:
        known = _known_of(worlds, name)
        areas[name] = curve_area(known) / oracle_areas[None, :, None]
        passed = _passed_of(worlds, results, name)
        players[name] = _player(known, areas[name], passed, attempts)
    # An oracle is the measure, and no competitor.
    others = {name: float(area.mean()) for name, area in areas.items() if name not in ORACLES}
    best = max(others, key=lambda name: others[name], default=None)
    differences = {}
    if best is not None:
        for name in others:
            if name != best:
                differences[name] = _estimate(_paired(areas[best], areas[name]))
    return WorldsView(attempts, first.known.shape[1], results, players, differences, best)


def _paired(one: NDArray[np.float64], other: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return differences of two players, shape (fits, worlds, runs).

    A player without a scorer has one fit, which is compared with every fit of the other.
    """
    if len(one) > 1 and len(other) > 1:
        # Fits in their order are pairs, as far as both players have them.
        fits = min(len(one), len(other))
        return one[:fits] - other[:fits]
    # Axis 0 of length 1 broadcasts over the fits of the other.
    return one - other


def _known_of(worlds: Sequence[PlayedWorld], name: str) -> NDArray[np.int64]:
    """Return a player's curves, shape (fits, worlds, runs, attempts + 1)."""
    by_world = []
    for world in worlds:
        fits = [plays.known[plays.players.index(name)] for plays in world.fits_of(name)]
        by_world.append(fits)
    # From (worlds, fits, ...): a comparison averages over worlds, fit by fit.
    return np.array(by_world).swapaxes(0, 1)


def _passed_of(
    worlds: Sequence[PlayedWorld], results: Sequence[WorldResult], name: str
) -> NDArray[np.float64] | None:
    """Return which runs learnt their main bottleneck, shape (fits, worlds with one, runs)."""
    by_world = []
    for world, result in zip(worlds, results, strict=True):
        main = result.statistics.main
        if main is not None:
            entity = world.graph.id_of(main.entity)
            by_world.append(_learnt_of(world, name)[:, :, entity] != NEVER)
    if not by_world:
        return None
    return np.array(by_world, dtype=np.float64).swapaxes(0, 1)


def _learnt_of(world: PlayedWorld, name: str) -> NDArray[np.int32]:
    """Return when a player learnt each entity of a world, shape (fits, runs, E)."""
    fits = world.fits_of(name)
    return np.array([plays.learnt[plays.players.index(name)] for plays in fits])


def _result_of(world: PlayedWorld, attempts: int) -> WorldResult:
    graph = world.graph
    statistics = main_statistics(graph, graph.base_ids.tolist())
    oracle, area = oracle_area(world.fits[0])
    areas = {}
    passed = {}
    passed_at = {}
    for name in world.fits[0].players:
        areas[name] = float(curve_area(_known_of([world], name)).mean() / area)
        if statistics.main is not None:
            entity = graph.id_of(statistics.main.entity)
            # Fits and runs are alike here: both are one more try of the player.
            learnt = _learnt_of(world, name)[:, :, entity].ravel()
            found = learnt[learnt != NEVER]
            passed[name] = len(found) / len(learnt)
            if len(found):
                passed_at[name] = float(np.median(found))
    return WorldResult(
        name=graph.name,
        hash=graph.hash,
        base=graph.base,
        statistics=statistics,
        oracle=oracle,
        areas=areas,
        passed=passed,
        passed_at=passed_at,
        shared={name: number for name, number in world.shared.items() if number},
        more_attempts_than_pairs=attempts > statistics.pairs,
    )


def _player(
    known: NDArray[np.int64],
    areas: NDArray[np.float64],
    passed: NDArray[np.float64] | None,
    attempts: int,
) -> WorldsPlayer:
    """Summarise a player.

    Args:
        known: shape (fits, worlds, runs, attempts + 1).
        areas: relative areas, shape (fits, worlds, runs).
        passed: passed main bottlenecks, shape (fits, worlds with one, runs); None without any.
        attempts: attempts of each run.
    """
    marks = sorted({attempts, *(mark for mark in MARKS if mark <= attempts)})
    # Evenly spaced attempts, each once where there are fewer attempts than points.
    spaced = np.linspace(0, attempts, _POINTS + 1)
    points = np.unique(spaced.round().astype(int))
    return WorldsPlayer(
        fits=len(known),
        known={str(mark): _estimate(known[..., mark]) for mark in marks},
        area=_estimate(areas),
        passed=None if passed is None else _share(passed),
        curve={str(point): _estimate(known[..., point]) for point in points.tolist()},
    )


def _estimate(values: NDArray[np.number]) -> Estimated:
    """Return the mean of values, shape (fits, worlds, runs), with its interval."""
    table, groups = _table_of(values)
    mean = float(table.mean())
    # The interval is made for differences between -1 and 1, and scales with the values.
    scale = float(np.abs(table).max())
    if np.ptp(table) == 0:
        return Estimated(mean, None, None)
    (_, low, high), _ = crossed_difference(table / scale, groups)
    return Estimated(mean, low * scale, high * scale)


def _share(values: NDArray[np.float64]) -> Estimated:
    """Return the mean of 0 and 1, shape (fits, worlds, runs), with its interval."""
    table, groups = _table_of(values)
    low, high = rate_interval(table, groups)
    return Estimated(float(table.mean()), low, high)


def _table_of(values: NDArray[np.number]) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return values as a table of fits and runs, and the group of each column.

    Runs of a world are a group. In a single world each run is one: the interval then says nothing
    of other worlds.
    """
    fits, worlds, runs = values.shape
    table = values.reshape(fits, worlds * runs).astype(np.float64)
    groups = np.arange(runs) if worlds == 1 else np.repeat(np.arange(worlds), runs)
    return table, groups
