"""Profiles of entities and completion of links: what recipes say about similarity and pairs.

See "Similar entities" and "Links by kernel regression" in docs/explanation/recipe-scorer.md.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from wordcraft_kg.graphs.arrays import Ids, distinct

_DAMPING = 0.25
"""Profile columns are divided by their sum to this power, which damps common columns."""
_CONTEXT = 2.0
"""Weight of (partner, result) contexts relative to single links."""
TEXT = 0.2
"""Weight of squared word cosines relative to profile cosines."""


def profiles(recipes: Ids, num_entities: int) -> Any:
    """Return a profile for each entity: its uses in recipes, as unit rows of a sparse matrix.

    With C the symmetric combinesWith links, P the componentOf links (ingredient, result) and R the
    contexts (partner, result), rows are ``[C | P | Pᵀ | 2 R]``, damped and normalised.

    Args:
        recipes: ids (n, 3): two ingredients and the result.
        num_entities: E.

    Returns:
        a sparse matrix of shape (E, M), float64; zeros for entities without recipes.
    """
    a, b, result = recipes.T
    # Each recipe is read twice, once from each ingredient.
    entities = np.concatenate([a, b])
    partner_ids = np.concatenate([b, a])
    makes = np.concatenate([result, result])
    # A context is one number for (partner, result); only contexts that occur get a column.
    codes = partner_ids * num_entities + makes
    contexts, context = np.unique(codes, return_inverse=True)
    partners = _links(entities, partner_ids, (num_entities, num_entities))
    parts = _links(entities, makes, (num_entities, num_entities))
    context_links = _links(entities, context, (num_entities, len(contexts)))
    blocks = [partners, parts, parts.T, _CONTEXT * context_links]
    rows = sparse.hstack(blocks).tocsr()
    total = np.asarray(rows.sum(axis=0))
    # The least values keep empty columns and rows at zero, where a division would give NaN.
    damping = np.maximum(total, 1e-9) ** -_DAMPING
    damped = rows @ sparse.diags_array(damping)
    squares = damped.multiply(damped)
    square = np.asarray(squares.sum(axis=1))
    norm = np.sqrt(square)
    inverse = 1 / np.maximum(norm, 1e-9)
    unit = sparse.diags_array(inverse) @ damped
    return unit.tocsr()


def _links(rows: Ids, columns: Ids, shape: tuple[int, int]) -> Any:
    """Return a sparse 0/1 matrix with ones at the given cells.

    Args:
        rows: row of each cell, shape (n,).
        columns: column of each cell, shape (n,).
        shape: numbers of rows and of columns.
    """
    width = shape[1]
    # Unique, because the sparse matrix would add up repeated cells.
    cells = distinct(rows * width + columns)
    coordinates = np.divmod(cells, max(width, 1))
    return sparse.csr_array((np.ones(len(cells)), coordinates), shape=shape)


def completion(recipes: Ids, num_entities: int) -> NDArray[np.float32]:
    """Score all pairs as ingredients by known pairs with the same result.

    With ``R_c`` the degree-normalised symmetric matrix for pairs that make c, the score is
    ``Σ_c R_c³``: if a + y, x + y and x + b make c, then a + b may as well.

    Args:
        recipes: ids (n, 3).
        num_entities: E.

    Returns:
        shape (E, E), float32.
    """
    nodes, pairs = completion_parts(recipes, num_entities)
    # R³ of all results, three products from the right; the product with nodesᵀ sums over results.
    third = pairs @ (pairs @ (pairs @ nodes))
    scores = nodes.T @ third
    return np.asarray(scores.toarray(), dtype=np.float32)


def completion_parts(recipes: Ids, num_entities: int) -> tuple[Any, Any]:
    """Return the sparse matrices of which :func:`completion` is a product.

    A node is an entity as ingredient for a single result, so one matrix over all nodes holds the
    R_c of all results as blocks.

    Args:
        recipes: ids (n, 3).
        num_entities: E.

    Returns:
        which entity a node is, shape (nodes, E), and R, shape (nodes, nodes).
    """
    a, b, result = recipes.T
    results = np.concatenate([result, result])
    ingredients = np.concatenate([a, b])
    codes = results * num_entities + ingredients
    cells, place = np.unique(codes, return_inverse=True)
    # The first half belongs to the first ingredients, the second half to their partners.
    first_nodes, second_nodes = place.reshape(2, -1)
    count = len(cells)
    # Both directions; a + a gives the same cell twice, which counts once.
    both_ways = np.concatenate([first_nodes, second_nodes])
    partner_nodes = np.concatenate([second_nodes, first_nodes])
    pairs = _links(both_ways, partner_nodes, (count, count))
    degrees = np.asarray(pairs.sum(axis=1))
    # Degrees are 1 or more: a node's own recipe gives it a pair.
    scale = sparse.diags_array(degrees**-0.5)
    normalised_pairs = scale @ pairs @ scale
    nodes = _links(np.arange(count), cells % num_entities, (count, num_entities))
    return nodes, normalised_pairs.tocsr()
