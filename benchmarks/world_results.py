"""Open-ended play in many worlds: bottlenecks, means and intervals over worlds, runs and fits.

One world measures luck with one recipe; ``cut_worlds`` cuts many. A player plays each world several times; a player with a trained scorer plays with several fits of it.
"""

from collections.abc import Iterable, Mapping, Sequence
from operator import attrgetter
from typing import NamedTuple

import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from wordcraft_kg.agents.discovery import NEVER, Plays
from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.base.records import Count, Hash, Record, Share
from wordcraft_kg.base.statistics import crossed_difference, rate_interval
from wordcraft_kg.evaluation.discovery import ORACLES
from wordcraft_kg.graphs.planner import layers, rounds
from wordcraft_kg.graphs.recipe_graph import Entity, RecipeGraph

MOST_ANALYSED = 5_000
"""Most entities of a graph with bottlenecks: each entity costs a walk through all recipes."""


class Bottleneck(Record):
    """An entity without which others cannot be made.

    Attributes:
        entity: label.
        needed_by: number of other entities that become unreachable without it.
        round: crafting round from which on it can be made.
    """

    entity: str
    needed_by: Count
    round: Count


class WorldStatistics(Record):
    """Sizes and bottlenecks of the part of a graph that can be made.

    Attributes:
        reachable: number of entities that can be made from the base, including the base.
        width: entities that become known in each round, in which all known pairs are combined;
            the first number is the base.
        success_rate: share of the unordered pairs of reachable entities, a + a among them, with a
            recipe.
        pairs: number of these pairs.
        bottlenecks: made entities that others need, those needed by most first.
        main: the main bottleneck: of the entities that half of the world needs, the one of the
            latest round; without any, the one needed by most. Earlier ones are on the way to it,
            and every player passes them. None without bottlenecks.
    """

    reachable: Count
    width: tuple[Count, ...]
    success_rate: Share
    pairs: Count
    bottlenecks: tuple[Bottleneck, ...]
    main: Bottleneck | None


def bottlenecks(graph: RecipeGraph, base: Iterable[Entity] | None = None) -> list[tuple[int, int]]:
    """Count the entities that need each made entity.

    Args:
        graph: the recipe graph; the time grows with its entities times its recipes.
        base: entities known at the start; None for the graph's base.

    Returns:
        Pairs (entity id, number of other entities that cannot be made without it), the largest
        number first, then by id; without entities that none needs.

    Raises:
        UnknownEntityError: if an entity in ``base`` is not in the graph.
    """
    layer = layers(graph, base)
    is_used = graph.use_counts > 0
    *ingredients, result = graph.sets.T
    reachable = layer >= 0
    number = int(reachable.sum())
    losses = []
    for entity in np.flatnonzero((layer > 0) & is_used).tolist():
        # Entities of the same round and of earlier ones are made without it.
        is_known = np.append(reachable & (layer <= layer[entity]), True)  # and the padding
        is_known[entity] = False
        # Round by round, all that can be made without it.
        while True:
            results = result[np.all([is_known[column] for column in ingredients], axis=0)]
            is_new = ~is_known[results] & (results != entity)
            if not is_new.any():
                break
            is_known[results[is_new]] = True
        # Without the entity itself, which is not known either.
        lost = number - int(is_known[:-1].sum()) - 1
        if lost:
            losses.append((entity, lost))
    return sorted(losses, key=lambda pair: (-pair[1], pair[0]))


def world_statistics(graph: RecipeGraph, base: Iterable[Entity] | None = None) -> WorldStatistics:
    """Describe the part of a graph that can be made.

    Args:
        graph: the recipe graph. One of more than :data:`MOST_ANALYSED` entities gets no
            bottlenecks, whose cost grows with entities times recipes.
        base: entities known at the start; None for the graph's base.

    Raises:
        UnknownEntityError: if an entity in ``base`` is not in the graph.
    """
    # Read twice below, and an iterator can be read once.
    start = None if base is None else list(base)
    layer = layers(graph, start)
    reachable = int((layer >= 0).sum())
    known_by_round = rounds(layer)
    width = np.diff([0, *known_by_round]).tolist()
    # Unordered pairs, an entity with itself included.
    pairs = reachable * (reachable + 1) // 2
    # The first recipe of each pair: a pair with several results counts once.
    firsts = graph.recipes[graph.pair_starts[:-1], :2]
    combining = int((layer[firsts] >= 0).all(axis=1).sum())
    is_small = graph.num_entities <= MOST_ANALYSED
    losses = bottlenecks(graph, start) if is_small else []
    records = []
    for entity, lost in losses:
        records.append(Bottleneck(graph.entities[entity], lost, int(layer[entity])))
    half = [bottleneck for bottleneck in records if 2 * bottleneck.needed_by >= reachable]
    # Sorted by need before, so that of the last round the one needed by most counts.
    main = max(half or records[:1], key=attrgetter("round"), default=None)
    return WorldStatistics(
        reachable=reachable,
        width=tuple(width),
        success_rate=combining / pairs if pairs else 0.0,
        pairs=pairs,
        bottlenecks=tuple(records),
        main=main,
    )


SHOWN_BOTTLENECKS = 5
"""Most bottlenecks of a world in results."""


def main_statistics(graph: RecipeGraph, base: Sequence[int]) -> WorldStatistics:
    """Return a world's statistics with its main bottleneck first, and a few further ones."""
    statistics = world_statistics(graph, base)
    main = statistics.main
    if main is None:
        return statistics
    further_bottlenecks = [
        bottleneck for bottleneck in statistics.bottlenecks if bottleneck != main
    ]
    return replace(statistics, bottlenecks=(main, *further_bottlenecks[: SHOWN_BOTTLENECKS - 1]))


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
