"""When to try again after a fault of the infrastructure: a decision, without any effect."""

from __future__ import annotations

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
