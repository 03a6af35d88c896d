"""P(best) and P(within 5 %), by bootstrap over runs."""

from __future__ import annotations

import numpy as np
import pytest

from jobs.analysis.statistics.ranking import standing


def test_pairs_are_drawn_together() -> None:
    """A candidate that is better in every run is the best in every resample, however much runs differ."""
    runs = np.array([0.0, 100.0, 1000.0])
    found = standing(np.stack((runs, runs + 1.0), axis=1), smaller_is_better=False)
    assert found.best.tolist() == [0.0, 1.0]
    assert standing(np.stack((runs, runs + 1.0), axis=1), smaller_is_better=True).best.tolist() == [1.0, 0.0]


def test_by_hand() -> None:
    """Resamples of two runs are (0, 0), (0, 1), (1, 0) and (1, 1). Run 1 is won by more than run 0 is lost: the
    first is the best in one of four. Where two are equal, each counts half.
    """
    values = np.array([[1.0, 0.0, 0.0], [0.0, 3.0, 3.0]])
    assert standing(values, smaller_is_better=False).best == pytest.approx([0.25, 0.375, 0.375], abs=0.02)


def test_near_is_of_the_amount() -> None:
    """−84 is within 5 % of −80, −84.1 is not; 95 is of 100, and 105 of 100 where less is better."""
    returns = np.array([[-80.0, -84.0, -84.1]])
    assert standing(returns, smaller_is_better=False).near.tolist() == [1.0, 1.0, 0.0]
    assert standing(np.array([[100.0, 95.0, 94.0]]), smaller_is_better=False).near.tolist() == [1.0, 1.0, 0.0]
    assert standing(np.array([[100.0, 105.0, 106.0]]), smaller_is_better=True).near.tolist() == [1.0, 1.0, 0.0]


def test_missing_runs() -> None:
    """A candidate counts with the runs that it has; without any of those drawn it is not the best."""
    values = np.array([[1.0, np.nan], [1.0, 5.0]])
    assert standing(values, smaller_is_better=False).best == pytest.approx([0.25, 0.75], abs=0.02)
