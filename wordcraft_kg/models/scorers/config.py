"""Settings of scores: their common scale; imports no torch."""

from typing import Literal

Scale = Literal["standardise", "ranks", "log-softmax", "none"]
"""See :func:`~wordcraft_kg.models.scorers.scales.scaled_scorer`."""
SelfEdges = Literal["keep", "observed", "drop"]
"""What happens to an entity's combinesWith score with itself."""
