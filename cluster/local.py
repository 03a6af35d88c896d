"""Local mode: the same classes, in this process, without Ray. For tests, debuggers, and learners that take
microseconds.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Sequence
from typing import Any

from apel.compiled import is_compiled, mark_compiled
from apel.configs import EnvironmentConfig, LearnerConfig, SelectorConfig
from apel.learners.base import Failure, Played, State
from apel.registry import SELECTORS
from apel.trajectory import TrajectoryBatch
from cluster.coordinator import Coordinator
from cluster.events import ShardEvent
from cluster.learner_host import LearnerHost
from cluster.protocols import CheckpointStore, ResultSink
from cluster.shard import ArmPlan, Execution, RunPlan, Shard


class LocalHosts:
    """Hosts in this process, called one after the other; for ``records`` see `LearnerHost`."""

    def __init__(self, *, records: bool = False) -> None:
        self._records = records
        self._hosts: list[LearnerHost] = []
        self._last: list[TrajectoryBatch | None] = []

    def prepare(self, shard: Shard, execution: Execution, states: Sequence[State] | None) -> None:
        """See `cluster.coordinator.Hosts`."""
        self._hosts = [LearnerHost(records=self._records) for _ in shard.arm.learner_names]
        self._last = [None] * len(self._hosts)
        for index, host in enumerate(self._hosts):
            host.prepare(shard, index, execution, states[index] if states is not None else None)

    def play(self, orders: Sequence[Sequence[int]]) -> list[Played]:
        """See `cluster.coordinator.Hosts`."""
        answers = [host.play(orders[i], *self._others(i)) for i, host in enumerate(self._hosts)]
        self._last = [batch for _, batch in answers]
        return [played for played, _ in answers]

    def latest(self) -> list[TrajectoryBatch | None]:
        """What each host played in the last round; None where that was nothing, or where nobody records it."""
        return list(self._last)

    def states(self) -> list[tuple[State, tuple[Failure, ...]]]:
        """See `cluster.coordinator.Hosts`."""
        answers = [host.state(*self._others(i)) for i, host in enumerate(self._hosts)]
        self._last = [None] * len(self._hosts)
        return answers

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


def not_compiled(selectors: Collection[str]) -> list[str]:
    """Those of the shipped ``selectors`` whose compiled functions are not in the cache yet."""
    return [name for name in sorted(selectors) if name in SELECTORS and not is_compiled(name)]


def compile_for(selectors: Collection[str]) -> None:
    """Play a few episodes with each of some shipped selectors, so that no worker has to compile what it needs.

    Compiling takes some twenty seconds, once per installation, and one for each selector; without this, all workers
    would do the same at once.
    """
    maze = EnvironmentConfig("apel/Maze-v0", {"size": 3, "distractors": [2], "max_steps": 20})
    for selector in not_compiled(selectors):
        for num_learners in (1, 2):
            run = RunPlan(0, 0, maze, (LearnerConfig("q_learning"),) * num_learners)
            names = tuple(f"learner {i}" for i in range(num_learners))
            arm = ArmPlan("compile", selector, "", names, SelectorConfig(selector), "return", 5, recording="all")
            coordinator = Coordinator(LocalHosts(), _Nowhere(), _Nowhere(), Execution(streak_episodes=2))
            for _ in coordinator.run(Shard(arm, (run,))):
                pass
        mark_compiled(selector)


class _Nowhere:
    """Keeps nothing."""

    def spill(self, *_: Any) -> None:
        """Keep nothing."""

    def commit(self, *_: Any) -> None:
        """Keep nothing."""

    def read(self, _: Shard) -> None:
        """There is nothing."""

    def write(self, *_: Any) -> None:
        """Keep nothing."""

    def delete(self, _: Shard) -> None:
        """There is nothing."""
