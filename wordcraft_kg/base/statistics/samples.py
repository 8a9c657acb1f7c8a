"""Tables of scores: what they may be, and how they are resampled."""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.base.settings import MAX_SIZE, refuse, whole

Interval = tuple[float, float, float]
"""A value, its lower and its upper bound."""
Scores = NDArray[np.float64]
# Values held at once while resampling: 8 MB of them, whatever the number of draws.
CHUNK = 2**20


def percentiles(
    samples: list[Scores], statistic: Callable[..., Any], cost: int, level: float, draws: int, seed: int
) -> tuple[float, float] | None:
    """Return percentile bounds of a statistic of resampled samples, each (draws, S, K); ``cost``: values per draw."""
    check_level(level)
    draws = whole("draws", draws, 1, MAX_SIZE)
    rng = np.random.default_rng(whole("seed", seed, 0))
    if any(len(sample) == 1 for sample in samples):
        return None
    chunk = max(1, CHUNK // cost)
    values = np.empty(draws)
    for start in range(0, draws, chunk):
        count = min(chunk, draws - start)
        rows = [rng.integers(len(sample), size=(count, *sample.shape)) for sample in samples]
        drawn = [np.take_along_axis(s[None], row, axis=1) for s, row in zip(samples, rows, strict=True)]
        result = np.asarray(statistic(*drawn))
        if result.shape != (count,):
            raise ConfigError(
                f"the statistic gave shape {result.shape} for {count} draws: expected one number per draw, as np.mean "
                "gives over the axes passed to it."
            )
        values[start : start + count] = result
    low, high = np.quantile(values, [(1 - level) / 2, (1 + level) / 2])
    return float(low), float(high)


def check_level(level: float) -> None:
    """Refuse a level of confidence that is not between 0 and 1."""
    if not 0 < level < 1:
        raise refuse("level", level, "more than 0 and less than 1, such as 0.95")


def finite(name: str, values: ArrayLike) -> Scores:
    """Return values as an array; refuse none at all, and any that is not finite."""
    try:
        array = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise ConfigError(f"{name}: expected a table of numbers with rows of the same length.") from None
    if not array.size:
        raise ConfigError(f"{name} of shape {array.shape}: expected at least one value.")
    if not np.isfinite(array).all():
        place = np.argwhere(~np.isfinite(array))[0].tolist()
        raise ConfigError(f"{name}{place}: {array[tuple(place)]}, expected finite numbers only.")
    return array


def by_seed(name: str, values: ArrayLike) -> Scores:
    """Return scores as (seeds, strata); refuse another shape."""
    array = finite(name, values)
    if array.ndim not in (1, 2):
        raise ConfigError(f"{name} of shape {array.shape}: expected (seeds, strata), or (seeds,) for one stratum.")
    return array if array.ndim == 2 else array[:, None]


def pair(x: ArrayLike, y: ArrayLike) -> tuple[Scores, Scores]:
    """Return the scores of two agents as (seeds, strata) each; refuse different strata."""
    a, b = by_seed("x", x), by_seed("y", y)
    if a.shape[1] != b.shape[1]:
        raise ConfigError(f"x has {a.shape[1]} strata and y {b.shape[1]}: expected the same strata in the same order.")
    return a, b
