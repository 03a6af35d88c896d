"""How fast a job of the soak may go: no faster on a fast machine than on a slow one, and not to its end before the
last fault has hit it.
"""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path

from cluster.coordinator import Coordinator
from cluster.events import ShardProgress
from cluster.shard import Execution, Shard
from cluster.shard_state import ShardState


@dataclass(frozen=True)
class Pace:
    """What a job has to heed.

    Attributes
    ----------
    round_seconds:
        A shard's round takes no less.
    held_arm, held_run:
        The run that keeps an episode for each fault to come. So every fault finds a shard that is played; and the shard
        comes further after each, as it must: one that dies again and again at the same place is given up.
    file:
        Says how many faults are to come; where it is not there, none.
    """

    round_seconds: float
    held_arm: str
    held_run: int
    file: str

    @classmethod
    def of_word(cls, word: str) -> Pace:
        """That of a command line."""
        return cls(**json.loads(word))

    def as_word(self) -> str:
        """For a command line."""
        return json.dumps(asdict(self))

    def expect(self, num_faults: int) -> None:
        """Say how many faults are to come."""
        new = Path(f"{self.file}.new")
        new.write_text(str(num_faults))
        new.replace(self.file)

    def num_expected(self) -> int:
        """How many faults are to come."""
        try:
            return int(Path(self.file).read_text())
        except FileNotFoundError:
            return 0


@dataclass(frozen=True)
class PacedExecution(Execution):
    """How to play, and how fast."""

    pace: Pace = field(kw_only=True)


class PacedCoordinator(Coordinator):
    """A coordinator that heeds a pace; it is given a `PacedExecution`."""

    def _play_rounds(self, shard: Shard, state: ShardState) -> Iterator[ShardProgress]:
        assert isinstance(self._execution, PacedExecution)
        state.orders = PacedOrders(self._execution.pace, shard, state)  # type: ignore[method-assign]
        return super()._play_rounds(shard, state)


class PacedOrders:
    """The orders of a shard, each when it is time for it, and without a run that is to keep the episodes it has left.

    Rounds go on while it does, and checkpoints with them: there are processes, and a storage, to be hit.
    """

    def __init__(self, pace: Pace, shard: Shard, state: ShardState) -> None:
        self._pace, self._state, self._orders = pace, state, state.orders
        self._held = {
            position
            for position, run in enumerate(shard.runs)
            if (shard.arm.arm, run.index) == (pace.held_arm, pace.held_run)
        }
        self._due = time.monotonic()

    def __call__(self) -> list[list[int]]:
        """See `ShardState.orders`."""
        time.sleep(max(self._due - time.monotonic(), 0.0))
        self._due = time.monotonic() + self._pace.round_seconds
        return [[run for run in order if run not in self._held or self._may_play(run)] for order in self._orders()]

    def _may_play(self, run: int) -> bool:
        return bool(self._state.book.episode[run] < self._state.book.num_episodes - self._pace.num_expected())
