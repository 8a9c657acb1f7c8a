"""The recipe kernel: closed-form link prediction from similarities between entities.

See "Similar entities" and "Links by kernel regression" in docs/explanation/recipe-scorer.md.
"""

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.base.statistics import standardised
from wordcraft_kg.graphs.arrays import Ids, distinct
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
    """Return a profile for each entity: its uses in recipes, as unit rows of a sparse matrix.

    With C the symmetric combinesWith links, P the componentOf links (ingredient, result) and R the
    contexts (partner, result), rows are ``[C | P | Pᵀ | 2 R]``, damped and normalised.

    Args:
        recipes: ids (n, 3): two ingredients and the result.
        num_entities: E.

    Returns:
        a sparse matrix of shape (E, M), float64; zeros for entities without recipes.
    """
    from scipy import sparse

    a, b, result = recipes.T
    # Each recipe is read twice, once from each ingredient.
    entities = np.concatenate([a, b])
    partner_ids = np.concatenate([b, a])
    makes = np.concatenate([result, result])
    # A context is one number for (partner, result); only contexts that occur get a column.
    codes = partner_ids * num_entities + makes
    contexts, context = np.unique(codes, return_inverse=True)

    def links(rows: Ids, columns: Ids, width: int) -> Any:
        """Return a 0/1 matrix with ones at the given cells.

        Args:
            rows: entity of each cell, shape (n,).
            columns: column of each cell, shape (n,).
            width: number of columns.
        """
        # Unique, because the sparse matrix would add up repeated cells.
        cells = distinct(rows * width + columns)
        coordinates = np.divmod(cells, max(width, 1))
        cell_values = np.ones(len(cells))
        return sparse.csr_array((cell_values, coordinates), shape=(num_entities, width))

    partners = links(entities, partner_ids, num_entities)
    parts = links(entities, makes, num_entities)
    context_links = links(entities, context, len(contexts))
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


def cosines(vectors: Tensor) -> Tensor:
    """Return the cosines between all pairs of rows of (E, D), shape (E, E); 0 for zero rows."""
    unit = torch.nn.functional.normalize(vectors, dim=1)
    return unit @ unit.T


def similarity(recipes: Ids, text: Tensor) -> Tensor:
    """Return entity similarities ``k(x, y) = cos(profiles) + 0.2 max(0, cos(words))²``.

    Profiles list an entity's partners, results and ingredients, see :func:`profiles`. Few word
    dimensions may cause negative eigenvalues.

    Args:
        recipes: ids (n, 3).
        text: word cosines, shape (E, E).

    Returns:
        shape (E, E), float32.
    """
    rows = profiles(recipes, len(text))
    products = (rows @ rows.T).toarray()
    structure = torch.from_numpy(products.astype(np.float32))
    # Clamped first, because the square of a negative cosine would count as similarity.
    positive = text.clamp(min=0)
    return structure + TEXT * positive**2


def normalised(kernel: Tensor) -> Tensor:
    """Return a kernel, shape (E, E), scaled to diagonal 1: ``k(x, y) / √(k(x, x) k(y, y))``.

    Entities without similarity, even with themselves, keep zeros.
    """
    scale = kernel.diagonal().clamp(min=1e-9).rsqrt()
    return scale[:, None] * kernel * scale


_RIDGE = 1.0
"""λ, the regularisation strength of the regression."""
_COMPLETION = 0.5
"""Weight of the completion term; regression and completion are standardised."""


def kernel_regression(
    kernel: Tensor,
    *links: Tensor,
    ridge: float = _RIDGE,
    seen: Tensor | None = None,
) -> tuple[Tensor, ...]:
    """Fit links by ridge regression with the product kernel.

    The kernel of two links is ``k((x, y), (x', y')) = k(x, x') k(y, y')``. With the eigenvectors
    ``k = V diag(w) Vᵀ`` the solution is ``V [(w wᵀ) / (w wᵀ + λ) ∘ (Vᵀ Y V)] Vᵀ``: an E x E
    problem, not E² x E². Entities outside ``seen`` are only predicted, ``K A Kᵀ``: missing links
    give no negative evidence.

    Args:
        kernel: k, entity similarities, shape (E, E), symmetric; negative eigenvalues count as 0.
        *links: tables Y, shape (E, E) each, 1 for known links, else 0.
        ridge: λ, the regularisation strength.
        seen: ids of training entities; None for all.

    Returns:
        the scores of all links for each table, shape (E, E) each, float32.

    Source: Stock et al. 2018, "A comparative study of pairwise learning methods based on kernel
    ridge regression"; Pahikkala et al. 2013 (Kronecker kernels).
    """
    if seen is None:
        seen = torch.arange(len(kernel))
    # In 64 bits: eigenvectors of almost equal eigenvalues are sensitive to rounding.
    kernel = kernel.double()[:, seen]
    values, vectors = torch.linalg.eigh(kernel[seen])
    positive = values.clamp(min=0)
    shrinkage = positive[:, None] * positive + ridge
    # K V, without the directions whose eigenvalues are not positive.
    positive_vectors = vectors * (values > 0)
    factor = kernel @ positive_vectors
    scores = []
    for table in links:
        rows = table.double()[seen]
        known_links = rows[:, seen]
        inner = vectors.T @ known_links @ vectors
        shrunk = inner / shrinkage
        link_scores = factor @ shrunk @ factor.T
        scores.append(link_scores.float())
    return tuple(scores)


def completion(recipes: Ids, num_entities: int) -> Tensor:
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
    dense = scores.toarray()
    return torch.from_numpy(dense.astype(np.float32))


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
    from scipy import sparse

    a, b, result = recipes.T
    results = np.concatenate([result, result])
    ingredients = np.concatenate([a, b])
    codes = results * num_entities + ingredients
    cells, place = np.unique(codes, return_inverse=True)
    # The first half belongs to the first ingredients, the second half to their partners.
    first_nodes, second_nodes = place.reshape(2, -1)
    count = len(cells)
    # Both directions; a + a gives the same cell twice, which counts once.
    forth = first_nodes * count + second_nodes
    back = second_nodes * count + first_nodes
    ends = distinct(np.concatenate([forth, back]))
    coordinates = np.divmod(ends, max(count, 1))
    cell_values = np.ones(len(ends))
    pairs = sparse.csr_array((cell_values, coordinates), shape=(count, count))
    degrees = np.asarray(pairs.sum(axis=1))
    # Degrees are 1 or more: a node's own recipe gives it a pair.
    scale = sparse.diags_array(degrees**-0.5)
    normalised_pairs = scale @ pairs @ scale
    every_node = np.arange(count)
    entity = cells % num_entities
    cell_values = np.ones(count)
    nodes = sparse.csr_array((cell_values, (every_node, entity)), shape=(count, num_entities))
    return nodes, normalised_pairs.tocsr()


def link_matrices(recipes: Ids, num_entities: int) -> tuple[Tensor, Tensor]:
    """Return the recipes' links as tables.

    Args:
        recipes: ids (n, 3).
        num_entities: E.

    Returns:
        combinesWith and componentOf, shape (E, E) each, row = head: 1 for known links, else 0.
    """
    triples = recipe_triples(recipes)
    tables = torch.zeros(2, num_entities, num_entities)
    # A copy: torch shares the memory, and warns of read-only arrays.
    heads, relations, tails = torch.from_numpy(triples.copy()).T
    tables[relations, heads, tails] = 1
    return tables[COMBINES_WITH], tables[COMPONENT_OF]


def kernel_scores(
    recipes: Ids,
    kernel: Tensor,
    completed: Tensor,
    seen: Tensor | None = None,
) -> tuple[Tensor, Tensor]:
    """Score all combinesWith and componentOf links, as in :class:`KernelScorer`.

    Args:
        recipes: known recipes, ids (n, 3).
        kernel: entity similarities, shape (E, E).
        completed: scores of :func:`completion`, shape (E, E).
        seen: ids of the entities that the fit and the standardisation use; None for all.

    Returns:
        combinesWith and componentOf scores, shape (E, E) each, float32, row = head.
    """
    train_ids = None if seen is None else seen.numpy()

    def scaled(table: Tensor) -> NDArray[np.float64]:
        """Return a table with mean 0 and deviation 1 over the training entities."""
        return standardised(table.numpy(), train_ids)

    links = link_matrices(recipes, len(kernel))
    combines_scores, component_scores = kernel_regression(kernel, *links, seen=seen)
    combines = scaled(combines_scores)
    component = scaled(component_scores)
    # Both terms are standardised first: their scales have nothing to do with each other.
    combines += _COMPLETION * scaled(completed)
    return torch.from_numpy(combines).float(), torch.from_numpy(component).float()


class KernelScorer(TableScorer):
    """A link scorer by kernel ridge regression: a closed-form solution without training steps.

    Both scores are standardised :func:`kernel_regression`; combinesWith adds half the standardised
    :func:`completion`, a score for ingredient pairs by known pairs with the same result. Do not
    pass test recipes.
    """

    def __init__(
        self,
        graph: RecipeGraph,
        recipes: Ids,
        vectors: NDArray[np.floating] | None = None,
        **kwargs: Any,
    ):
        """Compute the score table from training recipes.

        Args:
            graph: the graph that the ids belong to.
            recipes: training recipes, ids (n, 3), such as ``split.recipes("train")``.
            vectors: the entities' word vectors, shape (E, D), zeros for unknown words; None for
                scores by recipes alone.
            kwargs: ``device`` and ``name``, as in ``Scorer``.

        Raises:
            ConfigError: if the graph is too large for a score table, or the vectors do not have a
                row for each entity.
        """
        size = graph.num_entities
        check_table("the recipe kernel", size)
        if vectors is not None and (vectors.ndim != 2 or len(vectors) != size):
            raise ConfigError(
                f"`vectors` have shape {vectors.shape}; expected {size:,} rows, a row per entity. "
                "Make vectors from the graph's labels, by make_features."
            )
        if vectors is None:
            text = torch.zeros(size, size)
        else:
            text = cosines(torch.tensor(vectors, dtype=torch.float32))
        kernel = similarity(recipes, text)
        completed = completion(recipes, size)
        scores = kernel_scores(recipes, kernel, completed)
        settings = {"name": "recipe kernel", **kwargs}
        super().__init__(torch.stack(scores), graph.entities, graph.hash, **settings)
