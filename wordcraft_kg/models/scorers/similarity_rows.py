"""The similarity of entities by rows and by products, for graphs whose matrix of all pairs would be too large."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.graphs.arrays import Ids
from wordcraft_kg.models.scorers.similarity import TEXT, profiles

CELLS = 2**24
"""Most similarities that are held at once, 4 bytes each, with a few copies."""


@dataclass(frozen=True)
class SimilarityRows:
    """The kernel of :func:`~wordcraft_kg.models.scorers.similarity.similarity`, of which only what is needed exists.

    Attributes:
        shared: what recipes do with two or more entities, sparse, shape (E, M): columns of the profiles.
        own: squared length of what they do with one entity alone, shape (E,). Most contexts are of this kind, and they
            make an entity like itself only.
        words: unit vectors of the words, shape (E, D), zeros where there are none; D is 0 without vectors.
    """

    shared: Any
    own: Tensor
    words: Tensor

    @classmethod
    def of(cls, recipes: Ids, num_entities: int, vectors: NDArray[np.floating] | None = None) -> "SimilarityRows":
        """Return the similarity from recipes, shape (n, 3), and word vectors, shape (E, D), if there are any.

        Raises:
            ConfigError: if the vectors are not of the entities.
        """
        check_vectors(vectors, num_entities)
        known = profiles(recipes, num_entities)
        is_shared = np.bincount(known.indices, minlength=known.shape[1]) > 1
        alone = known[:, np.flatnonzero(~is_shared)]
        own = np.asarray(alone.multiply(alone).sum(axis=1)).astype(np.float32)
        words = torch.zeros(num_entities, 0) if vectors is None else torch.tensor(vectors, dtype=torch.float32)
        shared = known[:, np.flatnonzero(is_shared)].astype(np.float32).tocsr()
        return cls(shared, torch.from_numpy(own), torch.nn.functional.normalize(words, dim=1))

    def __len__(self) -> int:
        return len(self.own)

    @cached_property
    def columns(self) -> Any:
        """``shared`` transposed, by rows."""
        return self.shared.T.tocsr()

    @cached_property
    def diagonal(self) -> Tensor:
        """The similarity of each entity with itself, shape (E,)."""
        structure = np.asarray(self.shared.multiply(self.shared).sum(axis=1))
        return torch.from_numpy(structure) + self.own + TEXT * (self.words**2).sum(1) ** 2

    def blocks(self) -> Iterator[Tensor]:
        """Yield the ids of all entities in blocks whose rows may be held at once."""
        yield from torch.arange(len(self)).split(max(1, CELLS // max(len(self), 1)))

    def rows(self, ids: Tensor) -> Tensor:
        """Return the similarities of some entities with all, shape (n, E)."""
        found = torch.from_numpy((self.shared[ids.numpy()] @ self.columns).toarray())
        found[torch.arange(len(ids)), ids] += self.own[ids]
        return found + self._by_words(ids) if self.words.shape[1] else found

    def normalised_rows(self, ids: Tensor) -> Tensor:
        """Return ``k(x, y) / √(k(x, x) k(y, y))`` of some entities x with all y, shape (n, E)."""
        scale = self.diagonal.clamp(min=1e-9).rsqrt()
        return scale[ids, None] * self.rows(ids) * scale

    def times(self, block: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the kernel times a block of vectors, shape (E, m), without the kernel.

        Here a negative cosine of words counts like a positive one: conjugate gradients need a positive semi-definite
        kernel, and squares of cosines are one, but not those of positive cosines alone. Neither ranks better.
        """
        product = self.shared @ (self.columns @ block) + self.own.numpy()[:, None] * block
        if self._word_pairs is not None:
            product += TEXT * (self._word_pairs @ (self._word_pairs.T @ block))
        elif self.words.shape[1]:
            for ids in self.blocks():
                product[ids.numpy()] += TEXT * (self.words[ids] @ self.words.T).square_().numpy() @ block
        return np.asarray(product)

    @cached_property
    def _word_pairs(self) -> NDArray[np.float32] | None:
        """Vectors whose products are the squared cosines, shape (E, D (D + 1) / 2); None if more than E dimensions."""
        size, dimensions = self.words.shape
        if not 0 < dimensions * (dimensions + 1) // 2 <= size:
            return None
        one, other = torch.triu_indices(dimensions, dimensions)
        return (self.words[:, one] * self.words[:, other] * torch.where(one == other, 1.0, 2**0.5)).numpy()

    def _by_words(self, ids: Tensor) -> Tensor:
        return TEXT * (self.words[ids] @ self.words.T).clamp(min=0) ** 2


def check_vectors(vectors: NDArray[np.floating] | None, num_entities: int) -> None:
    """Refuse word vectors that are not a row for each entity.

    Raises:
        ConfigError: saying what they are.
    """
    if vectors is not None and (vectors.ndim != 2 or len(vectors) != num_entities):
        raise ConfigError(
            f"`vectors` have shape {vectors.shape}; expected a row for each of the {num_entities:,} entities. "
            "Make them from the graph's labels, by make_features."
        )
