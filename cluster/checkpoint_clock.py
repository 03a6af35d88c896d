"""When a shard writes a checkpoint: a decision, without any effect."""

from __future__ import annotations

from cluster.shard import Execution


class CheckpointClock:
    """Every so many seconds or episodes, but never so often that checkpoints take more than their share of the time.

    >>> clock = CheckpointClock(Execution(checkpoint_seconds=30.0, checkpoint_share=0.05), now=0.0)
    >>> clock.is_due(now=29.0, episodes=900), clock.is_due(now=30.0, episodes=930)
    (False, True)

    A checkpoint that took 4 s may be followed by the next one after 76 s, when both together are 5 % checkpoint:

    >>> clock.written(began=30.0, ended=34.0, episodes=930)
    >>> clock.is_due(now=109.0, episodes=5000), clock.is_due(now=110.0, episodes=5000)
    (False, True)
    """

    def __init__(self, execution: Execution, now: float, episodes: int = 0) -> None:
        self._execution = execution
        self._last_time, self._last_episodes, self._cost = now, episodes, 0.0
        self.seconds = 0.0
        """Spent in checkpoints so far."""

    def is_due(self, now: float, episodes: int) -> bool:
        """Whether to write one now; ``now`` in seconds of a monotonic clock, ``episodes`` over all runs."""
        elapsed, share = now - self._last_time, self._execution.checkpoint_share
        if elapsed < self._cost * (1.0 - share) / share:
            return False
        wanted = self._execution.checkpoint_episodes
        by_episodes = wanted is not None and episodes - self._last_episodes >= wanted
        return by_episodes or elapsed >= self._execution.checkpoint_seconds

    def written(self, began: float, ended: float, episodes: int) -> None:
        """A checkpoint was written."""
        self._cost = ended - began
        self._last_time, self._last_episodes = ended, episodes
        self.seconds += self._cost
