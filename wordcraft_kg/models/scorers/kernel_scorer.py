"""The recipe kernel as a scorer: a table where it fits, factors of low rank where it does not."""

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from wordcraft_kg.base.settings import whole
from wordcraft_kg.base.statistics import standardised
from wordcraft_kg.graphs.arrays import Ids
from wordcraft_kg.graphs.recipe_graph import RecipeGraph
from wordcraft_kg.graphs.triples import COMBINES_WITH, RELATIONS, recipe_triples
from wordcraft_kg.models.scorers.factors import FactorsScorer
from wordcraft_kg.models.scorers.kernel import (
    COMPLETION,
    completion,
    completion_paths,
    kernel_regression,
    link_matrices,
)
from wordcraft_kg.models.scorers.limits import TABLE_LIMIT, check_table, table_bytes
from wordcraft_kg.models.scorers.low_rank_kernel import Block, Term, factored_sum, two_step
from wordcraft_kg.models.scorers.similarity import cosines, similarity
from wordcraft_kg.models.scorers.similarity_rows import SimilarityRows, check_vectors
from wordcraft_kg.models.scorers.tables import TableScorer

RANK = 256
"""Factors of a large graph's scores in each relation."""
NAME = "recipe kernel"


class KernelScorer(TableScorer):
    """Links predicted in closed form from how alike entities are; nothing is trained.

    combinesWith is the standardised kernel regression plus half of the standardised completion, componentOf the
    standardised regression; see :mod:`~wordcraft_kg.models.scorers.kernel`. It sees recipes, not only their triples,
    so give it none that are held out.
    """

    def __init__(self, graph: RecipeGraph, recipes: Ids, vectors: NDArray[np.floating] | None = None, **kwargs: Any):
        """Score all triples.

        Args:
            graph: the graph of the ids.
            recipes: shape (n, 3), those that may be looked at, such as ``split.recipes("train")``.
            vectors: vectors of the entities' words, shape (E, D), zeros where there is none; None to do without.
            kwargs: ``device`` and ``name``.

        Raises:
            ConfigError: if the graph has too many entities, or the vectors are not of the graph.
        """
        size = graph.num_entities
        check_table("the recipe kernel as a table", size)
        check_vectors(vectors, size)
        alike = torch.zeros(size, size) if vectors is None else cosines(torch.tensor(vectors, dtype=torch.float32))
        scores = kernel_scores(recipes, similarity(recipes, alike))
        super().__init__(torch.stack(scores), graph.entities, graph.hash, **{"name": NAME, **kwargs})


def kernel_scores(
    recipes: Ids, kernel: torch.Tensor, seen: torch.Tensor | None = None
) -> tuple[torch.Tensor, torch.Tensor]:
    """Return the scores of all combinesWith and componentOf links by a kernel, two of shape (E, E), row = head.

    Only entities that are seen, by default all, are learned from and standardised by.
    """
    size = len(kernel)

    def scaled(table: torch.Tensor) -> NDArray[np.float64]:
        return standardised(table.numpy(), None if seen is None else seen.numpy())

    combines, component = (
        scaled(kernel_regression(kernel, links, seen=seen)) for links in link_matrices(recipes, size)
    )
    combines += COMPLETION * scaled(completion(recipes, size))
    return torch.from_numpy(combines).float(), torch.from_numpy(component).float()


class LowRankKernelScorer(FactorsScorer):
    """What :class:`KernelScorer` does, for graphs whose table of scores would be too large: factors of low rank.

    The regression is the one in two steps, ``P Y P`` with ``P = K (K + λ)⁻¹``, because sparse products and conjugate
    gradients are enough for it. It and the completion are scaled by their root mean square, and their sum is factored
    by a seeded randomised singular value decomposition. Of the scores themselves it is the best approximation of that
    rank, up to what the random directions miss; cutting the kernel instead, whose spectrum is flat, would lose more.
    What is lost may differ between (a, b) and (b, a), so combinesWith is only nearly symmetric.
    """

    def __init__(
        self,
        graph: RecipeGraph,
        recipes: Ids,
        vectors: NDArray[np.floating] | None = None,
        *,
        rank: int = RANK,
        seed: int = 0,
        **kwargs: Any,
    ):
        """Factor the scores of each relation.

        Args:
            graph: the graph of the ids.
            recipes: shape (n, 3), those that may be looked at.
            vectors: vectors of the entities' words, shape (E, D); None to do without.
            rank: number of factors, at most E.
            seed: seed of the random directions.
            kwargs: ``device`` and ``name``.

        Raises:
            ConfigError: if a number is out of range, or the vectors are not of the graph.
        """
        from scipy import sparse

        size = graph.num_entities
        whole("rank", rank, 1)
        kernel = SimilarityRows.of(recipes, size, vectors)
        nodes, pairs = (matrix.astype(np.float32) for matrix in completion_paths(recipes, size))

        def paths(block: Block) -> Block:
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
    """Return the recipe kernel of some recipes: a table where it fits :data:`TABLE_LIMIT`, factors above.

    Example:
        >>> opened = open_graph("kitchen")
        >>> vectors = make_features("glove", opened.graph.entities).vectors
        >>> scorer = kernel_scorer(opened.graph, opened.split.recipes("train"), vectors)
        >>> scorer.name
        'recipe kernel'
    """
    kind = KernelScorer if table_bytes(graph.num_entities) <= TABLE_LIMIT else LowRankKernelScorer
    return kind(graph, recipes, vectors, **kwargs)
