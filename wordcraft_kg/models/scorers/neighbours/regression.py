"""Kernel regression of links at low rank: scores of all pairs as products of two thin matrices.

Two kernels: the entity similarity k, by landmarks L, entities whose recipes are known; and the
product of word vectors. An entity's coordinates are ``Φ = K_EL V w^(-1/2)`` (Nyström), with
``K_LL = V diag(w) Vᵀ``; those by words are the word vectors themselves. The ridge regression of a
link table Y with the product kernel has a closed form: with ``G = Φᵀ Φ`` over entities with recipes
and ``G = Q diag(g) Qᵀ``::

    scores = (Φ Q) [(Qᵀ Φᵀ Y Φ Q) / (g gᵀ + λ)] (Φ Q)ᵀ

If all entities with recipes are landmarks, and m is as large, this is exactly the ridge regression
over all pairs. G is diagonal then, with the eigenvalues w, so that Q needs no computation. The cost
is E L D for the kernel, L³ for eigenvectors and (links) m for the products.

Source: Williams and Seeger 2001 (Nyström); Stock et al. 2018 (two-step and Kronecker ridge). See
"Links by kernel regression" in docs/explanation/recipe-scorer.md.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from wordcraft_kg.graphs import COMBINES_WITH, COMPONENT_OF, Ids, recipe_triples
from wordcraft_kg.models.scorers.kernel import TEXT
from wordcraft_kg.models.scorers.neighbours.blocks import blocks_of, of_blocks, write_blocks

RANK = 1_024
"""Most coordinates m of an entity in a regression, in a book of at most :data:`SMALL` entities.

With 256, componentOf links of Little Alchemy 2 have an MRR of .305 instead of .323 (split 10)."""
SMALL = 2_048
"""Most entities of a book whose regressions keep that many coordinates; others have 256."""
LANDMARKS = 1_024
"""Most landmarks: the entities in most recipes, ties by id."""
SMALL_LANDMARKS = 1_536
"""Most landmarks of a small book: often all its entities, which saves another eigenproblem."""
_CELLS = 2**26
"""Similarities of entities and landmarks, about, from which on landmarks are fewer."""
_FEWEST = 256
"""Fewest landmarks of a large book."""
RIDGE = 1.0
"""λ, as in the regression with full tables."""
RESULT_RANK = 64
"""Most word coordinates r of the regression of results.

On split 10 of Little Alchemy 2, by recipe, 64 gain .009 [.004, .015] with 8 distractors, 128 gain
.005 [.000, .011]."""
PRODUCT = np.float32(4)
"""Scale of the products of two ingredients' coordinates, which are smaller than their sums."""
RESULT_RIDGE = 3.0
"""λ of the regression of results."""

Floats = NDArray[np.float32]


class Factors(NamedTuple):
    """Scores of links as products: componentOf is ``left[x] · right[c]``.

    Attributes:
        left: shape (T, m).
        right: shape (T, m).
        pair_left: shape (T, m): combinesWith is ``pair_left[a] · right[b]``.
    """

    left: Floats
    right: Floats
    pair_left: Floats


def link_factors(
    recipes: Ids,
    rows: Any,
    vectors: Floats,
    rank: int = RANK,
) -> tuple[Factors, Factors]:
    """Return the factors of the regression by similarities, and of that by word vectors.

    Args:
        recipes: ids (n, 3).
        rows: profiles, sparse, shape (T, M).
        vectors: unit word vectors, shape (T, D).
        rank: most coordinates; m is 0 without recipes.
    """
    size = len(vectors)
    train_ids, counts = np.unique(recipes, return_counts=True)
    nothing = np.zeros((size, 0), dtype=np.float32)
    if not len(train_ids) or not rank:
        return (Factors(nothing, nothing, nothing),) * 2
    max_landmarks = SMALL_LANDMARKS if size <= SMALL else LANDMARKS
    num_landmarks = max(_FEWEST, min(max_landmarks, _CELLS // size))
    # A stable sort, so that ties are in the order of ids.
    by_count = np.argsort(-counts, kind="stable")
    landmarks = np.sort(train_ids[by_count[:num_landmarks]])
    # In a large book a quarter of the landmarks: factors are most of its memory.
    max_rank = rank if size <= SMALL else min(rank, num_landmarks // 4)
    columns = rows[landmarks].T.tocsr()
    kernel = _kernel(landmarks, landmarks, columns, rows, vectors)
    values, basis = np.linalg.eigh(kernel.astype(np.float64))
    # Eigenvalues up to rounding or below 0 have no root.
    has_root = values > 1e-6 * values[-1]
    weights = values[has_root][-max_rank:]
    scaled = (basis[:, has_root][:, -max_rank:] / np.sqrt(weights)).astype(np.float32)
    coordinates = np.empty((size, scaled.shape[1]), dtype=np.float32)
    every = np.arange(size)

    def write(block: slice) -> None:
        coordinates[block] = _kernel(every[block], landmarks, columns, rows, vectors) @ scaled

    # Blocks of entities: all at once would take several times the memory of the factors.
    write_blocks(write, blocks_of(size))
    if len(landmarks) < len(train_ids):
        coordinates, weights = _turned(coordinates, train_ids, max_rank)
    word_coordinates, word_weights = _turned(vectors, train_ids, max_rank)
    triples = recipe_triples(recipes)
    return (
        _factors(coordinates, weights, triples),
        _factors(word_coordinates, word_weights, triples),
    )


def result_weights(recipes: Ids, coordinates: Floats) -> Floats:
    """Fit the words of a pair's result: ridge regression of ``w_c`` by ``[w_a + w_b | 4 w_a w_b]``.

    Args:
        recipes: ids (n, 3).
        coordinates: by word vectors, shape (T, m), of which w has the first r, the largest.

    Returns:
        shape (2 r, r).
    """
    words = coordinates[:, :RESULT_RANK]
    size = words.shape[1]

    def products(block: slice) -> NDArray[np.float64]:
        a, b, c = (words[column] for column in recipes[block].T)
        inputs = np.concatenate([a + b, PRODUCT * a * b], axis=1)
        return np.asarray(inputs.T @ np.concatenate([inputs, c], axis=1), dtype=np.float64)

    # Blocks are added in their order.
    sums = sum(of_blocks(products, blocks_of(len(recipes))), np.zeros((2 * size, 3 * size)))
    squares, targets = np.split(sums, [2 * size], axis=1)
    weights = np.linalg.solve(squares + RESULT_RIDGE * np.eye(2 * size), targets)
    return weights.astype(np.float32)


def _turned(
    coordinates: Floats,
    train_ids: Ids,
    rank: int,
) -> tuple[Floats, NDArray[np.float64]]:
    """Return coordinates Φ Q, shape (T, m), the largest first, and g, shape (m,).

    Args:
        coordinates: Φ, shape (T, D).
        train_ids: entities with recipes: those without are no negative evidence.
        rank: most directions Q, those with the largest g.
    """

    def square(block: slice) -> NDArray[np.float64]:
        part = coordinates[train_ids[block]]
        return np.asarray(part.T @ part, dtype=np.float64)

    # Blocks are added in their order.
    zeros = np.zeros((coordinates.shape[1],) * 2)
    squares = sum(of_blocks(square, blocks_of(len(train_ids))), zeros)
    weights, turn = np.linalg.eigh(squares)
    largest = np.maximum(weights[::-1][:rank], 0)
    directions = turn[:, ::-1][:, :rank].astype(np.float32)
    turned = np.empty((len(coordinates), len(largest)), dtype=np.float32)

    def rotate(block: slice) -> None:
        turned[block] = coordinates[block] @ directions

    write_blocks(rotate, blocks_of(len(coordinates)))
    return turned, largest


def _factors(right: Floats, weights: NDArray[np.float64], triples: Ids) -> Factors:
    """Fit the links of both relations, triples (L, 3), see :func:`_turned`."""
    shrinkage = weights[:, None] * weights + RIDGE
    # Each relation has its own left factor; the right one, Φ Q, serves both.
    component = _left_factor(right, triples[triples[:, 1] == COMPONENT_OF], shrinkage)
    combines = _left_factor(right, triples[triples[:, 1] == COMBINES_WITH], shrinkage)
    return Factors(component, right, combines)


def _left_factor(
    right: Floats,
    triples: Ids,
    shrinkage: NDArray[np.float64],
) -> Floats:
    """Return ``Φ Q [(Qᵀ Φᵀ Y Φ Q) / (g gᵀ + λ)]``, shape (T, m).

    Args:
        right: Φ Q, shape (T, m).
        triples: the links Y of a relation, shape (L, 3).
        shrinkage: g gᵀ + λ, shape (m, m).
    """
    heads, _, tails = triples.T
    link_values = np.ones(len(heads), dtype=np.float32)
    links = sparse.csr_array((link_values, (heads, tails)), shape=(len(right),) * 2)

    def product(block: slice) -> Floats:
        return np.asarray(right[block].T @ (links[block] @ right))

    inner = sum(of_blocks(product, blocks_of(len(right))), np.zeros_like(shrinkage))
    return right @ (inner / shrinkage).astype(np.float32)


def _kernel(
    entity_ids: Ids,
    landmarks: Ids,
    columns: Any,
    rows: Any,
    vectors: Floats,
) -> Floats:
    """Return k(x, y) for N entities by rows and L landmarks by columns, shape (N, L).

    Args:
        entity_ids: the N entities.
        landmarks: the L landmarks.
        columns: profiles of the landmarks, sparse, shape (M, L); by rows, because SciPy would turn
            another layout anew for each block of entities.
        rows: profiles of all entities, sparse, shape (T, M).
        vectors: word vectors of all entities, shape (T, D).
    """
    structure = np.asarray((rows[entity_ids] @ columns).toarray(), dtype=np.float32)
    if not vectors.shape[1]:
        return structure
    # Clamped first, because the square of a negative cosine would count as similarity.
    positive = np.maximum(vectors[entity_ids] @ vectors[landmarks].T, 0)
    return structure + np.float32(TEXT) * positive**2
