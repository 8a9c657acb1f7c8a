"""Players for the open-ended environment, and discovery curves: known entities by attempt."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from wordcraft_kg.base import MAX_SIZE, ConfigError, check_memory, one_of, steps, whole
from wordcraft_kg.base.labels import LabelIndex
from wordcraft_kg.envs.open_ended import Discovery
from wordcraft_kg.graphs import Entity, Ids, RecipeGraph

Pair = tuple[int, int]
Floats = NDArray[np.floating]

HUMAN_CURVE = {1: 5.0, 10: 9.95, 20: 14.05, 50: 23.47, 100: 35.96, 200: 55.0, 300: 74.0, 500: 110.0}
"""Mean number of entities known after n attempts at Little Alchemy 2.

It has 720 entities, 4 at the start. The mean is over people who are still playing: 9 % of them
after 500 attempts, the most persistent.
"""
HUMAN_SOURCE = (
    "12,100 players of Little Alchemy 2 (720 entities, 4 at the start), those still playing; "
    "Brändle et al. 2023"
)
"""Source for the curve: "Empowerment contributes to exploration behaviour in a creative video
game", Nature Human Behaviour 7, 1481-1489."""

MARKS = (1, 10, 20, 50, 100)
"""Numbers of attempts at which a summary reports known entities."""
LATER_MARKS = (200, 300, 400, 500)
"""Further numbers of attempts for long runs."""


class Discoverer(ABC):
    """Base class of open-ended players.

    A player has the known ids in discovery order, and the run's random generator.
    """

    def begin(self, base: Sequence[int], rng: np.random.Generator) -> None:
        """Start a run with the known ids ``base``."""
        self.known: list[int] = []
        self.rng = rng
        for entity in base:
            self.learn(entity)

    def observe(self, pair: Pair, new: Sequence[int]) -> None:
        """Process the new entities (ids) that the chosen pair made."""
        for entity in new:
            self.learn(entity)

    def learn(self, entity: int) -> None:
        """Process an entity (id) that has become known."""
        self.known.append(entity)

    @abstractmethod
    def choose(self) -> Pair:
        """Return the next pair of known ids to combine.

        It is called only while a pair of known entities makes an unknown one, so a player never has
        to answer that nothing is left.
        """

    def draw_best(self, values: Floats) -> int:
        """Return the index of the highest value; equal values are drawn at random."""
        best = np.flatnonzero(values == values.max())
        return int(best[self.rng.integers(len(best))])


class RandomDiscoverer(Discoverer):
    """A player that samples both entities uniformly; a pair may repeat.

    The chance of the frozen benchmark's open-ended tracks.
    """

    def choose(self) -> Pair:  # noqa: D102
        first, second = self.rng.integers(len(self.known), size=2).tolist()
        return self.known[first], self.known[second]


class NoRepeatDiscoverer(RandomDiscoverer):
    """A player that samples uniformly among untried pairs."""

    def begin(self, base: Sequence[int], rng: np.random.Generator) -> None:  # noqa: D102
        super().begin(base, rng)
        self._tried: set[Pair] = set()

    def choose(self) -> Pair:  # noqa: D102
        # Terminates: after all known pairs, everything reachable is known and the run is over.
        while True:
            pair = super().choose()
            if (min(pair), max(pair)) not in self._tried:
                return pair

    def observe(self, pair: Pair, new: Sequence[int]) -> None:  # noqa: D102
        super().observe(pair, new)
        self._tried.add((min(pair), max(pair)))


class BestPairDiscoverer(Discoverer):
    """Base class of players of the untried pair with the highest value.

    Pairs are numbered as they become possible: each new entity with all known ones, in the order of
    discovery, and last with itself.

    Attributes:
        pairs: ids of the P pairs of known entities, shape (P, 2).
        is_tried: shape (P,), bool.
        chosen: number of the last chosen pair.
    """

    def begin(self, base: Sequence[int], rng: np.random.Generator) -> None:  # noqa: D102
        self.pairs = np.empty((0, 2), dtype=np.int64)
        self.is_tried = np.empty(0, dtype=bool)
        super().begin(base, rng)

    def learn(self, entity: int) -> None:  # noqa: D102
        super().learn(entity)
        partners = np.array(self.known)
        new_pairs = np.column_stack([np.full_like(partners, entity), partners])
        self.pairs = np.concatenate([self.pairs, new_pairs])
        self.is_tried = np.pad(self.is_tried, (0, len(partners)))

    @abstractmethod
    def values(self, untried: Ids) -> Floats:
        """Return the values of pairs by their numbers, shape (n,) -> (n,)."""

    def choose(self) -> Pair:
        """Return the untried pair with the highest value; equal values are drawn at random."""
        untried = np.flatnonzero(~self.is_tried)
        self.chosen = int(untried[self.draw_best(self.values(untried))])
        self.is_tried[self.chosen] = True
        first, second = self.pairs[self.chosen].tolist()
        return first, second


class WordsDiscoverer(BestPairDiscoverer):
    """A player of the untried pair with the most similar labels by word cosine; learns nothing."""

    def __init__(self, unit_vectors: Floats):
        """Take the unit vectors of all labels, shape (E, D).

        Labels without a word vector have cosine 0 with others.
        """
        self._unit = unit_vectors

    def begin(self, base: Sequence[int], rng: np.random.Generator) -> None:  # noqa: D102
        self._cosines = np.empty(0)
        super().begin(base, rng)

    def learn(self, entity: int) -> None:  # noqa: D102
        super().learn(entity)
        cosines = self._unit[self.known] @ self._unit[entity]
        # Also for a label without a word vector, whose cosine with itself is 0.
        cosines[-1] = 1.0
        self._cosines = np.concatenate([self._cosines, cosines])

    def values(self, untried: Ids) -> Floats:  # noqa: D102
        return self._cosines[untried]


class GreedyDiscoverer(Discoverer):
    """A player that knows all recipes: the measure of all others.

    It chooses the pair with the highest summed worth of new results: an entity's worth is 1 + the
    number of recipes with the entity as an ingredient.
    """

    def __init__(self, graph: RecipeGraph):
        """Take the graph to explore."""
        self.graph = graph
        self._worth = 1.0 + graph.use_counts

    def begin(self, base: Sequence[int], rng: np.random.Generator) -> None:  # noqa: D102
        self.is_known = np.zeros(self.graph.num_entities, dtype=bool)
        # Recipes with known ingredients, kept because a large book has a million recipes.
        self._open = np.empty(0, dtype=np.int64)
        # Rows of recipes with an ingredient learnt since the last choice, an array per entity.
        self._pending: list[Ids] = []
        super().begin(base, rng)

    def learn(self, entity: int) -> None:  # noqa: D102
        super().learn(entity)
        self.is_known[entity] = True
        self._pending.append(self.graph.uses_of(entity))

    def choose(self) -> Pair:
        """Return the pair with the highest gain; equal gains are drawn at random.

        The gain of a pair is the summed worth of the unknown entities that it makes. Some pair has
        one, see :meth:`Discoverer.choose`.

        Returns:
            The ids of both ingredients, in the order of the recipe.
        """
        graph = self.graph
        # A pair may make thousands of entities: their recipes are merged once, not one by one.
        if self._pending:
            uses = np.concatenate(self._pending)
            # Each recipe with one of its ingredients new: open only if the other is known, too.
            is_open = self.is_known[graph.recipes[uses, :2]].all(axis=1)
            self._open = np.union1d(self._open, uses[is_open])
            self._pending = []
        # A recipe whose result has become known gains nothing any more.
        is_made = self.is_known[graph.recipes[self._open, 2]]
        self._open = self._open[~is_made]
        pairs, index = np.unique(graph.pair_of_recipe[self._open], return_inverse=True)
        # A pair with several results makes all of them, so their worths add up.
        result_values = self._worth[graph.recipes[self._open, 2]]
        gains = np.bincount(index, result_values).astype(np.float64)
        best = pairs[self.draw_best(gains)]
        first, second, _ = graph.recipes[graph.pair_starts[best]].tolist()
        return first, second


class BookDiscoverer(BestPairDiscoverer):
    """A player that knows another book's recipes by label, and counts votes; learns nothing.

    ``n_xc`` is the number of the book's recipes that make c from x, and ``m_c`` the number that
    make c. The player tries the untried pair with the largest

    ``value(a, b) = sum_c [c not known] (recorded(a, b, c) + n_ac n_bc / (1 + m_c)^2)``.

    ``recorded`` is 1 if the book has the recipe a + b -> c. The second term is below 1, so recorded
    recipes for something new come first. Labels outside the book have no votes.
    """

    def __init__(self, graph: RecipeGraph, book: RecipeGraph):
        """Count the votes of ``book`` for the labels of ``graph``."""
        index = LabelIndex(book.entities)
        rows = [index.find(label) for label in graph.entities]
        # -1 for labels outside the book.
        self._rows = np.array([-1 if row is None else row for row in rows])
        self._book = book
        self._made = 1.0 + book.recipe_counts

    def begin(self, base: Sequence[int], rng: np.random.Generator) -> None:  # noqa: D102
        # One row of votes for each known entity.
        self._votes = np.zeros((0, self._book.num_entities))
        self._is_new = np.ones(self._book.num_entities, dtype=bool)
        super().begin(base, rng)

    def learn(self, entity: int) -> None:  # noqa: D102
        super().learn(entity)
        row = int(self._rows[entity])
        votes = np.zeros(self._book.num_entities)
        if row >= 0:
            self._is_new[row] = False
            np.add.at(votes, self._book.recipes[self._book.uses_of(row), 2], 1)
        self._votes = np.vstack([self._votes, votes / self._made])
        # Values change with what is known alone, so the next choice computes them.
        self._values: Floats | None = None

    def values(self, untried: Ids) -> Floats:  # noqa: D102
        if self._values is None:
            # Of all P pairs of K known entities.
            votes = self._votes * self._is_new
            values = votes @ votes.T
            # An entity with itself has one voter, not two.
            np.fill_diagonal(values, 0)
            # Places among the known entities by row of the book; -1 for entities that are not
            # known.
            places = np.full(self._book.num_entities, -1)
            rows = self._rows[self.known]
            places[rows[rows >= 0]] = np.flatnonzero(rows >= 0)
            recipes = self._book.recipes[self._is_new[self._book.recipes[:, 2]]]
            pairs = np.sort(places[recipes[:, :2]], axis=1)
            seconds, firsts = pairs[pairs[:, 0] >= 0].T
            np.add.at(values, (firsts, seconds), 1)
            # Below the diagonal of the table (K, K) each pair stands once, in the order of numbers.
            self._values = values[np.tril_indices(len(values))]
        return self._values[untried]


DISCOVERERS = {
    "random-no-repeat": "any untried pair",
    "nearest-words": "untried pair with the most similar labels",
    "greedy": "knows the graph: results with the most uses",
    "recipe-learner": (
        "guided by a recipe scorer of any book: likely and useful new results; "
        "learns from its attempts"
    ),
    "book-votes": (
        "guided by another book: its recipes that make something new, then pairs whose ingredients "
        "have made the same things"
    ),
}
"""Short descriptions of the players, by name."""
_NEEDS = {
    "recipe-learner": (
        "`scorer` from `wordcraft-kg train-recipes`, of any book: a trained model folder"
    ),
    "book-votes": "`book`: a book whose recipes it knows",
}
GUIDED = tuple(_NEEDS)
"""Players that need a trained model or another book."""


def make_discoverers(
    names: Iterable[str],
    graph: RecipeGraph,
    learner: Discoverer | None = None,
    book: RecipeGraph | None = None,
    unit_vectors: Floats | None = None,
) -> dict[str, Discoverer]:
    """Make players for open-ended play.

    Args:
        names: names in :data:`DISCOVERERS`.
        graph: the graph to explore.
        learner: the player ``recipe-learner``; None without it.
        book: recipes that guide ``book-votes``; None without this player.
        unit_vectors: word vectors of ``nearest-words``, shape (E, D); None for GloVe's.

    Returns:
        The players by name, in the order of ``names``.

    Raises:
        ConfigError: for an unknown name, or a missing scorer or book.
    """
    makers: dict[str, Callable[[], Discoverer]] = {
        "random-no-repeat": NoRepeatDiscoverer,
        "nearest-words": lambda: WordsDiscoverer(
            _glove(graph) if unit_vectors is None else unit_vectors
        ),
        "greedy": lambda: GreedyDiscoverer(graph),
    }
    if learner is not None:
        makers["recipe-learner"] = lambda: learner
    if book is not None:
        makers["book-votes"] = lambda: BookDiscoverer(graph, book)
    players = {}
    for name in names:
        one_of("players", name, tuple(DISCOVERERS))
        if name not in makers:
            raise ConfigError(f"player '{name}' needs a {_NEEDS[name]}.")
        players[name] = makers[name]()
    return players


def _glove(graph: RecipeGraph) -> Floats:
    """Return GloVe vectors of all labels, shape (E, D)."""
    from wordcraft_kg.models.scorers.features import glove_features

    return glove_features(graph.entities).unit_vectors


def play_runs(
    graph: RecipeGraph,
    players: Mapping[str, Discoverer],
    attempts: int = 100,
    runs: int = 100,
    seed: int = 0,
    base: Iterable[Entity] | None = None,
) -> dict[str, NDArray[np.int64]]:
    """Let players discover entities, and count the known entities.

    Rules are as in ``WordCraft-OpenEnded-v0``, but without observations. Run ``i`` uses
    ``np.random.default_rng([seed, i])``, so results do not depend on the choice of players. A run
    stops when all reachable entities are known; its further attempts keep the last count.

    Args:
        graph: the graph to explore.
        players: players by name.
        attempts: attempts of each run.
        runs: number of runs of each player.
        seed: root seed of all random choices.
        base: entities known at the start; None for the graph's base.

    Returns:
        The curves of each player by name: number of known entities after each attempt, 0 (the base)
        first, shape (runs, attempts + 1).

    Raises:
        ConfigError: for numbers out of range, or a base with an unknown entity or from which
            nothing can be made.
    """
    whole("attempts", attempts, 1, MAX_SIZE)
    whole("runs", runs, 1, MAX_SIZE)
    whole("seed", seed, 0)
    num_bytes = 8 * len(players) * runs * (attempts + 1)
    check_memory("runs", runs, f"their curves of {attempts:,} attempts", num_bytes)
    game = Discovery(graph, base)
    curves = {}
    for name, player in players.items():
        known_counts = np.zeros((runs, attempts + 1), dtype=np.int64)
        for run in steps(f"playing {name}", range(runs)):
            game.restart()
            player.begin(game.base, np.random.default_rng([seed, run]))
            known_counts[run] = len(game.base)
            for attempt in range(1, attempts + 1):
                pair = player.choose()
                new, _ = game.combine(*pair)
                player.observe(pair, new)
                # To the end, so that a run that stops early keeps its count.
                known_counts[run, attempt:] = len(game.known)
                if game.is_complete:
                    break
        curves[name] = known_counts
    return curves
