"""Other books: their recipes without those that both books share, and word vectors for all labels.

Word vectors are all that a scorer knows of an entity without any recipe. The page
docs/explanation/recipe-scorer.md says how neighbours by words enter the features, and
docs/outside-knowledge.md which vectors there are.

Recipes that both books share are left out of the other book: a train recipe is in the train part
already, and a test recipe must not be learned. So a held-out train recipe finds as little of itself
in the other book as a test recipe does. The page docs/explanation/leaks.md says what this covers.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import count
from typing import Literal, NamedTuple

import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from wordcraft_kg.base import ConfigError, Count, Hash, RecipeFileError, Record, Share
from wordcraft_kg.base.labels import LabelIndex
from wordcraft_kg.graphs import (
    Ids,
    OpenedGraph,
    RecipeGraph,
    is_in,
    open_graph,
)
from wordcraft_kg.models.scorers.features import EntityFeatures, make_features
from wordcraft_kg.models.scorers.neighbours.lists import (
    Lists,
    Numbers,
    make_lists,
    nearest_words,
    ordered_recipes,
)
from wordcraft_kg.models.scorers.score_limits import fitting_workers

_DIM = 384
"""Length of a word vector, about, to say before the start how much memory another book takes."""
REWORDED = 0.7
"""Cosine of word vectors from which a recipe of another book rewords a test recipe, for each of the
three words."""

MOST_MISSING = 0.5
"""Largest share of labels without a word vector, over a graph and other books together."""


@dataclass(frozen=True, eq=False)
class Words:
    """What all fits share: word vectors and the nearest words.

    Attributes:
        vectors: shape (E, D), half: unit vectors as stored in a model; D is 0 without words.
        near: shape (E, K_w), from
            :func:`~wordcraft_kg.models.scorers.neighbours.lists.nearest_words`.
    """

    vectors: NDArray[np.float16]
    near: Numbers

    @classmethod
    def of(cls, features: EntityFeatures) -> "Words":
        """Round unit vectors as a model stores them, and find the nearest words."""
        rounded = features.unit_vectors.astype(np.float16)
        return cls(rounded, nearest_words(rounded.astype(np.float32)))

    def lists(self, recipes: Ids) -> Lists:
        """Return the lists of recipes, ids (n, 3)."""
        return make_lists(recipes, self.vectors.astype(np.float32), self.near)


def word_features(
    spec: str,
    labels: Sequence[str],
    *,
    allow_missing: bool = False,
) -> EntityFeatures:
    """Return the word vectors of labels, of length 0 for one-hot.

    One-hot vectors are no words: E x E numbers would say nothing, at the cost of all pairs.

    Args:
        spec: word vectors, as for :func:`~wordcraft_kg.models.scorers.features.make_features`.
        labels: the E labels.
        allow_missing: use zeros for labels without a vector.

    Raises:
        ConfigError: if the vectors do not fit the labels.
        ArtefactError: for a folder of vectors that is damaged, or was not written by ``encode``.
    """
    if spec != "one-hot":
        return make_features(spec, labels, allow_missing=allow_missing)
    nothing = np.zeros((len(labels), 0), dtype=np.float32)
    is_known = np.ones(len(labels), dtype=bool)
    return EntityFeatures("one-hot", nothing, is_known, (), is_one_hot=True)


def words_of_books(
    features: str,
    labels: Sequence[str],
    *,
    allow_missing: bool = False,
) -> EntityFeatures:
    """Return word vectors for the labels of a graph and of other books.

    A large book has names and numbers that no vectors know. They may be more than in the graph
    itself: the book's other entities still help.

    Args:
        features: word vectors.
        labels: all labels.
        allow_missing: use zeros for any number of labels without a vector.

    Raises:
        ConfigError: if most labels have no vector, and ``allow_missing`` is False.
    """
    vectors = word_features(features, labels, allow_missing=True)
    if (~vectors.known).sum() <= MOST_MISSING * len(labels):
        return vectors
    return word_features(features, labels, allow_missing=allow_missing)


class OutsideSource(Record, frozen=True, kw_only=True):
    """A source of outside knowledge in a trained model.

    Attributes:
        name: the source's display name.
        kind: ``tables`` of a knowledge folder, or another ``book``.
        sha256: hash of the tables or the other graph.
        coverage: share of the graph's entities that the source describes.
        recipes: recipes of another book that are used.
        left_out: recipes of another book that are also recipes of this graph, and not used.
        left_out_test: those among them that are test or validation recipes of this split.
        reworded: used recipes that reword a test or validation recipe by near-synonyms.
        makes: labels of the graph's entities that a used recipe of another book makes.
    """

    name: str
    kind: Literal["tables", "book"]
    sha256: Hash
    coverage: Share
    recipes: Count = 0
    left_out: Count = 0
    left_out_test: Count = 0
    reworded: Count = 0
    makes: tuple[str, ...] = ()


class OtherBook(NamedTuple):
    """Another book's recipes, without the recipes that both books share.

    Attributes:
        labels: the graph's E labels, then those of the book alone.
        recipes: ids by ``labels``, shape (n, 3).
        source: record of the book.
    """

    labels: tuple[str, ...]
    recipes: Ids
    source: OutsideSource


def open_other_book(
    spec: str,
    opened: OpenedGraph,
    *,
    keep_train: bool = False,
) -> OtherBook:
    """Open another book's recipes without the recipes that both books share.

    Labels that differ in case, article or plural are one entity. Rewordings are not counted yet,
    see :func:`with_words_of`.

    Args:
        spec: a book or a graph folder.
        opened: the graph; its split says which shared recipes are test recipes.
        keep_train: keep shared recipes of the train part.

    Raises:
        ConfigError: if the source is no book, is the graph itself, has no other recipes, or memory
            does not suffice.
        ArtefactError: if a graph folder is incomplete or damaged.
    """
    graph = opened.graph
    try:
        book = open_graph(spec).graph
    except RecipeFileError as error:
        raise ConfigError(
            f"`with` '{spec}': expected a knowledge folder, a graph folder or a book. {error}"
        ) from None
    if book.hash == graph.hash:
        raise ConfigError(f"`with` '{spec}' is the graph itself. Give another book.")
    ids = ids_among(graph.entities, book.entities)
    is_new = ids >= graph.num_entities
    labels = (*graph.entities, *book.labels(np.flatnonzero(is_new)))
    size = len(labels)
    fitting_workers(size, book.num_recipes, _DIM, most=1)
    # Labels of a book that are one entity in another make two recipes equal.
    recipes = ordered_recipes(ids[book.recipes])
    held_out = graph.recipes[~opened.split.is_in("train")]
    is_shared = is_in(recipes, held_out if keep_train else graph.recipes, size)
    used_recipes = recipes[~is_shared]
    if not len(used_recipes):
        raise ConfigError(
            f"`with` '{spec}': all {len(recipes):,} recipes are recipes of the graph. Give another "
            "book."
        )
    results = np.unique(used_recipes[:, 2])
    source = OutsideSource(
        name=book.name,
        kind="book",
        sha256=book.hash,
        coverage=len(np.unique(ids[~is_new])) / max(graph.num_entities, 1),
        recipes=len(used_recipes),
        left_out=int(is_shared.sum()),
        left_out_test=int(is_in(recipes, held_out, size).sum()),
        makes=tuple(graph.labels(results[results < graph.num_entities])),
    )
    return OtherBook(labels, used_recipes, source)


def ids_among(entities: Sequence[str], labels: Sequence[str]) -> Ids:
    """Return the place of each label among entities; labels that they lack have the ids from E on.

    Labels that differ in case, article or plural are one entity.
    """
    index = LabelIndex(entities)
    next_ids = count(len(entities))
    places = [index.find(label) for label in labels]
    ids = [next(next_ids) if place is None else place for place in places]
    return np.array(ids, dtype=np.int64)


def shared_recipes(graph: RecipeGraph, book: RecipeGraph) -> NDArray[np.bool_]:
    """Mark a graph's recipes that a book has, shape (num_recipes,).

    Labels are compared as in :func:`open_other_book`.
    """
    # A graph may have half-sorted recipes, whose rows stay in the graph's order.
    rows = graph.recipes.copy()
    rows[:, :2].sort(axis=1)
    ids = ids_among(graph.entities, book.entities)
    size = graph.num_entities + book.num_entities
    return is_in(rows, ordered_recipes(ids[book.recipes]), size)


def with_words_of(
    book: OtherBook,
    opened: OpenedGraph,
    features: str,
    *,
    allow_missing: bool = False,
) -> tuple[OtherBook, EntityFeatures]:
    """Return the book with its rewordings counted, and word vectors for all labels.

    Args:
        book: from :func:`open_other_book`.
        opened: the graph with its split.
        features: word vectors.
        allow_missing: use zeros for labels without a vector.

    Raises:
        ConfigError: if most labels have no vector, and ``allow_missing`` is False.
    """
    vectors = words_of_books(features, book.labels, allow_missing=allow_missing)
    held_out = opened.graph.recipes[~opened.split.is_in("train")]
    reworded = _reworded(book.recipes, held_out, vectors)
    return book._replace(source=replace(book.source, reworded=reworded)), vectors


def _reworded(recipes: Ids, held_out: Ids, features: EntityFeatures) -> int:
    """Count recipes that equal a held-out recipe up to near-synonyms.

    Args:
        recipes: ids, shape (n, 3); ingredients may have either order.
        held_out: ids, shape (m, 3).
        features: word vectors of all entities.
    """
    entities = np.unique(held_out)
    # Rows of the held-out entities alone: all pairs of a large book would take gigabytes.
    alike = features.unit_vectors[entities] @ features.unit_vectors.T >= REWORDED
    # An entity without a vector equals itself, too.
    alike[np.arange(len(entities)), entities] = True
    is_reworded = np.zeros(len(recipes), dtype=bool)
    ingredients_a, ingredients_b, results = recipes.T
    # Rows of `alike` for the entities of each held-out recipe.
    rows = np.searchsorted(entities, held_out)
    for a, b, result in rows.tolist():
        in_order = alike[a, ingredients_a] & alike[b, ingredients_b]
        reversed_order = alike[a, ingredients_b] & alike[b, ingredients_a]
        is_reworded |= (in_order | reversed_order) & alike[result, results]
    return int(is_reworded.sum())


def recipes_together(books: Sequence[OtherBook], labels: Iterable[str]) -> Ids:
    """Return the different recipes of several books.

    Args:
        books: the books.
        labels: all their labels, whose places are the ids of the result.

    Returns:
        shape (n, 3), the smaller ingredient first.
    """
    place = {label: row for row, label in enumerate(labels)}
    rows = []
    for book in books:
        ids = np.array([place[label] for label in book.labels])
        rows.append(ids[book.recipes])
    return ordered_recipes(np.concatenate(rows))
