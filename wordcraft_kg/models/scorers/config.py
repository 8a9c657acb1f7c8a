"""Settings of scores, and limits on memory; this module imports no torch."""

from typing import Literal

from wordcraft_kg.base.errors import ConfigError
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
        needed = table_bytes(num_entities)
        raise ConfigError(
            f"{what} needs a score table for {num_entities:,} entities, {needed / 2**30:,.1f} "
            f"GiB; expected at most {TABLE_LIMIT / 2**30:.2f} GiB. Use a smaller graph."
        )
