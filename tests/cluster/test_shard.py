"""Which episodes are recorded, and what shards are called."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from apel.configs import EnvironmentConfig, SelectorConfig
from cluster.errors import RunFailure, grouped
from cluster.retry import RetryPolicy
from cluster.shard import ArmPlan, Every, RecordingRule, RunPlan, Shard, recorded_episodes


@pytest.mark.parametrize(
    ("recording", "expected"),
    [("all", [0, 1, 2, 3, 4, 5, 6]), ("none", []), (Every(3), [0, 3, 6]), ("log", [0, 1, 2, 3, 4, 5, 6])],
)
def test_recorded_episodes(recording: RecordingRule, expected: list[int]) -> None:
    """All, none, every third; log-spaced ones start densely."""
    assert np.flatnonzero(recorded_episodes(recording, 7)).tolist() == expected


@given(st.integers(1, 200_000))
def test_log_recording_grows_slowly(num_episodes: int) -> None:
    """Log-spaced rows are at most thirteen a decade (and the first), so that files stay small."""
    count = int(recorded_episodes("log", num_episodes).sum())
    assert 1 <= count <= 1 + 13 * len(str(num_episodes))


def _shard(*indices: int, sweep: str = "") -> Shard:
    arm = ArmPlan("e", "APEL", sweep, ("a", "b"), SelectorConfig("apel"), "return", 10)
    return Shard(arm, tuple(RunPlan(i, 100 + i, EnvironmentConfig("x"), ()) for i in indices))


def test_labels() -> None:
    """Labels are for people: arm, sweep point and runs."""
    assert _shard(3, 4, 5).label == "APEL · runs 3-5"
    assert _shard(3, sweep="decay=0.1").label == "APEL [decay=0.1] · runs 3-3"


def test_without() -> None:
    """Runs are taken out by position."""
    assert [run.index for run in _shard(3, 4, 5).without([1]).runs] == [3, 5]


def test_failures_are_grouped() -> None:
    """One line per distinct error, with the place of the first and the seeds of the others."""
    failures = [RunFailure("APEL", "", i, 100 + i, "Q", 7, "stuck") for i in range(3)]
    lines = grouped([*failures, RunFailure("Q", "", 5, 105, "Q", 8, "lost")])
    assert lines == [
        "APEL: 3 run(s) failed: stuck at seed 100 (run 0), learner Q, episode 7; also seeds 101, 102",
        "Q: 1 run(s) failed: lost at seed 105 (run 5), learner Q, episode 8",
    ]


def test_retries_are_bounded() -> None:
    """The delay doubles, and the last fault gives up."""
    policy = RetryPolicy(max_attempts=3, first_delay_seconds=1.0)
    assert [policy.delay_seconds(n) for n in (1, 2, 3)] == [1.0, 2.0, None]
