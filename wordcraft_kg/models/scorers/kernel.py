"""The recipe kernel: links predicted in closed form from how alike entities are."""

import numpy as np
import torch
from torch import Tensor

from wordcraft_kg.graphs.arrays import Ids
from wordcraft_kg.graphs.triples import COMBINES_WITH, COMPONENT_OF, recipe_triples

RIDGE = 1.0
COMPLETION = 0.5
"""Weight of the completion term beside the regression, both standardised."""


def kernel_regression(kernel: Tensor, links: Tensor, ridge: float = RIDGE) -> Tensor:
    """Return the ridge regression of links on the product kernel ``k((x, y), (x', y')) = k(x, x') k(y, y')``.

    With ``k = V diag(w) Vᵀ`` it is ``V [(w wᵀ) / (w wᵀ + λ) ∘ (Vᵀ Y V)] Vᵀ``: an E x E problem, not an E² x E² one.

    Args:
        kernel: shape (E, E), positive semi-definite.
        links: Y, shape (E, E).
        ridge: λ.

    Source: Stock et al. 2018, "A comparative study of pairwise learning methods based on kernel ridge regression";
    Pahikkala et al. 2013 (Kronecker kernels).
    """
    values, vectors = torch.linalg.eigh(kernel.double())
    weights = values.clamp(min=0)[:, None] * values.clamp(min=0)
    inner = vectors.T @ links.double() @ vectors
    return (vectors @ (weights / (weights + ridge) * inner) @ vectors.T).float()


def completion(recipes: Ids, num_entities: int) -> Tensor:
    """Return how strongly pairs are suggested by pairs of the same result, shape (E, E).

    With ``R_c`` the symmetric matrix of the pairs that make c, normalised by degrees, it is ``Σ_c R_c³``: if a + y,
    x + y and x + b make c, then a + b may as well.

    Args:
        recipes: shape (n, 3).
        num_entities: E.
    """
    table = torch.zeros(num_entities, num_entities)
    ordered = recipes[np.argsort(recipes[:, 2], kind="stable")]
    for of_result in np.split(ordered, np.flatnonzero(np.diff(ordered[:, 2])) + 1):
        ids, place = np.unique(of_result[:, :2], return_inverse=True)
        one, other = torch.from_numpy(place.reshape(-1, 2)).T
        pairs = torch.zeros(len(ids), len(ids))
        pairs[one, other] = pairs[other, one] = 1
        scale = pairs.sum(1).clamp(min=1).rsqrt()
        pairs = scale[:, None] * pairs * scale
        table[np.ix_(ids, ids)] += pairs @ pairs @ pairs
    return table


def link_matrices(recipes: Ids, num_entities: int) -> tuple[Tensor, Tensor]:
    """Return the combinesWith and componentOf links of recipes, two of shape (E, E), row = head, 1 or 0."""
    triples = recipe_triples(recipes)
    tables = torch.zeros(2, num_entities, num_entities)
    heads, relations, tails = torch.from_numpy(triples.copy()).T
    tables[relations, heads, tails] = 1
    return tables[COMBINES_WITH], tables[COMPONENT_OF]
