"""Confidence intervals of success rates, and statistics that compare agents trained with several seeds."""

from wordcraft_kg.statistics.clusters import bootstrap, interval
from wordcraft_kg.statistics.runs import (
    interquartile_mean,
    probability_of_improvement,
    probability_of_improvement_interval,
    stratified_bootstrap,
)
from wordcraft_kg.statistics.samples import Interval
from wordcraft_kg.statistics.scale import standardised
from wordcraft_kg.statistics.tasks import paired_difference, task_bootstrap, wilson_interval

__all__ = [
    "Interval",
    "bootstrap",
    "interquartile_mean",
    "interval",
    "paired_difference",
    "probability_of_improvement",
    "probability_of_improvement_interval",
    "standardised",
    "stratified_bootstrap",
    "task_bootstrap",
    "wilson_interval",
]
