"""Entities that players discover in open-ended play (crafting without a goal)."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import msgspec
import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from wordcraft_kg.agents.discovery import (
    HUMAN_CURVE,
    HUMAN_SOURCE,
    NEVER,
    Plays,
    make_discoverers,
    play_runs,
    summarise_curves,
)
from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.base.records import Count, Hash, Record, Share
from wordcraft_kg.envs.open_ended import Discovery
from wordcraft_kg.evaluation.reference import OpenPlay, ReferenceRow, literature, reference_rows
from wordcraft_kg.graphs.bottlenecks import WorldStatistics, world_statistics
from wordcraft_kg.graphs.recipe_graph import RecipeGraph
from wordcraft_kg.graphs.triples import is_in

if TYPE_CHECKING:
    import pandas as pd

    from wordcraft_kg.models.recipes.inductive import LabelledScorer

SHOWN_BOTTLENECKS = 5
"""Most bottlenecks of a world in results."""
_EVIDENCE = 3  # most recipes that support a choice
ORACLES = ("greedy", "empowerment")
"""Players that know the world; the better one is the measure of all others."""


class Guide(NamedTuple):
    """A recipe scorer that guides ``recipe-learner``.

    Attributes:
        name: name of the model folder.
        recipes: the scorer, for the graph's labels.
        shared: number of recipes of the explored graph that the scorer was trained on.
        contradicted: number of pairs of the graph for which the scorer was trained on other results
            only.
    """

    name: str
    recipes: "LabelledScorer"
    shared: int = 0
    contradicted: int = 0


def open_guide(folder: str | Path, graph: RecipeGraph) -> Guide:
    """Load a model folder of ``train-recipes`` for players on a graph.

    A recipe scorer compares words, so it also guides on graphs that it was not trained on.

    Raises:
        ArtefactError: if the folder is unfinished or damaged, or the word vectors have changed.
        ConfigError: if the model scores triples, not recipes.
        UnknownEntityError: if the graph has labels that a recipe scorer lacks, and the model uses
            no words.
    """
    # Imported late: scripted players need no torch.
    from wordcraft_kg.models.recipes.inductive import for_labels
    from wordcraft_kg.models.scorers.cross_fitting import whole_of
    from wordcraft_kg.models.scorers.folder import load_scorer
    from wordcraft_kg.models.scorers.recipes import RecipeScorer

    scorer = load_scorer(folder)
    if not isinstance(whole_of(scorer), RecipeScorer):
        raise ConfigError(f"`scorer` {folder}: expected a model from train-recipes.")
    recipes = for_labels(folder, scorer, graph.entities)
    world_recipes = recipes.rows[graph.recipes]
    # Ingredients in the order of ids of the scorer, as its own recipes have them.
    world_recipes[:, :2].sort(axis=1)
    train_recipes = recipes.scorer.recipes.numpy()
    is_shared = is_in(world_recipes, train_recipes, len(recipes.scorer.entities))
    train_pairs = {(a, b) for a, b, _ in train_recipes.tolist()}
    pairs = [(a, b) for a, b, _ in world_recipes.tolist()]
    agreeing = {pair for pair, shared in zip(pairs, is_shared.tolist(), strict=True) if shared}
    contradicted = train_pairs.intersection(pairs) - agreeing
    return Guide(Path(folder).name, recipes, int(is_shared.sum()), len(contradicted))


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


class Passage(Record):
    """How often, and when, a player learns an entity that many others need.

    Attributes:
        entity: label of the bottleneck.
        share: share of the runs that learn it.
        attempt: median attempt of these runs; None without any.
    """

    entity: str
    share: Share
    attempt: float | None


class SupportingRecipe(Record):
    """A recipe that the player's scorer was trained on.

    As ``Witness`` of recipe scorers, whose module imports torch: play without a scorer needs none.

    Attributes:
        ingredient_a: label.
        ingredient_b: label.
        result: label.
        weight: similarity to the recipe that the player expected, 1 for equality.
    """

    ingredient_a: str
    ingredient_b: str
    result: str
    weight: Share


class TriedPair(Record):
    """An attempt of a player, and why the player made it.

    Attributes:
        attempt: number of the attempt, from 1.
        ingredient_a: label.
        ingredient_b: label.
        made: labels of the new entities.
        reason: ``random start``, ``cover`` (pairs with an entity in the fewest attempts) or
            ``value`` (the likeliest useful new result).
        chance: probability of a new result, from the attempts before.
        expected: the likeliest result that was not known; None without any.
        share: probability of this result among the candidates.
        evidence: recipes that support the expected result, the most similar first.
    """

    attempt: Count
    ingredient_a: str
    ingredient_b: str
    made: tuple[str, ...]
    reason: str
    chance: Share
    expected: str | None
    share: Share
    evidence: tuple[SupportingRecipe, ...]


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
        shared_recipes: number of recipes of this graph that a guiding recipe scorer was trained on.
        contradicted: number of pairs for which it was trained on other results only.
        book: name of the book that guides ``book-votes``; None without one.
        statistics: sizes and the main bottlenecks of the world.
        passed: for each player, how often and when the runs learn these bottlenecks, in the same
            order.
        tried: the attempts of one run of ``recipe-learner``, with reasons; empty without a page.
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
    shared_recipes: Count = 0
    contradicted: Count = 0
    book: str | None = None
    statistics: WorldStatistics | None = None
    passed: dict[str, tuple[Passage, ...]] = msgspec.field(default_factory=dict)
    tried: tuple[TriedPair, ...] = ()


def view_discovery(
    graph: RecipeGraph,
    players: Sequence[str],
    *,
    attempts: int = 100,
    runs: int = 100,
    seed: int = 0,
    base: Sequence[str] | None = None,
    scorer: Guide | None = None,
    book: RecipeGraph | None = None,
) -> tuple[DiscoveryView, Plays]:
    """Let players craft without a goal.

    Args:
        graph: graph to explore.
        players: names of the players, see :data:`~wordcraft_kg.agents.discovery.DISCOVERERS`.
        attempts: attempts of each run.
        runs: number of runs of each player.
        seed: root seed of all random choices.
        base: labels known at the start; None for the graph's base.
        scorer: guide of ``recipe-learner``; None without this player.
        book: recipes that guide ``book-votes``; None without this player.

    Returns:
        The results, and the runs that they summarise.

    Raises:
        ConfigError: if a player is unknown or lacks its scorer, a number is out of range, or the
            base makes nothing.
    """
    # Checks the base before any player is prepared.
    start = Discovery(graph, base)
    learner = None
    if scorer is not None:
        from wordcraft_kg.agents.recipe_discovery import RecipeDiscoverer

        learner = RecipeDiscoverer(scorer.recipes)
    discoverers = make_discoverers(players, graph, learner, book)
    plays = play_runs(graph, discoverers, attempts, runs, seed, start.base)
    table = summarise_curves(plays.frame())
    statistics = main_statistics(graph, start.base)
    passed = {
        name: passages(graph, statistics, plays.learnt[number])
        for number, name in enumerate(plays.players)
    }
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
        people={str(attempt): entities for attempt, entities in HUMAN_CURVE.items()},
        people_source=HUMAN_SOURCE,
        references=_references(graph, graph.labels(start.base), players),
        knows_recipes=scorer is not None and scorer.shared > 0,
        shared_recipes=0 if scorer is None else scorer.shared,
        contradicted=0 if scorer is None else scorer.contradicted,
        book=None if book is None else book.name,
        statistics=statistics,
        passed=passed if statistics.bottlenecks else {},
    )
    return view, plays


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


def passages(
    graph: RecipeGraph, statistics: WorldStatistics, learnt: NDArray[np.int32]
) -> tuple[Passage, ...]:
    """Return how often and when a player learns each bottleneck.

    Args:
        graph: the world.
        statistics: its bottlenecks.
        learnt: attempt of each entity, shape (..., E), from
            :class:`~wordcraft_kg.agents.discovery.Plays`.
    """
    passage_rows = []
    for bottleneck in statistics.bottlenecks:
        attempts = learnt[..., graph.id_of(bottleneck.entity)].ravel()
        passed = attempts[attempts != NEVER]
        attempt = float(np.median(passed)) if len(passed) else None
        passage_rows.append(Passage(bottleneck.entity, len(passed) / len(attempts), attempt))
    return tuple(passage_rows)


def explain_run(
    graph: RecipeGraph,
    guide: Guide,
    attempts: int = 100,
    seed: int = 0,
    base: Sequence[int] | None = None,
) -> tuple[TriedPair, ...]:
    """Repeat the first run of ``recipe-learner``, and say why each pair was tried.

    Args:
        graph: the graph to explore.
        guide: the recipe scorer.
        attempts: most attempts.
        seed: root seed, as for the run to be repeated.
        base: ids known at the start; None for the graph's base.

    Raises:
        ConfigError: if nothing can be made from the base.
    """
    from wordcraft_kg.agents.recipe_discovery import RecipeDiscoverer

    player = RecipeDiscoverer(guide.recipes)
    scorer = guide.recipes.scorer
    game = Discovery(graph, base)
    player.begin(game.base, np.random.default_rng([seed, 0]))
    tried = []
    for attempt in range(1, attempts + 1):
        pair = player.choose()
        thought = player.thought
        new, _ = game.combine(*pair)
        player.observe(pair, new)
        first_label, second_label = graph.labels(sorted(pair))
        expected = None
        evidence: tuple[SupportingRecipe, ...] = ()
        if thought.expected >= 0:
            expected = scorer.entities[thought.expected]
            # The scorer's labels: its own spelling, where the graph has another.
            rows = guide.recipes.rows[list(pair)].tolist()
            names = [scorer.entities[row] for row in rows]
            witnesses = scorer.supporting_recipes(names[0], names[1], expected, _EVIDENCE)
            evidence = tuple(
                SupportingRecipe(first, second, result, witness.weight)
                for witness in witnesses
                for first, second, result in [witness.recipe]
            )
        tried.append(
            TriedPair(
                attempt=attempt,
                ingredient_a=first_label,
                ingredient_b=second_label,
                made=graph.labels(new),
                reason=thought.reason,
                chance=thought.chance,
                expected=expected,
                share=thought.share,
                evidence=evidence,
            )
        )
        if game.is_complete:
            break
    return tuple(tried)


def _references(
    graph: RecipeGraph, base: tuple[str, ...], players: Sequence[str]
) -> tuple[ReferenceRow, ...]:
    bundled_rows = reference_rows(graph.hash, None, OpenPlay(base))
    published_rows = literature(["entities known", "new combinations"])
    # The people's curve is a part of every view, so the same numbers as a row would stand twice.
    shown = {str(attempt): entities for attempt, entities in HUMAN_CURVE.items()}
    reference_list = [row for row in bundled_rows if row.player not in players]
    for row in published_rows:
        values = {at: figure.value for at, figure in row.figures.items()}
        if values != shown:
            reference_list.append(row)
    return tuple(reference_list)


def _known(table: "pd.DataFrame") -> dict[str, KnownEntities]:
    known_by_attempt = {}
    columns = [table[name].tolist() for name in ("attempt", "mean", "low", "high", "repeated")]
    for attempt, mean, low, high, repeated in zip(*columns, strict=True):
        # A single run has NaN for an interval, and JSON has no NaN.
        has_interval = not math.isnan(low)
        known_by_attempt[str(attempt)] = KnownEntities(
            mean=mean,
            low=low if has_interval else None,
            high=high if has_interval else None,
            repeated=repeated,
        )
    return known_by_attempt
