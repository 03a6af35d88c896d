"""At which levels to read an interval off a bootstrap's resamples, so that it is wide enough also of a few runs.

Of n runs the plain percentile interval is too narrow twice: resamples vary by the runs' variance times (n − 1) / n, and
their quantiles are those of a normal distribution where Student's are due. Reading it further out mends both, whatever
the statistic is.

Source: Hesterberg, T. C. (2015), *What teachers should know about the bootstrap*, The American Statistician 69(4), 4.2.
"""

from __future__ import annotations

import math

import scipy  # which imports its `special` itself where it is first used

CONFIDENCE = 0.95


def expanded_levels(num_runs: int, confidence: float = CONFIDENCE) -> tuple[float, float]:
    """Of the expanded percentile interval: Φ(−√(n / (n − 1)) t₁₋ₐ), with n − 1 degrees of freedom, and its complement.

    Parameters
    ----------
    num_runs:
        n, at least 2: what is resampled, in the smaller of several samples.
    confidence:
        1 − 2 a.

    Examples
    --------
    >>> [round(expanded_levels(count)[0], 4) for count in (5, 10, 20, 100)]
    [0.001, 0.0086, 0.0159, 0.0231]
    """
    quantile = -scipy.special.stdtrit(num_runs - 1, (1 - confidence) / 2)
    low = float(scipy.special.ndtr(-math.sqrt(num_runs / (num_runs - 1)) * quantile))
    return low, 1 - low


def two_sided_level(num_runs: int, share: float) -> float:
    """The other way round: 1 − confidence of the expanded interval one end of which leaves ``share`` of the resamples.

    Parameters
    ----------
    num_runs:
        n, at least 2.
    share:
        Of the resamples beyond the end, at most one half.

    Examples
    --------
    >>> round(two_sided_level(20, expanded_levels(20)[0]), 6)
    0.05
    """
    quantile = scipy.special.ndtri(share) * math.sqrt((num_runs - 1) / num_runs)
    return float(2 * scipy.special.stdtr(num_runs - 1, quantile))
