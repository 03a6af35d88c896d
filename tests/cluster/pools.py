"""A pool's state for tests, its invariants checked after every event."""

from __future__ import annotations

from apel.configs import EnvironmentConfig, SelectorConfig
from cluster.events import ShardDone, ShardProgress, ShardRestarted, ShardStopped
from cluster.pool_events import (
    CpusCounted,
    Dismiss,
    GangFreed,
    GangLost,
    GangReported,
    Instruction,
    JobBegun,
    PoolEvent,
    Report,
    Tick,
    Wait,
)
from cluster.pool_state import PoolState
from cluster.retry import RetryPolicy
from cluster.shard import ArmPlan, RunPlan, Shard

DONE = ShardDone((), steps=100, seconds=1.0, rounds=3)
STOPPED = ShardStopped(seconds=1.0)
RETRY = RetryPolicy(max_attempts=3, first_delay_seconds=1.0)


def shard_of(index: int, *gpus: float) -> Shard:
    """A shard of one run, whose learners get such shares of GPUs."""
    arm = ArmPlan("e", "APEL", "", ("a", "b"), SelectorConfig("apel"), "return", 10, learner_gpus=gpus)
    return Shard(arm, (RunPlan(index, 100 + index, EnvironmentConfig("x"), ()),))


A, B, C = shard_of(0), shard_of(1), shard_of(2)


def progress(episodes: int) -> ShardProgress:
    return ShardProgress(num_finished=0, episodes=episodes, steps=10 * episodes)


class Pool:
    """A pool's state, its invariants checked after every event."""

    def __init__(self) -> None:
        self.state = PoolState(RETRY)
        self.now = 0.0

    def tell(self, *events: PoolEvent, after: float = 0.0) -> list[Instruction]:
        """All answers to these events, ``after`` seconds, but for `Wait`."""
        self.now += after
        answers = []
        for event in events:
            answers += self.state.handle(event, self.now)
            self.state.validate()
        return [one for one in answers if not isinstance(one, Wait)]

    def begin(self, *shards: Shard, num_cpus: int = 1, num_gpus: float = 0.0) -> list[Instruction]:
        """The job's first instructions."""
        return self.tell(JobBegun(shards, num_gpus), CpusCounted(num_cpus), Tick())

    def finish(self, gang: int) -> list[Instruction]:
        """The gang ends its shard; what is done then."""
        return self.tell(GangReported(gang, DONE), GangFreed(gang), Tick())[1:]

    def lose(self, gang: int) -> ShardRestarted:
        """The gang's processes die; what is reported."""
        dismissed, report = self.tell(GangLost(gang, "the actor died"))
        assert dismissed == Dismiss(gang)
        assert isinstance(report, Report)
        assert isinstance(report.event, ShardRestarted)
        return report.event
