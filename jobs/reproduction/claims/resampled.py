"""What a claim's statistic is, with its 95 % interval, and at which level that interval would leave a threshold out.

The two belong together: the level p of a threshold is that of the widest interval that has it not inside, so that p is
below 5 % where the 95 % interval lies on one side. Of n runs and B resamples, k of which lie on the threshold's other
side, p is `two_sided_level` of k / B. Where k = 0, p is no larger than that of one resample in B + 1, and that of the
t-test with the resamples' deviation if this is smaller: 10 000 resamples of 100 runs could not tell 0.0004 from less.
Never is p below 2¹⁻ⁿ, that of the sign test where all runs agree.

Sources: Hesterberg, T. C. (2015), *What teachers should know about the bootstrap*, The American Statistician 69(4);
Clopper, C. J. & Pearson, E. S. (1934), *The use of confidence or fiducial limits illustrated in the case of the
binomial*, Biometrika 26(4).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import scipy
from numpy.typing import NDArray

from apel.numerics.intervals import CONFIDENCE, expanded_levels, two_sided_level
from jobs.analysis.statistics.bootstrap import Estimate, Floats


class Found(Protocol):
    """A statistic of runs."""

    @property
    def estimate(self) -> Estimate[float]:
        """With its 95 % interval."""
        ...

    def level(self, threshold: float, *, is_above: bool) -> float:
        """The p of a threshold; ``is_above``: whether a statistic that is the threshold counts as above it."""
        ...


@dataclass(frozen=True)
class Resampled:
    """A statistic, and what it is of resamples of the runs.

    Of several comparisons it is the largest one. That it is below a threshold takes that all are, which needs no
    correction; that it is above, that any is, whose level is divided by their number (Bonferroni).

    Attributes
    ----------
    value:
        Of the runs.
    drawn:
        ``float64[resamples, comparisons]``.
    num_runs:
        Of them all.
    """

    value: float
    drawn: Floats
    num_runs: int

    @property
    def estimate(self) -> Estimate[float]:
        """With its interval: everything, where a resample has no finite value (a ratio to a spread of nothing)."""
        if not np.isfinite(self.drawn).all():
            return Estimate(self.value, -np.inf, np.inf)
        if self.num_runs < 2:
            return Estimate(self.value, self.value, self.value)
        one_of = (1 - CONFIDENCE) / self.drawn.shape[1]
        low = np.quantile(self.drawn, expanded_levels(self.num_runs, 1 - one_of)[0], axis=0)
        high = np.quantile(self.drawn, expanded_levels(self.num_runs)[1], axis=0)
        return Estimate(self.value, float(low.max()), float(high.max()))

    def level(self, threshold: float, *, is_above: bool) -> float:
        """As in `Found`; 1 where the interval is everything, or of one run."""
        if not np.isfinite(self.drawn).all() or self.num_runs < 2:
            return 1.0
        above = self.drawn >= threshold if is_above else self.drawn > threshold
        to_be_below = max(self._levels(above, threshold))
        to_be_above = self.drawn.shape[1] * min(self._levels(~above, threshold))
        return min(1.0, to_be_below, to_be_above)

    def _levels(self, beyond: NDArray[np.bool_], threshold: float) -> list[float]:
        """Of each comparison: p that it is not where these resamples of it are."""
        return [
            self._level(int(np.sum(on_other_side)), drawn, threshold)
            for on_other_side, drawn in zip(beyond.T, self.drawn.T, strict=True)
        ]

    def _level(self, num_beyond: int, drawn: Floats, threshold: float) -> float:
        if num_beyond:
            level = two_sided_level(self.num_runs, num_beyond / len(drawn))
        else:
            gap, deviation = abs(drawn.mean() - threshold), drawn.std()
            normal = float(scipy.special.ndtr(-gap / deviation)) if deviation > 0 else 0.0
            level = two_sided_level(self.num_runs, min(normal, 1 / (len(drawn) + 1)))
        return max(level, 2.0 ** (1 - self.num_runs))


@dataclass(frozen=True)
class CountedShare:
    """The share of runs that are of a kind, with the exact binomial interval (Clopper & Pearson 1934).

    >>> round(CountedShare([True] * 100).estimate.low, 3)
    0.964
    """

    meets: Sequence[bool] | NDArray[np.bool_]

    @property
    def estimate(self) -> Estimate[float]:
        """With its interval."""
        count, total = int(np.sum(self.meets)), len(self.meets)
        interval = scipy.stats.binomtest(count, total).proportion_ci(CONFIDENCE, method="exact")
        return Estimate(count / total, float(interval.low), float(interval.high))

    def level(self, threshold: float, *, is_above: bool) -> float:  # noqa: ARG002 - of shares the ends are never met
        """As twice the smaller tail."""
        count, total = int(np.sum(self.meets)), len(self.meets)
        tails = (scipy.stats.binom.cdf(count, total, threshold), scipy.stats.binom.sf(count - 1, total, threshold))
        return min(1.0, 2 * float(min(tails)))


def level_of(found: Found, bounds: tuple[float, float], *, are_inside: bool) -> float:
    """The p of a claim with these bounds: that of the bound whose side is less sure.

    Parameters
    ----------
    found:
        The statistic.
    bounds:
        Between them it is as claimed; an infinite one is none.
    are_inside:
        Whether the bounds themselves are as claimed.
    """
    sides = zip(bounds, (are_inside, not are_inside), strict=True)
    return max(found.level(bound, is_above=is_above) for bound, is_above in sides if np.isfinite(bound))
