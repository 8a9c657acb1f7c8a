"""Entities that players discover in open-ended play (crafting without a goal)."""

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from wordcraft_kg.agents.discovery import (
    HUMAN_CURVE,
    HUMAN_SOURCE,
    discovery_curves,
    make_discoverers,
    summarise_curves,
)
from wordcraft_kg.base.records import Count, Hash, Record, Share
from wordcraft_kg.envs.open_ended import Discovery
from wordcraft_kg.evaluation.reference import OpenPlay, ReferenceRow, literature, pack_of
from wordcraft_kg.graphs.recipe_graph import RecipeGraph

if TYPE_CHECKING:
    import pandas as pd

    from wordcraft_kg.models.scorers.scorer import Scorer


class Known(Record):
    """Mean number of known entities after attempts, with 95 % bounds over runs, and the share of repeated pairs."""

    mean: float
    low: float | None
    high: float | None
    repeated: Share


class DiscoveryView(Record, omit_defaults=True):
    """Player results in open-ended play (crafting without a goal).

    Attributes:
        players: number of known entities by player and attempt count (the numbers in ``marks``, as text).
        people: number of entities known to people in a different crafting game, by attempt count.
    """

    graph: str
    hash: Hash
    entities: Count
    base: tuple[str, ...]
    reachable: Count
    attempts: int
    runs: int
    seed: int
    scorer: str | None
    marks: tuple[int, ...]
    players: dict[str, dict[str, Known]]
    people: dict[str, float]
    people_source: str
    references: tuple[ReferenceRow, ...] = ()
    out: str | None = None


def view_discovery(
    graph: RecipeGraph,
    players: Sequence[str],
    *,
    attempts: int = 100,
    runs: int = 100,
    seed: int = 0,
    base: Sequence[str] | None = None,
    scorer: "tuple[str, Scorer] | None" = None,
    progress: Callable[[int, int, dict[str, float]], None] | None = None,
) -> tuple[DiscoveryView, "pd.DataFrame"]:
    """Let players craft without a goal; return the results and all runs' curves.

    ``players`` are names in :data:`~wordcraft_kg.agents.discovery.DISCOVERERS`, ``base`` the labels known at the start
    (default: the graph's base), and ``scorer`` the name and scorer for the player ``empowerment-scorer``.
    """
    start = Discovery(graph, base)
    loaded = None if scorer is None else scorer[1]
    discoverers = make_discoverers(players, graph, loaded)
    curves = discovery_curves(graph, discoverers, attempts, runs, seed, start.base, progress)
    table = summarise_curves(curves)
    view = DiscoveryView(
        graph=graph.name,
        hash=graph.hash,
        entities=graph.num_entities,
        base=graph.labels(start.base),
        reachable=start.reachable,
        attempts=attempts,
        runs=runs,
        seed=seed,
        scorer=None if scorer is None else scorer[0],
        marks=tuple(table["attempt"].unique().tolist()),
        players={name: _known(table[table["player"] == name]) for name in players},
        people={str(attempt): known for attempt, known in HUMAN_CURVE.items()},
        people_source=HUMAN_SOURCE,
        references=_references(graph, graph.labels(start.base), players),
    )
    return view, curves


def _references(graph: RecipeGraph, base: tuple[str, ...], players: Sequence[str]) -> tuple[ReferenceRow, ...]:
    pack = pack_of(graph.hash, None)
    ours = pack.rows_of(OpenPlay(base)) if pack else ()
    others = literature(["entities known", "new combinations"])
    shown = {str(attempt): known for attempt, known in HUMAN_CURVE.items()}
    return (
        *(row for row in ours if row.player not in players),
        *(row for row in others if {at: figure.value for at, figure in row.figures.items()} != shown),
    )


def _known(table: "pd.DataFrame") -> dict[str, Known]:
    columns = (table[name].tolist() for name in ("attempt", "mean", "low", "high", "repeated"))
    # NaN differs from itself.
    return {
        str(attempt): Known(mean, low if low == low else None, high if high == high else None, repeated)
        for attempt, mean, low, high, repeated in zip(*columns, strict=True)
    }
