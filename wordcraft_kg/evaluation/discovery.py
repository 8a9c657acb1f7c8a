"""Entities that players discover in open-ended play (crafting without a goal)."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

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
from wordcraft_kg.graphs.triples import is_in

if TYPE_CHECKING:
    import pandas as pd

    from wordcraft_kg.models.recipes.inductive import LabelledScorer
    from wordcraft_kg.models.scorers.scorer import Scorer


class Guides(NamedTuple):
    """A model folder's scorers, which guide players in open-ended play.

    Attributes:
        name: name of the folder.
        links: scorer of the graph's triples; None if the folder's scorer belongs to another graph.
        recipes: scorer of recipes for the graph's labels; None if the folder scores triples only.
        knows_recipes: whether the scorer has seen recipes of the explored graph in training.
    """

    name: str
    links: "Scorer | None"
    recipes: "LabelledScorer | None"
    knows_recipes: bool

    @property
    def players(self) -> tuple[str, ...]:
        """Names of the players that this knowledge guides."""
        names = []
        if self.links is not None:
            names.append("empowerment-scorer")
        if self.recipes is not None:
            names.append("recipe-learner")
        return tuple(names)


def open_guides(folder: str | Path, graph: RecipeGraph) -> Guides:
    """Load a model folder for players on a graph.

    A recipe scorer compares words, so it also guides on graphs that it was not trained on.

    Raises:
        GraphMismatchError: if a scorer of triples belongs to another graph.
    """
    # Imported late: scripted players need no torch.
    from wordcraft_kg.models.recipes.inductive import for_labels
    from wordcraft_kg.models.scorers.cross_fitting import whole_of
    from wordcraft_kg.models.scorers.folder import load_scorer
    from wordcraft_kg.models.scorers.protocol import check_scorer
    from wordcraft_kg.models.scorers.recipes import RecipeScorer

    scorer = load_scorer(folder)
    # Scores of triples are bound to the ids of one graph; recipe scores compare words.
    if not isinstance(whole_of(scorer), RecipeScorer):
        check_scorer(scorer, graph)
        return Guides(Path(folder).name, scorer, None, knows_recipes=True)
    links = scorer if scorer.graph_hash == graph.hash else None
    recipes = for_labels(folder, scorer, graph.entities)
    own = recipes.rows[graph.recipes]
    # Ingredients in the order of ids of the scorer, as its own recipes have them.
    own[:, :2].sort(axis=1)
    known = is_in(own, recipes.scorer.recipes.numpy(), len(recipes.scorer.entities))
    return Guides(Path(folder).name, links, recipes, bool(known.any()))


class KnownEntities(Record):
    """Number of entities that a player knows after some attempts.

    Attributes:
        mean: mean over runs.
        low, high: 95 % interval over runs; None for a single run.
        repeated: share of the attempts so far that repeated a pair.
    """

    mean: float
    low: float | None
    high: float | None
    repeated: Share


class DiscoveryView(Record, omit_defaults=True):
    """Results of open-ended play, crafting without a goal.

    Attributes:
        graph: name of the explored graph.
        hash: content hash of the graph.
        entities: number of entities.
        base: labels known at the start.
        reachable: number of entities that can be made from the base.
        attempts: attempts of each run.
        runs: number of runs of each player.
        seed: root seed of all random choices.
        scorer: name of the model folder that guides players; None without one.
        marks: attempt counts with reported results.
        players: known entities by player and attempt count.
        people: entities that people know in another game, by attempt count.
        people_source: publication of these numbers.
        references: published results from the same base and the literature, of players that are not
            in `players`.
        out: the written page; None without a page.
        knows_recipes: whether the guiding scorer has seen recipes of this graph in training.
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
    players: dict[str, dict[str, KnownEntities]]
    people: dict[str, float]
    people_source: str
    references: tuple[ReferenceRow, ...] = ()
    out: str | None = None
    knows_recipes: bool = False


def view_discovery(
    graph: RecipeGraph,
    players: Sequence[str],
    *,
    attempts: int = 100,
    runs: int = 100,
    seed: int = 0,
    base: Sequence[str] | None = None,
    scorer: Guides | None = None,
) -> tuple[DiscoveryView, "pd.DataFrame"]:
    """Let players craft without a goal.

    Args:
        graph: graph to explore.
        players: names of the players, see :data:`~wordcraft_kg.agents.discovery.DISCOVERERS`.
        attempts: attempts of each run.
        runs: number of runs of each player.
        seed: root seed of all random choices.
        base: labels known at the start; None for the graph's base.
        scorer: scorers that guide players; None if no player needs any.

    Returns:
        The results, and the curves that they summarise.

    Raises:
        ConfigError: if a player is unknown or lacks its scorer, or if the base makes nothing.
    """
    # Checks the base before any player is prepared.
    start = Discovery(graph, base)
    learner = None
    if scorer is not None and scorer.recipes is not None:
        from wordcraft_kg.agents.recipe_discovery import RecipeDiscoverer

        learner = RecipeDiscoverer(scorer.recipes)
    discoverers = make_discoverers(
        players, graph, None if scorer is None else scorer.links, learner
    )
    curves = discovery_curves(graph, discoverers, attempts, runs, seed, start.base)
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
        scorer=None if scorer is None else scorer.name,
        marks=tuple(table["attempt"].unique().tolist()),
        players={name: _known(table[table["player"] == name]) for name in players},
        people={str(attempt): known for attempt, known in HUMAN_CURVE.items()},
        people_source=HUMAN_SOURCE,
        references=_references(graph, graph.labels(start.base), players),
        knows_recipes=scorer is not None and scorer.knows_recipes,
    )
    return view, curves


def _references(
    graph: RecipeGraph, base: tuple[str, ...], players: Sequence[str]
) -> tuple[ReferenceRow, ...]:
    pack = pack_of(graph.hash, None)
    ours = pack.rows_of(OpenPlay(base)) if pack else ()
    others = literature(["entities known", "new combinations"])
    # The people's curve is a part of every view, so the same numbers as a row would stand twice.
    shown = {str(attempt): known for attempt, known in HUMAN_CURVE.items()}
    further = [row for row in ours if row.player not in players]
    for row in others:
        values = {at: figure.value for at, figure in row.figures.items()}
        if values != shown:
            further.append(row)
    return tuple(further)


def _known(table: "pd.DataFrame") -> dict[str, KnownEntities]:
    known = {}
    columns = [table[name].tolist() for name in ("attempt", "mean", "low", "high", "repeated")]
    for attempt, mean, low, high, repeated in zip(*columns, strict=True):
        # A single run has NaN for an interval, and JSON has no NaN.
        has_interval = not math.isnan(low)
        known[str(attempt)] = KnownEntities(
            mean=mean,
            low=low if has_interval else None,
            high=high if has_interval else None,
            repeated=repeated,
        )
    return known
