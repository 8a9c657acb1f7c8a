"""The recipe kernel for large graphs, as matrix factors in place of tables."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from wordcraft_kg.base.settings import whole
from wordcraft_kg.graphs.arrays import Ids
from wordcraft_kg.graphs.recipe_graph import RecipeGraph
from wordcraft_kg.graphs.triples import COMBINES_WITH, RELATIONS, recipe_triples
from wordcraft_kg.models.scorers.config import TABLE_LIMIT, table_bytes
from wordcraft_kg.models.scorers.factors import FactorsScorer
from wordcraft_kg.models.scorers.kernel import (
    COMPLETION,
    NAME,
    SMOOTHING,
    TEXT,
    KernelScorer,
    check_vectors,
    completion_paths,
    profiles,
)

_RANK = 256
"""Factors per relation."""
CELLS = 2**24
"""Maximum number of similarities in memory, 4 bytes each."""
_TOLERANCE = 1e-3
"""Relative residual at which conjugate gradients stop."""
_MAX_STEPS = 100
_POWERS = 1
"""Power iterations of the range finder."""

_Block = NDArray[np.float32]
"""Vectors over the entities, shape (E, m)."""
_Product = Callable[[_Block], _Block]
"""Product of a matrix (E, E) with a block."""


@dataclass(frozen=True)
class SparseSimilarity:
    """The similarities of :func:`~wordcraft_kg.models.scorers.kernel.similarity`, without a table of all pairs.

    Attributes:
        shared: rows with each entity's uses in recipes, by :func:`~wordcraft_kg.models.scorers.kernel.profiles`; the M
            columns with two or more entities, sparse, shape (E, M).
        own: squared length in each profile's remaining columns, shape (E,); added to the diagonal only.
        words: unit word vectors, shape (E, D), zeros for unknown words; D is 0 without vectors.
    """

    shared: Any
    own: _Block
    words: Tensor

    @classmethod
    def of(cls, recipes: Ids, num_entities: int, vectors: NDArray[np.floating] | None = None) -> "SparseSimilarity":
        """Return the entity similarities from recipes (n, 3) and optional word vectors (E, D)."""
        check_vectors(vectors, num_entities)
        known = profiles(recipes, num_entities)
        is_shared = np.bincount(known.indices, minlength=known.shape[1]) > 1
        alone = known[:, np.flatnonzero(~is_shared)]
        own = np.asarray(alone.multiply(alone).sum(axis=1)).astype(np.float32)
        words = torch.zeros(num_entities, 0) if vectors is None else torch.tensor(vectors, dtype=torch.float32)
        shared = known[:, np.flatnonzero(is_shared)].astype(np.float32).tocsr()
        return cls(shared, own, torch.nn.functional.normalize(words, dim=1))

    def times(self, block: _Block) -> _Block:
        """Return the product: kernel matrix (E, E) times a dense matrix (E, m).

        Negative word cosines count as positive: conjugate gradients need a positive semi-definite kernel. Both forms
        rank equally well.
        """
        product = self.shared @ (self._columns @ block) + self.own[:, None] * block
        if self._word_pairs is not None:
            product += TEXT * (self._word_pairs @ (self._word_pairs.T @ block))
        elif self.words.shape[1]:
            for ids in torch.arange(len(self.own)).split(max(1, CELLS // max(len(self.own), 1))):
                product[ids.numpy()] += TEXT * (self.words[ids] @ self.words.T).square_().numpy() @ block
        return np.asarray(product)

    @cached_property
    def _columns(self) -> Any:
        return self.shared.T.tocsr()

    @cached_property
    def _word_pairs(self) -> NDArray[np.float32] | None:
        """Vectors with products equal to squared cosines, shape (E, D (D + 1) / 2); None above E dimensions."""
        size, dimensions = self.words.shape
        if not 0 < dimensions * (dimensions + 1) // 2 <= size:
            return None
        one, other = torch.triu_indices(dimensions, dimensions)
        return (self.words[:, one] * self.words[:, other] * torch.where(one == other, 1.0, 2**0.5)).numpy()


def smoothed(kernel: SparseSimilarity, block: _Block, ridge: float = SMOOTHING) -> _Block:
    """Return ``K (K + λ)⁻¹ B``, shape (E, m), by conjugate gradients; K is the kernel, B ``block``, λ ``ridge``.

    Source: Hestenes and Stiefel 1952.
    """
    solution, residual, direction = np.zeros_like(block), block.copy(), block.copy()
    square = (residual**2).sum(0)
    enough = _TOLERANCE**2 * square
    for _ in range(_MAX_STEPS):
        if (square <= enough).all():
            break
        image = kernel.times(direction) + ridge * direction
        # Solved and zero columns stay unchanged.
        step = np.where(square > enough, square / np.maximum((direction * image).sum(0), 1e-30), 0)
        solution += step * direction
        residual -= step * image
        before, square = square, (residual**2).sum(0)
        direction = residual + square / np.maximum(before, 1e-30) * direction
    return block - ridge * solution


def two_step(kernel: SparseSimilarity, links: Any) -> _Product:
    """Return a function from a matrix B (E, m) to ``P Y P B``, with ``P = K (K + λ)⁻¹``.

    K is ``kernel``, λ is :data:`SMOOTHING`, Y is ``links``, sparse, shape (E, E), row = head.

    As :func:`~wordcraft_kg.models.scorers.kernel.two_step_regression`, without a table.
    """
    return lambda block: smoothed(kernel, np.asarray(links @ smoothed(kernel, block), dtype=np.float32))


def spread(image: _Block) -> float:
    """Estimate the root mean square entry in a matrix M from ``image``, M times a standard normal matrix.

    Source: Hutchinson 1990.
    """
    return float(np.sqrt((image.astype(np.float64) ** 2).sum(0).mean()) / max(len(image), 1)) or 1.0


class Term(NamedTuple):
    """A matrix M (E, E) in :func:`factored_sum`, as functions that return ``M B`` and ``Mᵀ B`` for a matrix B (E, m).

    The sum scales M to root mean square ``weight``.
    """

    weight: float
    product: _Product
    transposed: _Product


def factored_sum(terms: Sequence[Term], drawn: _Block) -> tuple[_Block, _Block]:
    """Return factors ``left`` and ``right``, shape (E, m): ``left rightᵀ`` approximates a weighted matrix sum.

    The approximation is nearly the best with rank m. ``drawn`` is a standard normal matrix, shape (E, m).

    Source: Halko, Martinsson and Tropp 2011, "Finding structure with randomness", algorithm 4.4.
    """
    images = [term.product(drawn) for term in terms]
    scales = [np.float32(term.weight / spread(image)) for term, image in zip(terms, images, strict=True)]

    def scaled(blocks: Iterable[_Block]) -> _Block:
        return np.sum([scale * block for scale, block in zip(scales, blocks, strict=True)], axis=0, dtype=np.float32)

    left, _ = np.linalg.qr(scaled(images))
    for _ in range(_POWERS):
        right, _ = np.linalg.qr(scaled(term.transposed(left) for term in terms))
        left, _ = np.linalg.qr(scaled(term.product(right) for term in terms))
    return left, scaled(term.transposed(left) for term in terms)


class LowRankKernelScorer(FactorsScorer):
    """Approximates :class:`KernelScorer` by low-rank matrix factors, for graphs too large for a score table.

    :func:`two_step` and half of :func:`~wordcraft_kg.models.scorers.kernel.completion` are scaled and summed; a seeded
    randomised singular value decomposition factors the sum. Truncating the flat kernel spectrum would lose more.
    combinesWith scores are only nearly symmetric: the error may differ between (a, b) and (b, a).
    """

    def __init__(
        self,
        graph: RecipeGraph,
        recipes: Ids,
        vectors: NDArray[np.floating] | None = None,
        *,
        rank: int = _RANK,
        seed: int = 0,
        **kwargs: Any,
    ):
        """Compute the score factors for each relation.

        Arguments as for :class:`KernelScorer`, plus ``rank``, the factors' length m, and a ``seed`` for the random
        matrix. Raises ConfigError for an invalid rank, or vectors that do not fit.
        """
        from scipy import sparse

        size = graph.num_entities
        whole("rank", rank, 1)
        kernel = SparseSimilarity.of(recipes, size, vectors)
        nodes, pairs = (matrix.astype(np.float32) for matrix in completion_paths(recipes, size))

        def paths(block: _Block) -> _Block:
            return np.asarray(nodes.T @ (pairs @ (pairs @ (pairs @ (nodes @ block)))))

        drawn = np.random.default_rng(seed).standard_normal((size, min(rank, size)), dtype=np.float32)
        triples = recipe_triples(recipes)
        factors = []
        for relation in range(len(RELATIONS)):
            heads, _, tails = triples[triples[:, 1] == relation].T
            links = sparse.csr_array((np.ones(len(heads), np.float32), (heads, tails)), shape=(size, size))
            terms = [Term(1.0, two_step(kernel, links), two_step(kernel, links.T.tocsr()))]
            if relation == COMBINES_WITH:
                terms.append(Term(COMPLETION, paths, paths))
            left, right = factored_sum(terms, drawn)
            factors.append((torch.from_numpy(left), torch.from_numpy(right)))
        super().__init__(factors, graph.entities, graph.hash, **{"name": NAME, **kwargs})


def kernel_scorer(
    graph: RecipeGraph, recipes: Ids, vectors: NDArray[np.floating] | None = None, **kwargs: Any
) -> KernelScorer | LowRankKernelScorer:
    """Return a scorer by kernel ridge regression on recipes (n, 3), and on word vectors (E, D) if given.

    The scorer has a score table up to :data:`TABLE_LIMIT`, low-rank factors for larger graphs.

    Example:
        >>> opened = open_graph("kitchen")
        >>> kernel_scorer(opened.graph, opened.split.recipes("train")).name
        'recipe kernel'
    """
    kind = KernelScorer if table_bytes(graph.num_entities) <= TABLE_LIMIT else LowRankKernelScorer
    return kind(graph, recipes, vectors, **kwargs)
