"""The interval for a mean over several splits of one book, for scripts beside it."""

import math
from statistics import NormalDist

from numpy.typing import ArrayLike
from scipy.special import stdtrit

from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.base.statistics import finite

LEVEL = 0.95
Z = NormalDist().inv_cdf((1 + LEVEL) / 2)


def split_interval(
    scores: ArrayLike, errors: ArrayLike, *, within: tuple[float, float] = (0.0, 1.0)
) -> tuple[float, float]:
    """Return the interval for the mean score over splits of a book.

    It is never narrower than the task noise of a split. ``mean ± h``: with s the sample deviation
    of the S scores and e² the mean squared standard error of a score within its split, h² is the
    larger of Student's ``t²_(S-1) s² / S`` and ``t²_(S-1) max(s² - e², 0) / S + z² e²``. Three
    scores may be alike by chance, and Student's t alone is then narrower than the noise of the
    tasks in each. The noise e is not divided by S: splits share a book, so their test parts overlap
    and their trainings share most recipes. A single split has the noise of its tasks.

    Args:
        scores: a score for each split, shape (S,).
        errors: standard error of each score within its split, shape (S,), such as ``sqrt(p (1 - p)
            / n)``.
        within: lowest and highest possible value, to which the interval is cut.

    Returns:
        lower and upper bound.

    Raises:
        ConfigError: if there is no score, a number is not finite, or there is not one error for
            each score.

    Source: the variance between splits as in DerSimonian and Laird 1986, "Meta-analysis in clinical
    trials"; added to the variance within as in Howe 1974; Nadeau and Bengio 2003, "Inference for
    the generalization error", on splits of the same data, whose mean varies more than that of
    independent samples.
    """
    values = finite("scores", scores).ravel()
    noise = finite("errors", errors).ravel()
    if len(values) != len(noise):
        raise ConfigError(
            f"{len(noise)} errors of {len(values)} scores: expected an error for each."
        )
    shared = float((noise**2).mean())
    half = Z * math.sqrt(shared)
    if len(values) > 1:
        number = len(values)
        t = float(stdtrit(number - 1, (1 + LEVEL) / 2))
        varied = float(values.var(ddof=1))
        between = t**2 * max(varied - shared, 0.0) / number
        summed = math.sqrt(between + half**2)
        students = t * math.sqrt(varied / number)
        half = max(summed, students)
    mean = float(values.mean())
    lowest, highest = within
    return max(mean - half, lowest), min(mean + half, highest)
