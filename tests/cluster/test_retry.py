"""When to begin again, and when to give up."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from cluster.retry import FaultCounter, RetryPolicy


def test_faults_without_progress_are_bounded() -> None:
    """A shard that dies again and again at the same place is given up, however often it plays up to there again."""
    counter = FaultCounter(RetryPolicy(max_attempts=3, first_delay_seconds=1.0))
    counter.progressed("a", 500)
    delays = []
    for _ in range(3):
        counter.progressed("a", 300)
        counter.progressed("a", 500)
        delays.append(counter.failed("a"))
    assert delays == [1.0, 2.0, None]
    assert (counter.in_a_row("a"), counter.in_a_row("b"), counter.total) == (3, 0, 3)


def test_progress_forgives() -> None:
    """A shard that comes further after every fault may have any number of them."""
    counter = FaultCounter(RetryPolicy(max_attempts=2, first_delay_seconds=1.0))
    for episodes in range(1, 100):
        counter.progressed("a", episodes)
        assert counter.failed("a") == 1.0
    assert counter.total == 99


@given(st.integers(1, 10), st.floats(0.01, 10.0))
def test_delays_grow(attempts: int, first: float) -> None:
    """Every delay is twice the one before, and there are one fewer than attempts."""
    policy = RetryPolicy(attempts, first)
    delays = [policy.delay_seconds(faults) for faults in range(1, attempts + 1)]
    assert delays[-1] is None
    assert delays[:-1] == [first * 2**i for i in range(attempts - 1)]
