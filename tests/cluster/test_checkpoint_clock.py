"""Checkpoints by time, by episodes, and never for more than their share."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cluster.checkpoint_clock import CheckpointClock
from cluster.shard import Execution


def test_by_episodes() -> None:
    """After so many episodes since the last one, however little time has passed."""
    clock = CheckpointClock(Execution(checkpoint_seconds=1e9, checkpoint_episodes=100), now=0.0, episodes=50)
    assert not clock.is_due(0.1, 149)
    assert clock.is_due(0.1, 150)
    clock.written(0.1, 0.1, 150)
    assert not clock.is_due(0.2, 249)
    assert clock.is_due(0.2, 250)


@given(
    share=st.floats(0.01, 0.5),
    seconds=st.floats(0.0, 50.0),
    costs=st.lists(st.floats(0.001, 100.0), min_size=1, max_size=30),
    pace=st.floats(0.01, 5.0),
)
def test_share_is_never_exceeded(share: float, seconds: float, costs: list[float], pace: float) -> None:
    """However costly checkpoints become, they take at most their share of the time up to the next one."""
    clock = CheckpointClock(Execution(checkpoint_seconds=seconds, checkpoint_share=share), now=0.0)
    now, spent = 0.0, 0.0
    for cost in costs:
        while not clock.is_due(now, 0):
            now += pace
        assert spent <= share * now * (1 + 1e-9)
        clock.written(now, now + cost, 0)
        now += cost
        spent += cost
    assert clock.seconds == pytest.approx(spent)
