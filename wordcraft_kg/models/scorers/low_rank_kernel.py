"""The recipe kernel of large graphs: the same similarities, smoothing and paths, of which only factors are kept."""

from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from wordcraft_kg.models.scorers.similarity_rows import SimilarityRows

SMOOTHING = 0.5
"""Ridge of each of the two steps. On validation parts .2 to .5 rank alike, and the larger loses less by low rank."""
TOLERANCE = 1e-3
"""Residual, beside the right-hand side, at which the solution is good enough."""
MAX_STEPS = 100
POWERS = 1
"""How often the range finder multiplies by the scores and back."""

Block = NDArray[np.float32]
"""Vectors over the entities, shape (E, m)."""
Product = Callable[[Block], Block]
"""What a matrix of shape (E, E) does to a block."""


def smoothed(kernel: SimilarityRows, block: Block, ridge: float = SMOOTHING) -> Block:
    """Return ``K (K + λ)⁻¹ B``, shape (E, m), by conjugate gradients, all columns side by side.

    Source: Hestenes and Stiefel 1952.
    """
    solution = np.zeros_like(block)
    residual = block.copy()
    direction = block.copy()
    square = (residual**2).sum(0)
    enough = TOLERANCE**2 * square
    for _ in range(MAX_STEPS):
        if (square <= enough).all():
            break
        image = kernel.times(direction) + ridge * direction
        # A column that is solved (or zero) stays where it is.
        step = np.where(square > enough, square / np.maximum((direction * image).sum(0), 1e-30), 0)
        solution += step * direction
        residual -= step * image
        before, square = square, (residual**2).sum(0)
        direction = residual + square / np.maximum(before, 1e-30) * direction
    return block - ridge * solution


def two_step(kernel: SimilarityRows, links: Any) -> Product:
    """Return the product with ``P Y P``, ``P = K (K + λ)⁻¹``: ridge regression over the heads, then over the tails.

    It stands in for :func:`~wordcraft_kg.models.scorers.kernel.kernel_regression`, whose filter ``w w' / (w w' + λ)``
    is no product of one for heads and one for tails, so that it needs all eigenvectors.

    Args:
        kernel: K.
        links: Y, sparse, shape (E, E), row = head.

    Source: Pahikkala et al. 2014, "A two-step learning approach for solving full and almost full cold start problems in
    dyadic prediction"; Stock et al. 2018.
    """
    return lambda block: smoothed(kernel, np.asarray(links @ smoothed(kernel, block), dtype=np.float32))


def spread(image: Block) -> float:
    """Return the root mean square of the entries of a matrix M, estimated from ``M Ω`` for standard normal Ω.

    Source: Hutchinson 1990.
    """
    found = float(np.sqrt((image.astype(np.float64) ** 2).sum(0).mean()) / max(len(image), 1))
    return found or 1.0


class Term(NamedTuple):
    """A matrix of shape (E, E) that counts with a weight, once its entries have a root mean square of 1.

    Attributes:
        weight: the weight.
        product: what the matrix does to a block.
        transposed: what its transpose does.
    """

    weight: float
    product: Product
    transposed: Product


def factored_sum(terms: Sequence[Term], drawn: Block) -> tuple[Block, Block]:
    """Return ``left`` and ``right``, shape (E, m), whose product ``left rightᵀ`` is close to the best of that rank.

    Args:
        terms: what is summed.
        drawn: random directions, shape (E, m), standard normal.

    Source: Halko, Martinsson and Tropp 2011, "Finding structure with randomness", algorithm 4.4.
    """
    images = [term.product(drawn) for term in terms]
    scales = [np.float32(term.weight / spread(image)) for term, image in zip(terms, images, strict=True)]

    def scaled(blocks: Iterable[Block]) -> Block:
        return np.sum([scale * block for scale, block in zip(scales, blocks, strict=True)], axis=0, dtype=np.float32)

    left, _ = np.linalg.qr(scaled(images))
    for _ in range(POWERS):
        right, _ = np.linalg.qr(scaled(term.transposed(left) for term in terms))
        left, _ = np.linalg.qr(scaled(term.product(right) for term in terms))
    return left, scaled(term.transposed(left) for term in terms)
