"""Settings of scores, limits on memory and estimates of it; this module imports no torch.

The page docs/limits.md says what a book of a given size takes.
"""

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
_FINISHED_BY_ENTITY = 200 * 8 + (32 + 40 + 64) * 12 + 6 * 4 * 256 + 2 * 128
"""Bytes of a finished set of lists by entity: neighbours, supporting recipes, factors, signatures.
"""
_FINISHED_BY_RECIPE = 320
"""Bytes of a finished set by recipe: hash tables, which a quarter to an eighth of the places fill.
"""
_BY_ENTITY = _FINISHED_BY_ENTITY + 4 * 256 + 2_000
"""Bytes of a set of lists by entity while it is made: coordinates, and profiles.
Measured for 60,000 entities: 13,200 with 5.8 recipes each."""
_BY_RECIPE = 450
"""Bytes of a set by recipe while it is made: profiles while neighbours are searched."""
_EXAMPLES = 4 * 8_000 * 55 * 45 * 4
"""Bytes of the features from which the rankers of a fit learn."""
_OF_ENCODER = 4 * (192 + 128 + 1)
"""Bytes of an entity's own vectors in a pair encoder, while it is fitted."""
_STEP = 300 * 2**20
"""Bytes of a step of its fit."""
_RESULTS = 2_000 * 128 * 2 * 55 * 4
"""Bytes of the features from which a ranker of results learns."""


def lists_bytes(num_entities: int, num_recipes: int, dim: int, workers: int) -> int:
    """Return the number of bytes of memory that a fit by neighbour lists takes, about.

    Args:
        num_entities: entities in the graph.
        num_recipes: training recipes.
        dim: length of a word vector.
        workers: sets of lists, and fits, that are made at once.
    """
    vector_bytes = 4 * dim
    unfinished = num_entities * (_BY_ENTITY + vector_bytes)
    unfinished += num_recipes * _BY_RECIPE
    # One more set than workers: that of the scorer which is being saved.
    finished = num_entities * (_FINISHED_BY_ENTITY + vector_bytes)
    finished += num_recipes * _FINISHED_BY_RECIPE
    return _PROGRAM + workers * (unfinished + _EXAMPLES) + finished


def encoder_bytes(num_entities: int, dim: int, workers: int, encoders: int) -> int:
    """Return the number of further bytes of memory that pair encoders take, about.

    Args:
        num_entities: entities in the graph.
        dim: length of a word vector.
        workers: encoders that are fitted at once.
        encoders: encoders in all.
    """
    # Each vector has two averages and a gradient, 4 arrays in all.
    vectors = 4 * num_entities * _OF_ENCODER
    fitted = workers * (vectors + _STEP + _RESULTS)
    # A finished encoder has half precision.
    finished = encoders * num_entities * _OF_ENCODER // 2
    # 4 bytes for a number of a word vector.
    words = 4 * num_entities * dim
    return fitted + finished + words


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
        num_bytes = lists_bytes(num_entities, num_recipes, dim, workers)
        if encoders:
            num_bytes += encoder_bytes(num_entities, dim, workers, encoders)
        if num_bytes <= available:
            return workers
    without_encoder = ", or `encoder` off" if encoders else ""
    raise ConfigError(
        f"a recipe scorer of {num_entities:,} entities and {num_recipes:,} recipes takes about "
        f"{num_bytes / 2**30:,.1f} GiB, and {available / 2**30:,.1f} GiB are there. Use shorter "
        f"word vectors, or a smaller graph{without_encoder}."
    )
