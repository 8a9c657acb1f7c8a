"""Confidence intervals of success rates."""

import math
from statistics import NormalDist

from wordcraft_kg.errors import ConfigError


def wilson_interval(successes: int, n: int, level: float = 0.95) -> tuple[float, float]:
    """Return the score interval of a success probability.

    The probabilities p that a two-sided normal test does not refuse, ``|k/n - p| <= z * sqrt(p (1 - p) / n)``:
    ``(k + z²/2 ± z * sqrt(k (n - k) / n + z²/4)) / (n + z²)``. It stays within 0 and 1, and has a width for k = 0 and
    k = n too.

    Args:
        successes: k, from 0 to ``n``.
        n: number of independent trials, from 1.
        level: of confidence, between 0 and 1.

    Raises:
        ConfigError: for a value out of range.

    Source: Wilson 1927, "Probable inference, the law of succession, and statistical inference".
    """
    if not 0 <= successes <= n or n < 1:
        raise ConfigError(f"{successes} successes of {n}: expected at least one trial, and 0 to {n} successes.")
    if not 0 < level < 1:
        raise ConfigError(f"level {level}: expected more than 0 and less than 1, such as 0.95.")
    z = NormalDist().inv_cdf((1 + level) / 2)
    middle = successes + z**2 / 2
    half = z * math.sqrt(successes * (n - successes) / n + z**2 / 4)
    # The bounds at k = 0 and k = n are exact; rounding must not move them.
    low = (middle - half) / (n + z**2) if successes else 0.0
    high = (middle + half) / (n + z**2) if successes < n else 1.0
    return low, high
