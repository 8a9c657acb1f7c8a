"""How alike entities are, by what recipes do with them and by the words of their labels."""

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.graphs.arrays import Ids

DAMPING = 0.25
"""A column of the profiles is divided by its sum to this power, so that what many entities share says less."""
CONTEXT = 2.0
"""Weight of (partner, result) contexts beside single links."""
TEXT = 0.2
"""Weight of the squared cosine of word vectors beside that of profiles."""


def profiles(recipes: Ids, num_entities: int) -> Any:
    """Return the use of each entity in recipes, shape (n, 3), as unit rows of a sparse matrix: shape (E, M).

    With C the symmetric combinesWith links, P the componentOf links (ingredient, result) and R the contexts (partner,
    result) in which an entity is an ingredient, the rows are those of ``[C | P | Pᵀ | 2 R]``, damped and normalised. An
    entity of no recipe has a row of zeros.
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
    """Return the cosine of each two rows, shape (E, E); 0 where one is zero."""
    unit = torch.nn.functional.normalize(vectors, dim=1)
    return unit @ unit.T


def similarity(recipes: Ids, text: Tensor) -> Tensor:
    """Return ``k(x, y) = cos(profiles) + 0.2 max(0, cos(words))²``, shape (E, E); ``text`` are the cosines of words.

    Without words it is positive semi-definite; with vectors of few dimensions it may have negative eigenvalues.
    """
    rows = profiles(recipes, len(text))
    structure = torch.from_numpy((rows @ rows.T).toarray().astype(np.float32))
    return structure + TEXT * text.clamp(min=0) ** 2


def normalised(kernel: Tensor) -> Tensor:
    """Return ``k(x, y) / √(k(x, x) k(y, y))``; 0 where an entity is like nothing, not even itself."""
    scale = kernel.diagonal().clamp(min=1e-9).rsqrt()
    return scale[:, None] * kernel * scale


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
