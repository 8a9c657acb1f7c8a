"""The recipe kernel: closed-form link prediction from similarities between entities."""

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.base.statistics import standardised
from wordcraft_kg.graphs.arrays import Ids
from wordcraft_kg.graphs.recipe_graph import RecipeGraph
from wordcraft_kg.graphs.triples import COMBINES_WITH, COMPONENT_OF, recipe_triples
from wordcraft_kg.models.scorers.config import check_table
from wordcraft_kg.models.scorers.factors import TableScorer

_DAMPING = 0.25
"""Profile columns are divided by their sum to this power, which damps common columns."""
_CONTEXT = 2.0
"""Weight of (partner, result) contexts relative to single links."""
TEXT = 0.2
"""Weight of squared word cosines relative to profile cosines."""


def profiles(recipes: Ids, num_entities: int) -> Any:
    """Return a profile for each entity, its uses in recipes (n, 3): unit rows in a sparse matrix, shape (E, M).

    With C the symmetric combinesWith links, P the componentOf links (ingredient, result) and R the contexts (partner,
    result), rows are ``[C | P | Pᵀ | 2 R]``, damped and normalised; zeros for entities without recipes.
    """
    from scipy import sparse

    a, b, result = recipes.T
    one, other, makes = (
        np.concatenate([a, b]),
        np.concatenate([b, a]),
        np.concatenate([result, result]),
    )
    contexts, context = np.unique(other * num_entities + makes, return_inverse=True)

    def links(rows: Ids, columns: Ids, width: int) -> Any:
        cells = np.unique(rows * width + columns)
        where = np.divmod(cells, max(width, 1))
        return sparse.csr_array((np.ones(len(cells)), where), shape=(num_entities, width))

    parts = links(one, makes, num_entities)
    rows = sparse.hstack(
        [
            links(one, other, num_entities),
            parts,
            parts.T,
            _CONTEXT * links(one, context, len(contexts)),
        ]
    ).tocsr()
    total = np.asarray(rows.sum(axis=0))
    damped = rows @ sparse.diags_array(np.maximum(total, 1e-9) ** -_DAMPING)
    norm = np.sqrt(np.asarray(damped.multiply(damped).sum(axis=1)))
    return (sparse.diags_array(1 / np.maximum(norm, 1e-9)) @ damped).tocsr()


def cosines(vectors: Tensor) -> Tensor:
    """Return the cosines between all pairs of rows, shape (E, E); 0 for zero rows."""
    unit = torch.nn.functional.normalize(vectors, dim=1)
    return unit @ unit.T


def similarity(recipes: Ids, text: Tensor) -> Tensor:
    """Return entity similarities ``k(x, y) = cos(profiles) + 0.2 max(0, cos(words))²``, shape (E, E).

    Profiles list an entity's partners, results and ingredients in ``recipes`` (n, 3), see :func:`profiles`; ``text``
    holds word cosines (E, E). Few word dimensions may cause negative eigenvalues.
    """
    rows = profiles(recipes, len(text))
    structure = torch.from_numpy((rows @ rows.T).toarray().astype(np.float32))
    return structure + TEXT * text.clamp(min=0) ** 2


def normalised(kernel: Tensor) -> Tensor:
    """Return a kernel scaled to diagonal 1, ``k(x, y) / √(k(x, x) k(y, y))``; 0 for entities without similarity."""
    scale = kernel.diagonal().clamp(min=1e-9).rsqrt()
    return scale[:, None] * kernel * scale


_RIDGE = 1.0
_COMPLETION = 0.5
"""Weight of the completion term; regression and completion are standardised."""


def kernel_regression(
    kernel: Tensor, *links: Tensor, ridge: float = _RIDGE, seen: Tensor | None = None
) -> tuple[Tensor, ...]:
    """Fit links by ridge regression with the product kernel ``k((x, y), (x', y')) = k(x, x') k(y, y')``.

    With ``k = V diag(w) Vᵀ`` the solution is ``V [(w wᵀ) / (w wᵀ + λ) ∘ (Vᵀ Y V)] Vᵀ``: an E x E problem, not E² x E².
    Entities outside ``seen`` are only predicted, ``K A Kᵀ``: missing links give no negative evidence. The results are
    the scores of all links for each table, shape (E, E) each.

    Args:
        kernel: k, entity similarities, shape (E, E), symmetric; negative eigenvalues count as 0.
        *links: tables Y, shape (E, E) each, 1 for known links, else 0.
        ridge: λ, the regularisation strength.
        seen: ids of training entities; all by default.

    Source: Stock et al. 2018, "A comparative study of pairwise learning methods based on kernel ridge regression";
    Pahikkala et al. 2013 (Kronecker kernels).
    """
    seen = torch.arange(len(kernel)) if seen is None else seen
    kernel = kernel.double()[:, seen]
    values, vectors = torch.linalg.eigh(kernel[seen])
    shrinkage = values.clamp(min=0)[:, None] * values.clamp(min=0) + ridge
    factor = kernel @ (vectors * (values > 0))
    inner = [vectors.T @ table.double()[seen][:, seen] @ vectors for table in links]
    return tuple((factor @ (each / shrinkage) @ factor.T).float() for each in inner)


def completion(recipes: Ids, num_entities: int) -> Tensor:
    """Score all pairs as ingredients by known pairs with the same result, shape (E, E); ``recipes`` are (n, 3).

    With ``R_c`` the degree-normalised symmetric matrix for pairs that make c, the score is ``Σ_c R_c³``: if a + y, x +
    y and x + b make c, then a + b may as well.
    """
    from scipy import sparse

    a, b, result = recipes.T
    # A node is an entity as ingredient for a single result.
    cells, place = np.unique(
        np.concatenate([result, result]) * num_entities + np.concatenate([a, b]),
        return_inverse=True,
    )
    one, other = place.reshape(2, -1)
    count = len(cells)
    ends = np.unique(np.concatenate([one * count + other, other * count + one]))
    pairs = sparse.csr_array(
        (np.ones(len(ends)), np.divmod(ends, max(count, 1))), shape=(count, count)
    )
    scale = sparse.diags_array(np.asarray(pairs.sum(axis=1)).clip(1) ** -0.5)
    nodes = sparse.csr_array(
        (np.ones(count), (np.arange(count), cells % num_entities)), shape=(count, num_entities)
    )
    pairs = (scale @ pairs @ scale).tocsr()
    return torch.from_numpy(
        (nodes.T @ (pairs @ (pairs @ (pairs @ nodes)))).toarray().astype(np.float32)
    )


def link_matrices(recipes: Ids, num_entities: int) -> tuple[Tensor, Tensor]:
    """Return the recipes' combinesWith and componentOf links: shape (E, E) each, row = head, 1 or 0."""
    triples = recipe_triples(recipes)
    tables = torch.zeros(2, num_entities, num_entities)
    heads, relations, tails = torch.from_numpy(triples.copy()).T
    tables[relations, heads, tails] = 1
    return tables[COMBINES_WITH], tables[COMPONENT_OF]


def kernel_scores(
    recipes: Ids, kernel: Tensor, completed: Tensor, seen: Tensor | None = None
) -> tuple[Tensor, Tensor]:
    """Score all combinesWith and componentOf links by ``kernel``, entity similarities (E, E); (E, E) each, row = head.

    Scores as in :class:`KernelScorer`; the fit and the standardisation use only entity ids in ``seen``, by default all.
    ``completed`` is :func:`completion`.
    """

    def scaled(table: Tensor) -> NDArray[np.float64]:
        return standardised(table.numpy(), None if seen is None else seen.numpy())

    links = link_matrices(recipes, len(kernel))
    combines, component = map(scaled, kernel_regression(kernel, *links, seen=seen))
    combines += _COMPLETION * scaled(completed)
    return torch.from_numpy(combines).float(), torch.from_numpy(component).float()


class KernelScorer(TableScorer):
    """A link scorer by kernel ridge regression: a closed-form solution without training steps.

    Both scores are standardised :func:`kernel_regression`; combinesWith adds half the standardised :func:`completion`,
    a score for ingredient pairs by known pairs with the same result. Do not pass test recipes.
    """

    def __init__(
        self,
        graph: RecipeGraph,
        recipes: Ids,
        vectors: NDArray[np.floating] | None = None,
        **kwargs: Any,
    ):
        """Compute the score table from training recipes, ids (n, 3), such as ``split.recipes("train")``.

        ``vectors`` are the entities' word vectors, shape (E, D), zeros for unknown words; ``kwargs`` are ``device`` and
        ``name``. Raises ConfigError if the graph is too large, or the vectors do not fit.
        """
        size = graph.num_entities
        check_table("the recipe kernel", size)
        if vectors is not None and (vectors.ndim != 2 or len(vectors) != size):
            raise ConfigError(
                f"`vectors` have shape {vectors.shape}; expected {size:,} rows, a row per entity. Make vectors from "
                "the graph's labels, by make_features."
            )
        alike = (
            torch.zeros(size, size)
            if vectors is None
            else cosines(torch.tensor(vectors, dtype=torch.float32))
        )
        scores = kernel_scores(recipes, similarity(recipes, alike), completion(recipes, size))
        super().__init__(
            torch.stack(scores), graph.entities, graph.hash, **{"name": "recipe kernel", **kwargs}
        )
