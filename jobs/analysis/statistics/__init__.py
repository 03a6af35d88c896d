"""What a hundred runs say: location, spread, intervals, survival and comparisons, from the run rows alone.

The public names of the statistics in one list; each is explained where it is made.
"""

from __future__ import annotations

from jobs.analysis.statistics.bootstrap import (
    Estimate,
    bootstrap_curve,
    bootstrap_interval,
    bootstrap_of_means,
    bootstrap_of_runs,
    interquartile_mean,
    slope,
)
from jobs.analysis.statistics.comparison import PairedComparison, aligned, compare_paired, probability_of_improvement
from jobs.analysis.statistics.summary import summarise
from jobs.analysis.statistics.survival import SolvedShare, median_train_time, share_solved

__all__ = [
    "Estimate",
    "PairedComparison",
    "SolvedShare",
    "aligned",
    "bootstrap_curve",
    "bootstrap_interval",
    "bootstrap_of_means",
    "bootstrap_of_runs",
    "compare_paired",
    "interquartile_mean",
    "median_train_time",
    "probability_of_improvement",
    "share_solved",
    "slope",
    "summarise",
]
