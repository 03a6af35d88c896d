"""What is told of a shard that is played in parts, one after the other: the sum of all so far."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace

from cluster.errors import RunFailure
from cluster.events import ShardDone, ShardProgress, ShardReplayed, ShardStopped

Told = ShardProgress | ShardReplayed | ShardDone | ShardStopped
"""What a coordinator tells of a shard."""
_ADDED = (
    "num_finished", "episodes", "steps", "num_failed", "train_time", "rounds", "round_seconds", "checkpoint_seconds",
    "episodes_played",
)  # fmt: skip
"""What a report counts from the beginning of its part; the rest of it is since the report before."""


def in_order(failures: Iterable[RunFailure]) -> tuple[RunFailure, ...]:
    """By the numbers of their runs."""
    return tuple(sorted(failures, key=lambda failure: failure.run_index))


class Parts:
    """The parts that are over, and the latest report of the one under way.

    Parameters
    ----------
    failures:
        Of runs that are in no part.

    Attributes
    ----------
    is_stopped:
        Whether the latest part was asked to stop: none comes after it.
    """

    def __init__(self, failures: Sequence[RunFailure]) -> None:
        self._done = [ShardDone(tuple(failures), 0, 0.0, 0)]
        self._before = self._latest = ShardProgress(0, 0, 0)
        self.is_stopped = False

    def told(self, events: Iterator[Told]) -> Iterator[Told]:
        """What the next part tells, as of the whole shard; not that it is over."""
        for event in events:
            if isinstance(event, ShardDone):
                self._done.append(event)
                self._before = self._latest
            elif isinstance(event, ShardProgress):
                counts = {name: getattr(self._before, name) + getattr(event, name) for name in _ADDED}
                self._latest = replace(event, **counts)
                yield self._latest
            else:
                self.is_stopped = isinstance(event, ShardStopped)
                yield event

    def done(self) -> ShardDone:
        """All are over."""
        return ShardDone(
            in_order(failure for one in self._done for failure in one.failures),
            steps=sum(one.steps for one in self._done),
            seconds=self._done[-1].seconds,
            rounds=sum(one.rounds for one in self._done),
            episodes_played=sum(one.episodes_played for one in self._done),
        )
