"""Whether differences are more than chance, and what many of them at once are worth."""

from collections.abc import Sequence
from statistics import NormalDist

from wordcraft_kg.base.errors import ConfigError
from wordcraft_kg.base.statistics.samples import check_level


def interval_p_value(value: float, interval: tuple[float, float], *, level: float = 0.95) -> float:
    """Return the two-sided p-value that belongs to an interval: of the hypothesis that the true value is 0.

    An interval of a level is as wide as ``2 z`` standard errors, so ``p = 2 (1 - Phi(|value| / (width / 2 z)))``. Of a
    bootstrap interval that is Wald's test with the bootstrap's standard error; it is about .05 where the interval just
    reaches 0, and shares the faults of the interval: it is too small where that is too narrow, as with few seeds. An
    exact test over runs alone would be of no use here: with 5 seeds its p-value is never below .0079, which any
    correction for a dozen comparisons takes above .05.

    Args:
        value: estimate of the difference.
        interval: its lower and upper bound; of zero width if nothing varies.
        level: of confidence of the interval.

    Raises:
        ConfigError: if the level is out of range.

    Source: Efron and Tibshirani 1993, "An introduction to the bootstrap", section 12.
    """
    check_level(level)
    z = NormalDist().inv_cdf((1 + level) / 2)
    error = (interval[1] - interval[0]) / (2 * z)
    if error == 0:
        return 1.0 if value == 0 else 0.0
    return 2 * NormalDist().cdf(-abs(value) / error)


def holm(p_values: Sequence[float]) -> list[float]:
    """Return p-values corrected for their number: rejecting those below .05 errs at all in at most 5 % of all studies.

    With the m values in ascending order, ``p'_(i) = max_(j <= i) min(1, (m - j + 1) p_(j))``. It holds whatever the
    dependence between the comparisons, and rejects all that Bonferroni's correction rejects.

    Raises:
        ConfigError: if a value is not from 0 to 1.

    Source: Holm 1979, "A simple sequentially rejective multiple test procedure".
    """
    for value in p_values:
        if not 0 <= value <= 1:
            raise ConfigError(f"p-value {value}: expected a number from 0 to 1.")
    corrected, highest = [0.0] * len(p_values), 0.0
    for rank, i in enumerate(sorted(range(len(p_values)), key=p_values.__getitem__)):
        highest = max(highest, min(1.0, (len(p_values) - rank) * p_values[i]))
        corrected[i] = highest
    return corrected
