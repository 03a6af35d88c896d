"""The bootstrap against numbers worked by hand, against scipy's on one column, and against its definition."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy import stats

from apel.numerics.intervals import expanded_levels
from jobs.analysis.statistics.bootstrap import (
    Floats,
    Location,
    bootstrap_curve,
    bootstrap_interval,
    bootstrap_of_means,
    bootstrap_of_runs,
    interquartile_mean,
    slope,
)

LOCATIONS: list[Location] = ["mean", "median", "interquartile_mean"]
FEW = 500
curves = st.tuples(st.integers(1, 12), st.integers(1, 3)).flatmap(
    lambda shape: arrays(np.float64, shape, elements=st.integers(-1000, 1000).map(lambda number: number / 8))
)


def test_interquartile_mean_by_hand() -> None:
    """Of eight values the two smallest and the two largest fall away: (3 + 4 + 5 + 6) / 4."""
    assert interquartile_mean(np.array([6.0, 1, 100, 3, 5, 2, 90, 4])) == 4.5


def test_interval_of_equal_values_is_a_point() -> None:
    """Without spread there is nothing to resample; 0.1 ten times over sums to less than 1, which does not show."""
    assert bootstrap_interval(np.full(10, 0.1)) == (0.1, 0.1)
    assert bootstrap_interval(np.array([7.0])) == (7.0, 7.0)


def test_interval_of_two_values_by_hand() -> None:
    """Of 0 and 1 a resample has the mean 0, ½, 1 with probability ¼, ½, ¼: more than 2.5 % lie at either end."""
    assert bootstrap_interval(np.array([0.0, 1.0])) == (0.0, 1.0)


def test_interval_of_a_share_by_hand() -> None:
    """Half of 100 runs are 1: the resampled count is binomial(100, ½), whose 2.5 % and 97.5 % points are 40 and 60."""
    low, high = bootstrap_interval(np.repeat([0.0, 1.0], 50))
    assert low == pytest.approx(stats.binom(100, 0.5).ppf(0.025) / 100, abs=0.01)
    assert high == pytest.approx(0.60, abs=0.01)


def test_interval_is_that_of_the_normal_approximation() -> None:
    """For many values the interval of the mean is mean ± 1.97 standard errors, to a tenth of one."""
    values = np.random.default_rng(1).normal(10, 2, 400)
    error = values.std(ddof=1) / 20
    low, high = bootstrap_interval(values)
    assert low == pytest.approx(values.mean() - 1.97 * error, abs=0.1 * error * 1.5)
    assert high == pytest.approx(values.mean() + 1.97 * error, abs=0.1 * error * 1.5)


def test_interval_of_ten_values_is_students() -> None:
    """Of normal values it is mean ± 2.262 s / √10, as Student's, not ± 1.96 √0.9 s / √10 as the plain percentiles."""
    values = stats.norm.ppf((np.arange(10) + 0.5) / 10)
    reach = 2.262 * values.std(ddof=1) / np.sqrt(10)
    assert bootstrap_interval(values) == pytest.approx((-reach, reach), abs=0.05 * reach)


@settings(deadline=None)
@given(st.lists(st.floats(0, 5000), min_size=2, max_size=30))
def test_interval_holds_the_mean(values: list[float]) -> None:
    """The interval lies within the values and around their mean."""
    low, high = bootstrap_interval(np.array(values))
    slack = 1e-9 * (1 + max(values))
    assert min(values) - slack <= low <= np.mean(values) + slack
    assert np.mean(values) - slack <= high <= max(values) + slack


@pytest.mark.parametrize("location", LOCATIONS)
@pytest.mark.parametrize("num_runs", [2, 3, 5, 8, 100])
def test_curve_is_scipys_column_by_column(location: Location, num_runs: int) -> None:
    """With the same generator and levels, batches, sorting and the shared resample change no column's interval."""
    reference = {
        "mean": np.mean,
        "median": np.median,
        "interquartile_mean": lambda values, axis: stats.trim_mean(values, 0.25, axis=axis),
    }[location]
    values = np.random.default_rng(2).normal(size=(num_runs, 7))
    low, high = expanded_levels(num_runs)
    found = bootstrap_curve(values, location, num_resamples=1000, seed=3)
    for column in range(7):
        theirs = stats.bootstrap(
            (values[:, column],),
            reference,
            n_resamples=1000,
            confidence_level=high - low,
            method="percentile",
            rng=np.random.default_rng(3),
        ).confidence_interval
        expected = [reference(values[:, column], axis=-1), theirs.low, theirs.high]
        assert [part[column] for part in found] == pytest.approx(expected, abs=1e-12)


def test_interval_is_scipys_with_another_generator() -> None:
    """Two sets of 10 000 resamples differ by Monte Carlo error: √2 · 2.7 standard errors / √10 000, here four times."""
    values = np.random.default_rng(4).exponential(size=100)
    low, high = expanded_levels(100)
    theirs = stats.bootstrap(
        (values,), np.mean, confidence_level=high - low, method="percentile", rng=np.random.default_rng(99)
    )
    allowed = 4 * np.sqrt(2) * 2.7 * values.std() / 10 / 100
    assert bootstrap_interval(values) == pytest.approx(tuple(theirs.confidence_interval), abs=allowed)


@settings(deadline=None)
@given(curves, st.sampled_from(LOCATIONS), st.integers(-4, 4), st.integers(-100, 100))
def test_intervals_move_with_the_values(values: Floats, location: Location, factor: int, shift: int) -> None:
    """Of a + b x they are a + b times those of x; a negative b turns the ends about."""
    plain = bootstrap_curve(values, location, num_resamples=FEW)
    moved = bootstrap_curve(shift + factor * values, location, num_resamples=FEW)
    value, low, high = (shift + factor * part for part in plain)
    if factor < 0:
        low, high = high, low
    np.testing.assert_allclose(moved, (value, low, high), rtol=0, atol=1e-9)


def test_columns_share_their_resample() -> None:
    """A column by itself has the interval it has among others, and any shape of columns is kept."""
    values = np.random.default_rng(5).normal(size=(20, 3, 2))
    whole = bootstrap_curve(values, num_resamples=FEW)
    assert [part.shape for part in whole] == [(3, 2)] * 3
    alone = bootstrap_curve(values[:, 1, 1], num_resamples=FEW)
    assert [float(part) for part in alone] == pytest.approx([part[1, 1] for part in whole], abs=1e-12)


def test_seed_decides() -> None:
    """The same seed gives the same interval, another seed another, and numpy's global generator is left alone."""
    values = np.random.default_rng(6).normal(size=(30, 2))
    before = str(np.random.get_state())  # noqa: NPY002
    first, again, other = (bootstrap_curve(values, num_resamples=FEW, seed=seed) for seed in (1, 1, 2))
    np.testing.assert_array_equal(first, again)
    assert not np.array_equal(first.low, other.low)
    assert str(np.random.get_state()) == before  # noqa: NPY002


def test_statistic_of_means_agrees_with_the_curve() -> None:
    """A single column's mean is the plainest statistic of means."""
    values = np.random.default_rng(7).normal(size=(50, 2))
    curve = bootstrap_curve(values, num_resamples=FEW)
    found = bootstrap_of_means(values, lambda means: means[..., 1], num_resamples=FEW)
    assert found == pytest.approx(tuple(part[1] for part in curve), abs=1e-12)


def test_ratio_of_proportional_arms_has_no_spread() -> None:
    """Runs are drawn in rows: where the second arm takes thrice the first's time in every run, so do the means."""
    first = np.random.default_rng(8).exponential(size=40)
    found = bootstrap_of_means(np.stack((first, 3 * first), axis=1), lambda means: means[..., 1] / means[..., 0])
    assert found == pytest.approx((3, 3, 3))


def test_ratio_of_standard_deviations() -> None:
    """A statistic of whole runs: deviations 2 and 1 of 400 normal runs; their ratio errs by √(1 / 400)."""
    values = np.random.default_rng(9).normal(size=(400, 2)) * [2.0, 1.0]

    def ratio(runs: Floats) -> Floats:
        deviations = runs.std(axis=-2, ddof=1)
        return deviations[..., 0] / deviations[..., 1]

    value, low, high = bootstrap_of_runs(values, ratio, num_resamples=2000)
    assert low < value < high
    assert (high - low) / (2 * 1.96) == pytest.approx(2 * np.sqrt(1 / 400), rel=0.2)


def test_slope_by_hand() -> None:
    """Over 0, 1, 3 (mean 4/3) of 1, 2, 6: (−4/3 · 1 − 1/3 · 2 + 5/3 · 6) / (16 + 1 + 25) · 9 = 8 · 9 / 42."""
    assert slope(np.array([0.0, 1.0, 3.0]))(np.array([1.0, 2.0, 6.0])) == pytest.approx(8 * 9 / 42)


def test_difference_of_slopes() -> None:
    """Two arms over one axis: run effects that are common to all points of a run cancel, so the interval is a point."""
    axis, effect = np.array([1.0, 2.0, 4.0]), np.random.default_rng(10).normal(size=(30, 1))
    values = np.concatenate((effect + 5 * axis, effect + 2 * axis), axis=1)
    rise = slope(axis)
    found = bootstrap_of_means(values, lambda means: rise(means[..., :3]) - rise(means[..., 3:]), num_resamples=FEW)
    assert found == pytest.approx((3, 3, 3))


def test_one_run_has_a_point() -> None:
    """Of one run every statistic has a point for an interval."""
    assert bootstrap_of_means(np.array([[2.0, 8.0]]), lambda means: means[..., 1] / means[..., 0]) == (4.0, 4.0, 4.0)


def test_what_cannot_be_resampled_is_refused() -> None:
    """No runs, missing values, statistics without a value or of a wrong shape: each says what was found."""
    with pytest.raises(ValueError, match="found no runs, expected at least one"):
        bootstrap_interval(np.array([]))
    with pytest.raises(ValueError, match="found 1 of 2 values that are not finite, expected a number for every run"):
        bootstrap_interval(np.array([1.0, np.nan]))
    values = np.array([[1.0, 0.0], [1.0, 1.0]])
    with pytest.raises(ValueError, match=r"found \d+ resamples of 10000 whose statistic is not finite, expected none"):
        bootstrap_of_means(values, lambda means: means[..., 0] / means[..., 1])
    with pytest.raises(ValueError, match="found a statistic of inf of the values"):
        bootstrap_of_means(np.array([[1.0, 0.0]]), lambda means: means[..., 0] / means[..., 1])
    with pytest.raises(ValueError, match=r"found a statistic of shape \(\d+, 2\), expected one number for each of"):
        bootstrap_of_runs(values, lambda runs: runs.mean(axis=-2)[..., :2] if runs.ndim > 2 else runs.mean())
    with pytest.raises(ValueError, match="found an axis of 2 equal points"):
        slope(np.array([3.0, 3.0]))
