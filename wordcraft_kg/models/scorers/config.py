"""Settings of scores, and limits on memory; this module imports no torch."""

from typing import Literal

from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.base.settings import memory
from wordcraft_kg.graphs.triples import RELATIONS

Scale = Literal["standardise", "ranks", "log-softmax", "none"]
"""See :func:`~wordcraft_kg.models.scorers.scales.scaled_table`."""
SelfEdges = Literal["keep", "observed", "drop"]
"""Treatment of combinesWith self edges."""
MAX_QUERIES = 40_000
"""Default number of ranked queries; larger sets are sampled."""

TABLE_LIMIT = 2**28
"""Bytes in the largest score table; larger graphs need a scorer with matrix factors."""


def table_bytes(num_entities: int) -> int:
    """Return the bytes in a score table: all entity pairs in both relations, 32 bits each."""
    return len(RELATIONS) * num_entities**2 * 4


def check_table(what: str, num_entities: int) -> None:
    """Raise ConfigError, which gives the size, if a score table for so many entities is too large.

    ``what`` names the scorer in the error.
    """
    needed = table_bytes(num_entities)
    if needed > TABLE_LIMIT:
        raise ConfigError(
            f"{what} needs a score table for {num_entities:,} entities, {needed / 2**30:,.1f} "
            f"GiB; expected at most {TABLE_LIMIT / 2**30:.2f} GiB. Use a smaller graph."
        )


DENSE_TABLES = 60
"""Tables of all entity pairs that a computation of link features has in memory at once, about."""
_PROGRAM_BYTES = 450 * 2**20
"""Memory for Python, torch and SciPy, with their first use."""
_TABLES_PER_FOLD = 4
"""Tables that a fit keeps of each fold.

``kernel``, ``completed``, ``pairs`` and ``parts`` of ``recipes.base.Base``.
"""
_QUERY_BYTES = 300 * (14 * 4 + 2 + 2 * (18 * 4 + 2))
"""By entity and fold.

300 queries for each side of a relation, with 14 features for pairs and 18 for parts in single
precision, and two masks.
"""
_SAMPLE_BYTES = (14 + 18) * 4
"""By sampled cell and fold: features whose mean and deviation scale the rankers' inputs."""
_HEAP = 1.75
"""Resident bytes by byte of queries and samples.

The fits between them leave holes that larger blocks do not fill. Measured with 500 to
2,000 entities: expected by peak memory is .92 to 1.03.
"""
_EXAMPLE_BYTES = 4 * 2 * (78 * 17 * 4)
"""Bytes by recipe.

17 features of the 78 pairs on two tables of 12 slots in single precision, in four copies.
"""


def dense_bytes(num_entities: int) -> int:
    """Return the number of bytes of memory for link features of all entity pairs, about."""
    return DENSE_TABLES * 4 * num_entities**2


def fit_bytes(num_entities: int, num_recipes: int, folds: int) -> int:
    """Return the number of bytes of memory that a process takes to fit a recipe scorer, about.

    Measured by ``benchmarks/memory_estimates.py``.

    Args:
        num_entities: number of entities in the graph.
        num_recipes: number of training recipes.
        folds: number of folds whose features are in memory at once.

    Returns:
        Bytes: the larger of the two steps that take most, which fit the link rankers and the recipe
        ranker.
    """
    cells = num_entities**2
    tables = (DENSE_TABLES + _TABLES_PER_FOLD * folds) * 4 * cells
    # Each fold gives queries, and so do the entities that are held out.
    sampled_cells = min(cells // 7, 2**20)
    queries = (folds + 1) * (_QUERY_BYTES * num_entities + _SAMPLE_BYTES * sampled_cells)
    return _PROGRAM_BYTES + tables + max(round(_HEAP * queries), _EXAMPLE_BYTES * num_recipes)


def check_dense(what: str, num_entities: int, needed: int | None = None) -> None:
    """Raise ConfigError if computations with all entity pairs do not fit into memory.

    Args:
        what: name of the scorer or data for the message.
        num_entities: number of entities.
        needed: expected bytes of memory; None for :func:`dense_bytes`.
    """
    if needed is None:
        needed = dense_bytes(num_entities)
    available = memory()
    if needed > available:
        raise ConfigError(
            f"{what} compares all pairs of {num_entities:,} entities, which takes "
            f"{needed / 2**30:,.1f} GiB, and {available / 2**30:,.1f} GiB are there. "
            "Use ComplEx (wordcraft-kg train-complex), whose scores u and v need no such tables, "
            "or a smaller graph."
        )
