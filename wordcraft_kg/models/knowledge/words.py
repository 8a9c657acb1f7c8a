"""Word vectors of labels: what a scorer knows of an entity without any recipe.

The page docs/explanation/recipe-scorer.md says how neighbours by words enter the features, and
docs/outside-knowledge.md which vectors there are.
"""

import logging
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from wordcraft_kg.graphs.arrays import Ids
from wordcraft_kg.models.scorers.features import EntityFeatures, make_features
from wordcraft_kg.models.scorers.neighbours.lists import Lists, Numbers, make_lists, nearest_words

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
    return EntityFeatures("one-hot", nothing, is_known, (), (), is_one_hot=True)


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
    missing = int((~vectors.known).sum())
    if missing <= MOST_MISSING * len(labels):
        if missing:
            logging.getLogger(__name__).info(
                "%s of %s labels of all books have no word vector.",
                f"{missing:,}",
                f"{len(labels):,}",
            )
        return vectors
    return word_features(features, labels, allow_missing=allow_missing)
