"""Kernel regression of links at low rank: scores of all pairs as products of two thin matrices.

With landmarks L, entities whose recipes are known, and k the entity similarity, an entity's
coordinates are ``Φ = K_EL V w^(-1/2)`` (Nyström), with ``K_LL = V diag(w) Vᵀ``. The ridge
regression of a link table Y with the product kernel has a closed form: with ``G = Φᵀ Φ`` over
entities with recipes and ``G = Q diag(g) Qᵀ``::

    scores = (Φ Q) [(Qᵀ Φᵀ Y Φ Q) / (g gᵀ + λ)] (Φ Q)ᵀ

If all entities with recipes are landmarks, this is exactly
:func:`~wordcraft_kg.models.scorers.kernel.kernel_regression`. The cost is E L D for the kernel,
L³ for eigenvectors and (links) m for the products.

Source: Williams and Seeger 2001 (Nyström); Stock et al. 2018 (two-step and Kronecker ridge).
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from wordcraft_kg.graphs.arrays import Ids
from wordcraft_kg.graphs.triples import COMBINES_WITH, COMPONENT_OF, recipe_triples
from wordcraft_kg.models.scorers.kernel import TEXT
from wordcraft_kg.models.scorers.neighbours.blocks import blocks_of, of_blocks, write_blocks

RANK = 256
"""Coordinates m of an entity in the regression."""
LANDMARKS = 1_536
"""Most landmarks: the entities in most recipes, ties by id."""
RIDGE = 1.0
"""λ, as in the regression with full tables."""

Floats = NDArray[np.float32]


def link_factors(
    recipes: Ids,
    rows: Any,
    vectors: Floats,
    rank: int = RANK,
) -> tuple[Floats, Floats, Floats]:
    """Return the factors of componentOf and combinesWith scores.

    Args:
        recipes: ids (n, 3).
        rows: profiles, sparse, shape (T, M).
        vectors: unit word vectors, shape (T, D).
        rank: m, most coordinates.

    Returns:
        ``left``, ``right`` and ``pair_left``, shape (T, m) each: componentOf is ``left[x] ·
        right[c]``, combinesWith ``pair_left[a] · right[b]``. Without recipes m is 0.
    """
    from scipy import sparse

    size = len(vectors)
    seen, counts = np.unique(recipes, return_counts=True)
    if not len(seen) or not rank:
        nothing = np.zeros((size, 0), dtype=np.float32)
        return nothing, nothing, nothing
    # A stable sort, so that ties are in the order of ids.
    by_count = np.argsort(-counts, kind="stable")
    landmarks = np.sort(seen[by_count[:LANDMARKS]])
    columns = rows[landmarks].T.tocsr()
    of_words = vectors[landmarks].T
    kernel = _kernel(landmarks, columns, of_words, rows, vectors)
    values, basis = np.linalg.eigh(kernel)
    # The largest eigenvalues; those up to rounding or below 0 have no root.
    has_root = values > 1e-6 * values[-1]
    kept = np.flatnonzero(has_root)[-rank:]
    basis = basis[:, kept] / np.sqrt(values[kept])
    # Blocks of entities from here on: all at once would take several times the memory of the
    # factors. Sums of blocks are added in their order.
    blocks = blocks_of(size)
    every = np.arange(size)
    turned = np.empty((size, len(kept)))

    def coordinates(block: slice) -> None:
        turned[block] = _kernel(every[block], columns, of_words, rows, vectors) @ basis

    def squares_of_seen(block: slice) -> NDArray[np.float64]:
        of_seen = turned[seen[block]]
        return np.asarray(of_seen.T @ of_seen)

    def rotate(block: slice) -> None:
        turned[block] = turned[block] @ turn

    write_blocks(coordinates, blocks)
    # Only entities with recipes are fitted; those without are no negative evidence.
    squares = np.zeros((len(kept), len(kept)))
    for part in of_blocks(squares_of_seen, blocks):
        squares += part
    weights, turn = np.linalg.eigh(squares)
    write_blocks(rotate, blocks)
    triples = recipe_triples(recipes)
    products = np.maximum(weights, 0)
    shrinkage = products[:, None] * products + RIDGE
    # Each relation has its own left factor; the right one, Φ Q, serves both.
    lefts = []
    for relation in (COMPONENT_OF, COMBINES_WITH):
        is_own = triples[:, 1] == relation
        heads, _, tails = triples[is_own].T
        ones = np.ones(len(heads))
        links = sparse.csr_array((ones, (heads, tails)), shape=(size, size))
        lefts.append(_left_factor(turned, links, shrinkage, blocks))
    left, pair_left = lefts
    return left, turned.astype(np.float32), pair_left


def _left_factor(
    turned: NDArray[np.float64],
    links: Any,
    shrinkage: NDArray[np.float64],
    blocks: Sequence[slice],
) -> Floats:
    """Return ``Φ Q [(Qᵀ Φᵀ Y Φ Q) / (g gᵀ + λ)]``, shape (T, m).

    Args:
        turned: Φ Q, shape (T, m).
        links: Y, sparse, shape (T, T).
        shrinkage: g gᵀ + λ, shape (m, m).
        blocks: of entities.
    """

    def product(block: slice) -> NDArray[np.float64]:
        return np.asarray(turned[block].T @ (links[block] @ turned))

    inner = np.zeros_like(shrinkage)
    for part in of_blocks(product, blocks):
        inner += part
    weights = inner / shrinkage
    left = np.empty(turned.shape, dtype=np.float32)

    def write(block: slice) -> None:
        left[block] = turned[block] @ weights

    write_blocks(write, blocks)
    return left


def _kernel(
    some: Ids,
    columns: Any,
    of_words: Floats,
    rows: Any,
    vectors: Floats,
) -> NDArray[np.float64]:
    """Return k(x, y) for N entities by rows and L landmarks by columns, shape (N, L).

    Args:
        some: the N entities.
        columns: profiles of the landmarks, sparse, shape (M, L); by rows, because SciPy would turn
            another layout anew for each block of entities.
        of_words: word vectors of the landmarks, shape (D, L).
        rows: profiles of all entities, sparse, shape (T, M).
        vectors: word vectors of all entities, shape (T, D).
    """
    products = rows[some] @ columns
    structure = products.toarray().astype(np.float64)
    if not vectors.shape[1]:
        return structure
    cosines = vectors[some] @ of_words
    # Clamped first, because the square of a negative cosine would count as similarity.
    positive = np.maximum(cosines, 0).astype(np.float64)
    return np.asarray(structure + TEXT * positive**2)
