"""Correlation of two figures of the same cells, with its interval."""

from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.base.settings import MAX_SIZE, one_of, whole
from wordcraft_kg.base.statistics.samples import Interval, Scores, check_level, finite

Kind = Literal["pearson", "spearman"]
LEAST = 3
"""Fewest points: two lie on a line always."""


def correlation(
    x: ArrayLike, y: ArrayLike, kind: Kind = "pearson", *, level: float = 0.95, draws: int = 2000, seed: int = 0
) -> Interval | None:
    """Return the correlation of two figures over cells, and its bootstrap interval, resampling whole cells.

    Pearson's measures how near the points are to a line, Spearman's, which is Pearson's of the ranks (ties share their
    mean rank), how near y is to rising with x. A resample in which all x or all y are equal says nothing and is left
    out. With fewer than about ten cells the interval is rough.

    Args:
        x: shape (N cells,).
        y: shape (N cells,).
        kind: pearson or spearman.
        level: of confidence, between 0 and 1.
        draws: resamples, from 1.
        seed: of the resampling.

    Returns:
        Correlation, lower and upper bound; None for fewer than 3 cells, or if all x or all y are equal.

    Raises:
        ConfigError: if figures are missing, not finite or of another shape, or a setting is out of range.

    Source: Efron and Tibshirani 1993, "An introduction to the bootstrap", section 6.5.
    """
    check_level(level)
    one_of("kind", kind, ("pearson", "spearman"))
    draws, seed = whole("draws", draws, 1, MAX_SIZE), whole("seed", seed, 0)
    a, b = finite("x", x), finite("y", y)
    if a.ndim != 1 or a.shape != b.shape:
        raise ConfigError(f"x of shape {a.shape} and y of shape {b.shape}: expected one number for each cell.")
    if len(a) < LEAST or np.ptp(a) == 0 or np.ptp(b) == 0:
        return None
    rows = np.vstack([np.arange(len(a)), np.random.default_rng(seed).integers(len(a), size=(draws, len(a)))])
    drawn_a, drawn_b = a[rows], b[rows]
    if kind == "spearman":
        from scipy.stats import rankdata

        drawn_a, drawn_b = rankdata(drawn_a, axis=1), rankdata(drawn_b, axis=1)
    varied = (np.ptp(drawn_a, axis=1) > 0) & (np.ptp(drawn_b, axis=1) > 0)
    found = _pearson(drawn_a[varied], drawn_b[varied])
    resampled = found[1:] if len(found) > 1 else found
    low, high = np.quantile(resampled, [(1 - level) / 2, (1 + level) / 2])
    return float(found[0]), float(low), float(high)


def _pearson(x: Scores, y: Scores) -> Scores:
    """Return the correlation of each row: shapes (D, N) and (D, N) to (D,)."""
    x, y = x - x.mean(axis=1, keepdims=True), y - y.mean(axis=1, keepdims=True)
    products = (x * y).sum(axis=1) / np.sqrt((x**2).sum(axis=1) * (y**2).sum(axis=1))
    return np.asarray(np.clip(products, -1, 1))
