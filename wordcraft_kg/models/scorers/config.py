"""Settings of scores: their common scale, and how many queries judge them; imports no torch."""

from typing import Literal

Scale = Literal["standardise", "ranks", "log-softmax", "none"]
"""See :func:`~wordcraft_kg.models.scorers.scales.scaled_scorer`."""
SelfEdges = Literal["keep", "observed", "drop"]
"""What happens to an entity's combinesWith score with itself."""
MAX_QUERIES = 40_000
"""Queries that are ranked by default; of more, a uniform sample is."""
