"""Local mode: the same classes, in this process, without Ray. For tests, debuggers, and learners that take
microseconds.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

from apel.experience.trajectory import TrajectoryBatch
from apel.learners.base import Failure, Played, State
from cluster.coordinator import Coordinator
from cluster.events import ShardEvent
from cluster.learner_host import LearnerHost
from cluster.protocols import CheckpointStore, ResultSink
from cluster.shard import Execution, Shard


class LocalHosts:
    """Hosts in this process, called one after the other; for ``records`` see `LearnerHost`."""

    def __init__(self, *, records: bool = False) -> None:
        self._records = records
        self._hosts: list[LearnerHost] = []
        self._last: list[TrajectoryBatch | None] = []

    def prepare(self, shard: Shard, execution: Execution, states: Sequence[State] | None) -> None:
        """See `cluster.protocols.Hosts`."""
        self.close()
        self._hosts = [LearnerHost(records=self._records) for _ in shard.arm.learner_names]
        self._last = [None] * len(self._hosts)
        for index, host in enumerate(self._hosts):
            host.prepare(shard, index, execution, states[index] if states is not None else None)

    def play(self, orders: Sequence[Sequence[int]]) -> list[Played]:
        """See `cluster.protocols.Hosts`."""
        answers = [host.play(orders[i], *self._others(i)) for i, host in enumerate(self._hosts)]
        self._last = [batch for _, batch in answers]
        return [played for played, _ in answers]

    def latest(self) -> list[TrajectoryBatch | None]:
        """What each host played in the last round; None where that was nothing, or where nobody records it."""
        return list(self._last)

    def catch_up(self) -> list[tuple[Failure, ...]]:
        """See `cluster.protocols.Hosts`."""
        answers = [host.catch_up(*self._others(i)) for i, host in enumerate(self._hosts)]
        self._last = [None] * len(self._hosts)
        return answers

    def states(self) -> list[tuple[State, tuple[Failure, ...]]]:
        """See `cluster.protocols.Hosts`."""
        answers = [host.state(*self._others(i)) for i, host in enumerate(self._hosts)]
        self._last = [None] * len(self._hosts)
        return answers

    def models(self, runs: Sequence[int]) -> list[tuple[list[State], tuple[Failure, ...]]]:
        """See `cluster.protocols.Hosts`."""
        answers = [host.models(runs, *self._others(i)) for i, host in enumerate(self._hosts)]
        self._last = [None] * len(self._hosts)
        return answers

    def close(self) -> None:
        """See `cluster.protocols.Hosts`."""
        for host in self._hosts:
            host.close()

    def _others(self, index: int) -> list[TrajectoryBatch]:
        return [batch for other, batch in enumerate(self._last) if other != index and batch is not None]


def run_shards(
    shards: Sequence[Shard],
    sink: ResultSink,
    checkpoints: CheckpointStore,
    execution: Execution,
    stopping: Callable[[], bool] = lambda: False,
) -> Iterator[tuple[Shard, ShardEvent]]:
    """Play shards one after the other in this process, until all are done or ``stopping()`` says to stop."""
    for shard in shards:
        if stopping():
            return
        coordinator = Coordinator(LocalHosts(), sink, checkpoints, execution)
        for event in coordinator.run(shard):
            yield shard, event
            if stopping():
                coordinator.stop()
