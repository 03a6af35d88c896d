"""When to try again after a fault of the infrastructure: decisions, without any effect."""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass


@dataclass(frozen=True)
class RetryPolicy:
    """Exponential back-off, a bounded number of times per shard. Errors of user code are never retried.

    >>> policy = RetryPolicy(max_attempts=4, first_delay_seconds=0.5)
    >>> [policy.delay_seconds(faults) for faults in (1, 2, 3, 4)]
    [0.5, 1.0, 2.0, None]
    """

    max_attempts: int = 6
    first_delay_seconds: float = 0.5

    def delay_seconds(self, num_faults: int) -> float | None:
        """Seconds to wait after the shard's ``num_faults``-th fault, or None to give up."""
        if num_faults >= self.max_attempts:
            return None
        return float(self.first_delay_seconds * 2 ** (num_faults - 1))


class FaultCounter:
    """Counts a shard's faults, and forgets them once it has come further than before: a job that goes on for days on
    nodes that come and go is no failure, one that dies again and again at the same place is.

    >>> counter = FaultCounter(RetryPolicy(max_attempts=2, first_delay_seconds=0.5))
    >>> counter.failed("shard"), counter.progressed("shard", 10), counter.failed("shard"), counter.failed("shard")
    (0.5, None, 0.5, None)
    """

    def __init__(self, policy: RetryPolicy) -> None:
        self._policy = policy
        self._in_a_row: dict[Hashable, int] = {}
        self._furthest: dict[Hashable, int] = {}
        self.total = 0
        """All faults so far."""

    def in_a_row(self, shard: Hashable) -> int:
        """Faults since the shard last came further than before."""
        return self._in_a_row.get(shard, 0)

    def failed(self, shard: Hashable) -> float | None:
        """Seconds to wait before the shard begins again, or None to give up."""
        self.total += 1
        self._in_a_row[shard] = self.in_a_row(shard) + 1
        return self._policy.delay_seconds(self._in_a_row[shard])

    def progressed(self, shard: Hashable, episodes: int) -> None:
        """The shard has played so many episodes; those that it had played before a fault do not count again."""
        if episodes > self._furthest.get(shard, 0):
            self._furthest[shard] = episodes
            self._in_a_row.pop(shard, None)
