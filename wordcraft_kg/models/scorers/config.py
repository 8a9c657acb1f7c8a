"""Settings and limits of scores; imports no torch."""

from typing import Literal

from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.graphs.triples import RELATIONS

Scale = Literal["standardise", "ranks", "log-softmax", "none"]
"""See :func:`~wordcraft_kg.models.scorers.scales.scaled_scorer`."""
SelfEdges = Literal["keep", "observed", "drop"]
"""What happens to an entity's combinesWith score with itself."""
MAX_QUERIES = 40_000
"""Queries that are ranked by default; of more, a uniform sample is."""

TABLE_LIMIT = 2**28
"""Bytes. Up to this size all scores are computed once and looked up; above it they come from the embeddings."""


def table_bytes(num_entities: int) -> int:
    """Return the size of a table of all scores."""
    return len(RELATIONS) * num_entities**2 * 4


def check_table(what: str, num_entities: int) -> None:
    """Refuse what needs the scores of all pairs where they are too many.

    Raises:
        ConfigError: saying how large the table would be.
    """
    needed = table_bytes(num_entities)
    if needed > TABLE_LIMIT:
        raise ConfigError(
            f"{what} needs the scores of all pairs of {num_entities:,} entities, {needed / 2**30:,.1f} GiB; "
            f"expected at most {TABLE_LIMIT / 2**30:.2f} GiB. Take a smaller graph."
        )


MAX_DENSE = 4_000
"""Entities up to which kernels are dense: about twenty tables of all pairs are held at once, and E³ operations done."""


def check_dense(what: str, num_entities: int) -> None:
    """Refuse what needs dense kernels where the graph is too large for them.

    Raises:
        ConfigError: saying how many entities there are.
    """
    if num_entities > MAX_DENSE:
        raise ConfigError(
            f"{what} compares each two of {num_entities:,} entities; expected at most {MAX_DENSE:,}. Take ComplEx "
            "(wordcraft-kg train-complex), or a smaller graph."
        )
