"""Similarity of entities by use in recipes and by words."""

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.graphs.arrays import Ids

DAMPING = 0.25
"""Profile columns are divided by their sum to this power, which damps common columns."""
CONTEXT = 2.0
"""Weight of (partner, result) contexts relative to single links."""
TEXT = 0.2
"""Weight of squared word cosines relative to profile cosines."""


def profiles(recipes: Ids, num_entities: int) -> Any:
    """Return the use of each entity in recipes (n, 3) as unit rows of a sparse matrix, shape (E, M).

    With C the symmetric combinesWith links, P the componentOf links (ingredient, result) and R the contexts (partner,
    result), rows are ``[C | P | Pᵀ | 2 R]``, damped and normalised; zeros for entities without recipes.
    """
    from scipy import sparse

    a, b, result = recipes.T
    one, other, makes = np.concatenate([a, b]), np.concatenate([b, a]), np.concatenate([result, result])
    contexts, context = np.unique(other * num_entities + makes, return_inverse=True)

    def links(rows: Ids, columns: Ids, width: int) -> Any:
        cells = np.unique(rows * width + columns)
        where = np.divmod(cells, max(width, 1))
        return sparse.csr_array((np.ones(len(cells)), where), shape=(num_entities, width))

    parts = links(one, makes, num_entities)
    rows = sparse.hstack(
        [links(one, other, num_entities), parts, parts.T, CONTEXT * links(one, context, len(contexts))]
    ).tocsr()
    total = np.asarray(rows.sum(axis=0))
    damped = rows @ sparse.diags_array(np.maximum(total, 1e-9) ** -DAMPING)
    norm = np.sqrt(np.asarray(damped.multiply(damped).sum(axis=1)))
    return (sparse.diags_array(1 / np.maximum(norm, 1e-9)) @ damped).tocsr()


def cosines(vectors: Tensor) -> Tensor:
    """Return row cosines, shape (E, E); 0 for zero rows."""
    unit = torch.nn.functional.normalize(vectors, dim=1)
    return unit @ unit.T


def similarity(recipes: Ids, text: Tensor) -> Tensor:
    """Return ``k(x, y) = cos(profiles) + 0.2 max(0, cos(words))²``, shape (E, E); ``text`` are word cosines.

    Positive semi-definite without words; vectors with few dimensions may cause negative eigenvalues.
    """
    rows = profiles(recipes, len(text))
    structure = torch.from_numpy((rows @ rows.T).toarray().astype(np.float32))
    return structure + TEXT * text.clamp(min=0) ** 2


def normalised(kernel: Tensor) -> Tensor:
    """Return ``k(x, y) / √(k(x, x) k(y, y))``; 0 for entities without any similarity."""
    scale = kernel.diagonal().clamp(min=1e-9).rsqrt()
    return scale[:, None] * kernel * scale


def check_vectors(vectors: NDArray[np.floating] | None, num_entities: int) -> None:
    """Raise ConfigError unless word vectors have one row per entity."""
    if vectors is not None and (vectors.ndim != 2 or len(vectors) != num_entities):
        raise ConfigError(
            f"`vectors` have shape {vectors.shape}; expected a row for each of the {num_entities:,} entities. "
            "Make them from the graph's labels, by make_features."
        )
