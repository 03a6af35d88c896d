"""What is told of a shard while it is played."""

from __future__ import annotations

from dataclasses import dataclass

from cluster.errors import RunFailure


@dataclass(frozen=True)
class ShardProgress:
    """How far a shard has come."""

    num_finished: int
    """Runs that are over, failed ones included."""
    episodes: int
    """Episodes played, over all runs; a run that is over counts with its cap."""
    steps: int
    num_failed: int = 0
    train_time: int = 0
    """Sum over the runs that finished, censored ones with their cap; 0 without a criterion."""
    rounds: int = 0
    round_seconds: float = 0.0
    """Spent in rounds since this coordinator began with the shard."""
    checkpoint_seconds: float = 0.0
    """Spent in checkpoints since then."""
    played: tuple[int, ...] = ()
    """Episodes that each learner played since the last report."""
    episode_return: float = 0.0
    """Sum of the undiscounted returns of those episodes."""
    episodes_played: int = 0
    """Over all runs: those that there were, also of runs that ended before their cap."""
    concentration: tuple[float, ...] = ()
    """Mean over the runs under way, per learner; empty for selectors that have none."""


@dataclass(frozen=True)
class ShardDone:
    """A shard is over and its results are stored."""

    failures: tuple[RunFailure, ...]
    steps: int
    seconds: float
    rounds: int
    episodes_played: int = 0


@dataclass(frozen=True)
class ShardStopped:
    """A shard was asked to stop: its checkpoint is written, and it goes on from there another time."""

    seconds: float


@dataclass(frozen=True)
class ShardReplayed:
    """What is stored of a shard cannot be gone on from: it is played from its beginning."""

    reason: str


@dataclass(frozen=True)
class ShardRestarted:
    """Processes of a shard died; it begins again from its checkpoint after ``delay_seconds``."""

    num_faults: int
    """In a row, without any progress between them."""
    delay_seconds: float
    error: str


@dataclass(frozen=True)
class ShardWaiting:
    """The cluster has no CPU at the moment; the shard, and all behind it, wait for one."""


ShardEvent = ShardProgress | ShardDone | ShardStopped | ShardReplayed | ShardRestarted | ShardWaiting
