"""Settings of scores, limits on memory and estimates of it; this module imports no torch.

The page docs/limits.md says what a book of a given size takes.
"""

from typing import Literal

from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.base.settings import memory
from wordcraft_kg.graphs.triples import RELATIONS

Scale = Literal["standardise", "ranks", "none"]
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


def has_table(num_entities: int) -> bool:
    """Return whether a score table for so many entities has room, see :data:`TABLE_LIMIT`."""
    return table_bytes(num_entities) <= TABLE_LIMIT


def check_table(what: str, num_entities: int) -> None:
    """Check that a score table for so many entities is not too large; the error gives the size.

    ``what`` names the scorer in the error.

    Raises:
        ConfigError: if the table would take more than :data:`TABLE_LIMIT` bytes.
    """
    if not has_table(num_entities):
        num_bytes = table_bytes(num_entities)
        raise ConfigError(
            f"{what} needs a score table for {num_entities:,} entities, {num_bytes / 2**30:,.1f} "
            f"GiB; expected at most {TABLE_LIMIT / 2**30:.2f} GiB. Use a smaller graph."
        )


# --- a fit of recipe scorers ----------------------------------------------------------------------

_PROGRAM = 1_200 * 2**20
"""Memory for Python, torch, SciPy, compiled loops, and queries that wait for their fit."""
_BY_ENTITY = 12_700
"""Bytes of a set of lists by entity while it is made, without word vectors.
Measured for 60,000 entities: 13,200 with 5.8 recipes each."""
_BY_RECIPE = 450
"""Bytes of a set by recipe while it is made: profiles while neighbours are searched."""
_FINISHED = 0.75
"""Share that a finished set keeps."""
_EXAMPLES = 4 * 8_000 * 55 * 45 * 4
"""Bytes of the features from which the rankers of a fit learn."""
_OF_ENCODER = 4 * (192 + 128 + 1)
"""Bytes of an entity's own vectors in a pair encoder, while it is fitted."""
_STEP = 410 * 2**20
"""Bytes of a step of its fit, and of the features from which a ranker of results learns."""


def fitting_bytes(
    num_entities: int,
    num_recipes: int,
    dim: int,
    workers: int,
    encoders: int = 0,
) -> int:
    """Return the number of bytes of memory that the fits of a recipe scorer take, about.

    Args:
        num_entities: entities in the graph.
        num_recipes: training recipes.
        dim: length of a word vector.
        workers: sets of lists, encoders and fits that are made at once.
        encoders: pair encoders in all.
    """
    vector_bytes = 4 * dim * num_entities
    lists = num_entities * _BY_ENTITY + vector_bytes + num_recipes * _BY_RECIPE
    # One more set than workers: that of the scorer which is being saved.
    num_bytes = _PROGRAM + workers * _EXAMPLES + int((workers + _FINISHED) * lists)
    if encoders:
        own = num_entities * _OF_ENCODER
        # A vector that is fitted has two averages and a gradient; a finished one is rounded to
        # half.
        num_bytes += vector_bytes + workers * (4 * own + _STEP) + encoders * own // 2
    return num_bytes


def fitting_workers(
    num_entities: int,
    num_recipes: int,
    dim: int,
    most: int,
    encoders: int = 0,
) -> int:
    """Return how many sets of lists may be made at once: fewer where memory is short.

    Args:
        num_entities: entities in the graph.
        num_recipes: training recipes.
        dim: length of a word vector.
        most: largest number, such as that of the cores.
        encoders: number of pair encoders.

    Raises:
        ConfigError: if there is no room for one; names the needed and the available memory.
    """
    available = memory()
    for workers in range(most, 0, -1):
        num_bytes = fitting_bytes(num_entities, num_recipes, dim, workers, encoders)
        if num_bytes <= available:
            return workers
    raise ConfigError(
        f"a recipe scorer of {num_entities:,} entities and {num_recipes:,} recipes takes about "
        f"{num_bytes / 2**30:,.1f} GiB, and {available / 2**30:,.1f} GiB are there. Use shorter "
        "word vectors, or a smaller graph."
    )
