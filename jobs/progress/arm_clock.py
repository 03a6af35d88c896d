"""What each arm of a job took."""

from __future__ import annotations

import time

from cluster.events import ShardDone
from cluster.shard import Shard


class ArmClock:
    """Wall time and steps of each arm, from the ends of its shards."""

    def __init__(self) -> None:
        self.arms: dict[str, dict[str, float]] = {}
        self.num_shards = 0
        self._spans: dict[str, tuple[float, float]] = {}

    def add(self, shard: Shard, done: ShardDone) -> None:
        """Take in the end of a shard."""
        self.num_shards += 1
        now = time.monotonic()
        first, _ = self._spans.get(shard.arm.arm, (now - done.seconds, now))
        first = min(first, now - done.seconds)
        self._spans[shard.arm.arm] = first, now
        entry = self.arms.setdefault(shard.arm.arm, {"steps": 0, "rounds": 0})
        entry["steps"] += done.steps
        entry["rounds"] += done.rounds
        entry["seconds"] = now - first
