"""Entities that players discover in open-ended play (crafting without a goal)."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from wordcraft_kg.agents.discovery import (
    HUMAN_CURVE,
    HUMAN_SOURCE,
    LATER_MARKS,
    MARKS,
    make_discoverers,
    play_runs,
)
from wordcraft_kg.base import ConfigError, Count, Hash, Record
from wordcraft_kg.base.statistics import student_interval
from wordcraft_kg.envs.open_ended import Discovery
from wordcraft_kg.graphs import Ids, RecipeGraph

if TYPE_CHECKING:
    from wordcraft_kg.agents.recipe_discovery import RecipeDiscoverer
    from wordcraft_kg.models.recipes.inductive import LabelledScorer


class Guide(NamedTuple):
    """A recipe scorer that guides ``recipe-learner``.

    Attributes:
        name: name of the model folder.
        recipes: the scorer, for the graph's labels.
        shared: number of recipes of the explored graph that the scorer was trained on.
    """

    name: str
    recipes: "LabelledScorer"
    shared: int = 0

    def learner(self) -> "RecipeDiscoverer":
        """Return the player ``recipe-learner``."""
        from wordcraft_kg.agents.recipe_discovery import RecipeDiscoverer

        return RecipeDiscoverer(self.recipes)

    def unit_vectors(self) -> NDArray[np.floating] | None:
        """Return the scorer's word vectors of all labels, shape (E, D); None without words."""
        vectors = self.recipes.scorer.knowledge.vectors
        return vectors[self.recipes.rows].float().cpu().numpy() if vectors.shape[1] else None


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
    from wordcraft_kg.models.scorers.recipes import RecipeScorer
    from wordcraft_kg.models.scorers.scorer_folder import load_scorer

    scorer = load_scorer(folder)
    if not isinstance(whole_of(scorer), RecipeScorer):
        raise ConfigError(f"`scorer` {folder}: expected a model from train-recipes.")
    recipes = for_labels(folder, scorer, graph.entities)
    rows = recipes.rows[graph.recipes]
    # Ingredients in the order of ids of the scorer, as its own recipes have them.
    rows[:, :2].sort(axis=1)
    train_recipes = set(map(tuple, recipes.scorer.recipes.tolist()))
    shared = train_recipes.intersection(map(tuple, rows.tolist()))
    return Guide(Path(folder).name, recipes, len(shared))


class KnownEntities(Record):
    """Number of entities that a player knows after some attempts.

    Attributes:
        mean: mean over runs.
        low, high: 95 % interval over runs; None for a single run.
    """

    mean: float
    low: float | None
    high: float | None


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
        shared_recipes: number of recipes of this graph that a guiding recipe scorer was trained on.
        book: name of the book that guides ``book-votes``; None without one.
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
    shared_recipes: Count = 0
    book: str | None = None


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
) -> DiscoveryView:
    """Let players craft without a goal.

    Args:
        graph: graph to explore.
        players: names of the players, see :data:`~wordcraft_kg.agents.discovery.DISCOVERERS`.
        attempts: attempts of each run.
        runs: number of runs of each player.
        seed: root seed of all random choices.
        base: labels known at the start; None for the graph's base.
        scorer: guide of ``recipe-learner``, and vectors of ``nearest-words``; None without.
        book: recipes that guide ``book-votes``; None without this player.

    Returns:
        The results.

    Raises:
        ConfigError: if a player is unknown or lacks its scorer, a number is out of range, or the
            base makes nothing.
    """
    # Checks the base before any player is prepared.
    start = Discovery(graph, base)
    learner = None if scorer is None else scorer.learner()
    vectors = None if scorer is None else scorer.unit_vectors()
    discoverers = make_discoverers(players, graph, learner, book, vectors)
    curves = play_runs(graph, discoverers, attempts, runs, seed, start.base)
    # The last attempt is always a mark.
    marks = [mark for mark in (*MARKS, *LATER_MARKS) if mark < attempts] + [attempts]
    # Nothing is forgotten: no run knows less than the base.
    within = (float(len(start.base)), math.inf)
    known = {}
    for name, counts in curves.items():
        known[name] = {str(mark): _known(counts[:, mark], within) for mark in marks}
    return DiscoveryView(
        graph=graph.name,
        hash=graph.hash,
        entities=graph.num_entities,
        base=graph.labels(start.base),
        reachable=start.reachable,
        attempts=attempts,
        runs=runs,
        seed=seed,
        scorer=None if scorer is None else scorer.name,
        marks=tuple(marks),
        players=known,
        people={str(attempt): entities for attempt, entities in HUMAN_CURVE.items()},
        people_source=HUMAN_SOURCE,
        shared_recipes=0 if scorer is None else scorer.shared,
        book=None if book is None else book.name,
    )


def _known(counts: Ids, within: tuple[float, float]) -> KnownEntities:
    """Return the mean over runs, shape (runs,), with its interval within possible counts."""
    low, high = student_interval(counts, within=within) or (None, None)
    return KnownEntities(float(counts.mean()), low, high)
