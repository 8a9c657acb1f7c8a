"""Statistics over several training runs with different seeds for one agent."""

import numpy as np
from numpy.typing import ArrayLike

from wordcraft_kg.base.statistics.samples import RESAMPLES, Scores, by_task, check_level, finite, generator

FEWEST_PAIRS = 3
"""Fewest seeds for a p-value: two seeds say nothing about variation between seeds."""


def student_interval(
    scores: ArrayLike, *, level: float = 0.95, within: tuple[float, float] = (0.0, 1.0)
) -> tuple[float, float] | None:
    """Return Student's t interval for the mean score over seeds, shape (S,); None for a single seed.

    ``mean ± t_(S-1) s / sqrt(S)``, with the scores' sample deviation s, cut to the possible values ``within``. A
    bootstrap fails for few seeds: resampling 3 seeds gives [minimum, maximum], which covers the true mean with
    probability .68 instead of .95, and with 2 seeds .48.

    Source: Student 1908, "The probable error of a mean".
    """
    from scipy.stats import t

    check_level(level)
    values = finite("scores", scores).ravel()
    if len(values) == 1:
        return None
    mean, (lowest, highest) = float(values.mean()), within
    half = float(t.ppf((1 + level) / 2, len(values) - 1) * values.std(ddof=1) / len(values) ** 0.5)
    return max(mean - half, lowest), min(mean + half, highest)


def resampled_means(scores: ArrayLike, *, draws: int = RESAMPLES, seed: int = 0) -> Scores:
    """Return bootstrap means over runs, shape (draws, K), for scores with shape (S runs, K), such as learning curves.

    Whole rows (runs) are drawn with replacement, so a run's K values stay together.
    """
    draws, rng = generator(0.95, draws, seed)
    table = by_task("scores", scores, "(runs, values)")
    size = len(table)
    return np.asarray(rng.multinomial(size, np.full(size, 1 / size), size=draws) @ table / size)
