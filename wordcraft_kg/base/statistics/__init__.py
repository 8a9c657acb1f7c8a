"""Confidence intervals of success rates, and statistics that compare agents trained with several seeds."""

from wordcraft_kg.base.statistics.clusters import bootstrap, interval
from wordcraft_kg.base.statistics.comparisons import holm, interval_p_value
from wordcraft_kg.base.statistics.correlation import correlation
from wordcraft_kg.base.statistics.profiles import performance_profile, performance_profile_band
from wordcraft_kg.base.statistics.runs import (
    interquartile_mean,
    probability_of_improvement,
    probability_of_improvement_interval,
    resampled_means,
    stratified_bootstrap,
)
from wordcraft_kg.base.statistics.samples import Interval
from wordcraft_kg.base.statistics.scale import standardised
from wordcraft_kg.base.statistics.tasks import crossed_bootstrap, paired_difference, task_bootstrap, wilson_interval

__all__ = [
    "Interval",
    "bootstrap",
    "correlation",
    "crossed_bootstrap",
    "holm",
    "interquartile_mean",
    "interval",
    "interval_p_value",
    "paired_difference",
    "performance_profile",
    "performance_profile_band",
    "probability_of_improvement",
    "probability_of_improvement_interval",
    "resampled_means",
    "standardised",
    "stratified_bootstrap",
    "task_bootstrap",
    "wilson_interval",
]
