"""Confidence intervals for success rates, and statistics that compare agents trained with several seeds.

Common arguments: ``level`` is the confidence, between 0 and 1; ``draws`` is the number of resamples, from 1; ``seed``
fixes the resampling. Every function raises a ConfigError for scores that are empty, not finite or misshapen, and for
settings out of range.
"""

from wordcraft_kg.base.statistics.comparisons import correlation, holm, interval_p_value
from wordcraft_kg.base.statistics.runs import (
    FEWEST_PAIRS,
    resampled_means,
    student_interval,
)
from wordcraft_kg.base.statistics.samples import RESAMPLES, Interval, bootstrap, interval, standardised
from wordcraft_kg.base.statistics.tasks import crossed_bootstrap, paired_difference, task_bootstrap, wilson_interval

__all__ = [
    "FEWEST_PAIRS",
    "RESAMPLES",
    "Interval",
    "bootstrap",
    "correlation",
    "crossed_bootstrap",
    "holm",
    "interval",
    "interval_p_value",
    "paired_difference",
    "resampled_means",
    "standardised",
    "student_interval",
    "task_bootstrap",
    "wilson_interval",
]
