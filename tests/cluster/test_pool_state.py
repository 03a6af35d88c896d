"""Who plays which shard, and when: every case of it, without Ray and without a clock."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from cluster.errors import ClusterError, ShardLostError
from cluster.events import ShardReplayed, ShardRestarted, ShardWaiting
from cluster.pool_events import (
    AskToStop,
    CpusCounted,
    Dismiss,
    GangFailed,
    GangFreed,
    GangLost,
    GangReported,
    GiveUp,
    Hire,
    JobBegun,
    Report,
    Start,
    StopAsked,
    Tick,
    Wait,
)
from tests.cluster.pools import DONE, STOPPED, A, B, C, Pool, progress, shard_of


@pytest.fixture
def pool() -> Iterator[Pool]:
    """A pool before its job; its invariants hold at the end too."""
    pool = Pool()
    yield pool
    pool.state.validate()


# Hiring and dismissing.


def test_hires_up_to_the_cpus(pool: Pool) -> None:
    """There are as many gangs as CPUs; the shards begin in the job's order, and the others wait."""
    assert pool.begin(A, B, C, num_cpus=2) == [Hire(0, ()), Hire(1, ()), Start(0, A), Start(1, B)]
    assert pool.tell(Tick()) == []


def test_hires_no_more_than_there_are_shards(pool: Pool) -> None:
    """A CPU without a shard to play is left to others."""
    assert pool.begin(A, num_cpus=8) == [Hire(0, ()), Start(0, A)]


def test_a_gang_is_kept_for_the_next_shard(pool: Pool) -> None:
    """A gang that is done takes the next shard; its processes go on living."""
    pool.begin(A, B)
    assert pool.finish(0) == [Start(0, B)]


def test_reports_are_passed_on(pool: Pool) -> None:
    """What a gang says is told with its shard."""
    pool.begin(A)
    assert pool.tell(GangReported(0, progress(5))) == [Report(A, progress(5))]
    replayed = ShardReplayed("its checkpoint does not fit")
    assert pool.tell(GangReported(0, replayed)) == [Report(A, replayed)]
    assert pool.tell(GangReported(0, DONE)) == [Report(A, DONE)]


def test_dismisses_when_shards_run_out(pool: Pool) -> None:
    """A gang for which no shard waits gives its CPU back, while another still plays."""
    pool.begin(A, B, num_cpus=2)
    assert pool.finish(0) == [Dismiss(0)]
    assert not pool.state.is_over
    assert pool.finish(1) == [Dismiss(1)]
    assert pool.state.is_over


def test_workers_join(pool: Pool) -> None:
    """CPUs that come are used by shards that wait."""
    pool.begin(A, B, C)
    assert pool.tell(CpusCounted(3), Tick()) == [Hire(1, ()), Hire(2, ()), Start(1, B), Start(2, C)]


def test_workers_leave(pool: Pool) -> None:
    """Where CPUs have gone an idle gang goes too: it would stand in the way of one that was never placed."""
    pool.begin(A, B, C, num_cpus=2)
    pool.tell(CpusCounted(1))
    assert pool.finish(0) == [Dismiss(0)]
    assert pool.finish(1) == [Start(1, C)]


def test_waits_for_those_that_play(pool: Pool) -> None:
    """After every tick the driver is to wait for the gangs that play; where none does, only a while."""
    pool.tell(JobBegun((A, B), 0.0), CpusCounted(0))
    assert pool.state.handle(Tick(), 0.0)[-1] == Wait((), 0.5)
    pool.tell(CpusCounted(2))
    assert pool.state.handle(Tick(), 0.0)[-1] == Wait((0, 1), 0.5)


def test_a_job_without_shards_is_over(pool: Pool) -> None:
    """There is nothing to hire for."""
    assert pool.tell(JobBegun((), 0.0)) == []
    assert pool.state.is_over


# Starvation.


def test_starvation_is_told_once(pool: Pool) -> None:
    """Where there is no CPU, the first shard that waits is told of; once, and again only after there was one."""
    assert pool.begin(A, B, num_cpus=0) == [Report(A, ShardWaiting())]
    assert pool.tell(Tick(), CpusCounted(0), Tick(), after=60.0) == []
    assert pool.tell(CpusCounted(1), Tick()) == [Hire(0, ()), Start(0, A)]
    assert pool.tell(CpusCounted(0), Tick()) == [Report(B, ShardWaiting())]


def test_no_starvation_while_none_waits(pool: Pool) -> None:
    """A cluster whose last CPU is lost is no news as long as every shard is with a gang."""
    pool.begin(A)
    assert pool.tell(CpusCounted(0), Tick()) == []


# GPUs.


def test_gpus_go_with_the_gang(pool: Pool) -> None:
    """A gang is hired with the GPUs of the learners that it is for: fractions, and learners without any."""
    shard = shard_of(0, 0.5, 0.0)
    assert pool.begin(shard, num_gpus=1.0) == [Hire(0, (0.5, 0.0)), Start(0, shard)]


def test_a_gang_with_other_gpus_is_replaced(pool: Pool) -> None:
    """A shard whose learners have other GPUs than the idle gang gets a new gang in its place, never a second one."""
    without, half, whole = shard_of(0), shard_of(1, 0.0, 0.5), shard_of(2, 0.5, 0.0)
    pool.begin(without, half, whole, num_gpus=1.0)
    assert pool.finish(0) == [Dismiss(0), Hire(1, (0.0, 0.5)), Start(1, half)]
    assert pool.finish(1) == [Dismiss(1), Hire(2, (0.5, 0.0)), Start(2, whole)]


def test_the_fitting_gang_is_taken(pool: Pool) -> None:
    """Of several idle gangs a shard takes the one with its GPUs."""
    first, second = shard_of(0, 0.5, 0.0), shard_of(1)
    third, fourth = shard_of(2), shard_of(3, 0.5, 0.0)
    pool.begin(first, second, third, fourth, num_cpus=2, num_gpus=1.0)
    # The first two gangs were hired for the shard at the head of the queue; one of them was replaced.
    playing = {one.shard.key: one.gang.number for one in pool.state._playing.values()}
    assert playing == {first.key: 0, second.key: 2}
    pool.tell(*(event for gang in (0, 2) for event in (GangReported(gang, DONE), GangFreed(gang))))
    assert pool.tell(Tick()) == [Start(2, third), Start(0, fourth)]


def test_more_gpus_than_there_are(pool: Pool) -> None:
    """A gang that wants more than all nodes have together would wait for ever: the job is refused at once."""
    (answer,) = pool.tell(JobBegun((A, shard_of(1, 0.5, 1.0)), num_gpus=1.0))
    assert isinstance(answer, GiveUp)
    assert isinstance(answer.error, ClusterError)
    assert str(answer.error) == (
        "found 1 GPUs in the Ray cluster, expected at least 1.5: the num_gpus of an arm's learners"
    )


def test_as_many_gpus_as_there_are(pool: Pool) -> None:
    """All of them may be asked for."""
    assert pool.tell(JobBegun((shard_of(0, 0.5, 0.5),), num_gpus=1.0)) == []


# Lost gangs and back-off.


def test_lost_while_starting(pool: Pool) -> None:
    """A gang that dies before its first word is replaced, and the shard begins again after its back-off."""
    pool.begin(A)
    assert pool.lose(0) == ShardRestarted(num_faults=1, delay_seconds=1.0, error="the actor died")
    assert pool.tell(Tick(), after=0.9) == [Hire(1, ())]  # it is placed while the shard waits
    assert pool.tell(Tick(), after=0.1) == [Start(1, A)]
    assert pool.state.num_restarts == 1


def test_lost_while_playing(pool: Pool) -> None:
    """The others play on; the lost one's shard goes on from its checkpoint, before those that have not begun."""
    pool.begin(A, B, C, num_cpus=2)
    pool.tell(GangReported(0, progress(5)), GangReported(1, progress(5)))
    pool.lose(0)
    # The new gang is in the lost one's place: it is kept for the shard that waits out its back-off.
    assert pool.tell(Tick()) == [Hire(2, ())]
    assert pool.tell(GangReported(1, progress(6))) == [Report(B, progress(6))]
    assert pool.tell(Tick(), after=1.0) == [Start(2, A)]


def test_an_idle_gang_more_than_waits_for_back_off_plays_on(pool: Pool) -> None:
    """Only as many idle gangs are kept as shards wait out their back-off."""
    pool.begin(A, B, C, num_cpus=2)
    pool.lose(0)
    pool.tell(Tick())
    assert pool.finish(1) == [Start(2, C)]
    assert pool.tell(Tick(), after=1.0) == [Start(1, A)]


def test_shards_due_together_go_first(pool: Pool) -> None:
    """Shards whose back-offs end come before all that have not begun; the one lost last comes first."""
    pool.begin(A, B, C, num_cpus=2)
    pool.lose(0)
    pool.lose(1)
    assert pool.tell(Tick(), after=1.0) == [Hire(2, ()), Hire(3, ()), Start(2, B), Start(3, A)]


def test_lost_after_the_end(pool: Pool) -> None:
    """A gang that dies once it has said that its shard is done has nothing left to do: nothing is played again."""
    pool.begin(A, B)
    assert pool.tell(GangReported(0, DONE)) == [Report(A, DONE)]
    assert pool.tell(GangLost(0, "its environment would not close")) == [Dismiss(0)]
    assert pool.tell(Tick(), after=9.0) == [Hire(1, ()), Start(1, B)]
    assert pool.state.num_restarts == 0
    pool.tell(GangReported(1, DONE), GangFreed(1))
    assert pool.state.is_over


def test_back_off_doubles_and_gives_up(pool: Pool) -> None:
    """At the same place every back-off is twice the one before, until the shard is given up with the last reason."""
    pool.begin(A)
    pool.tell(GangReported(0, progress(5)))
    assert pool.lose(0).delay_seconds == 1.0
    pool.tell(Tick(), after=1.0)
    pool.tell(GangReported(1, progress(3)), GangReported(1, progress(5)))  # played before: no progress
    assert pool.lose(1).delay_seconds == 2.0
    assert pool.tell(Tick(), after=1.9) == [Hire(2, ())]
    assert pool.tell(Tick(), after=0.1) == [Start(2, A)]
    cause = OSError("gone")
    dismissed, answer = pool.tell(GangLost(2, "the node died", cause))
    assert dismissed == Dismiss(2)
    assert isinstance(answer, GiveUp)
    assert isinstance(answer.error, ShardLostError)
    assert str(answer.error) == "APEL · runs 0-0: its processes died 3 times; the last: the node died"
    assert answer.cause is cause
    assert pool.state.num_restarts == 3


def test_progress_forgives(pool: Pool) -> None:
    """A shard that comes further after every fault begins again any number of times, after the shortest back-off."""
    pool.begin(A)
    for gang in range(20):
        pool.tell(GangReported(gang, progress(gang + 1)))
        assert pool.lose(gang) == ShardRestarted(1, 1.0, "the actor died")
        pool.tell(Tick(), after=1.0)
    assert pool.state.num_restarts == 20


def test_faults_are_counted_by_shard(pool: Pool) -> None:
    """A shard's faults are its own, whichever gangs it had."""
    pool.begin(A, B, num_cpus=2)
    pool.lose(0)
    assert pool.lose(1).num_faults == 1


def test_errors_of_user_code_are_not_retried(pool: Pool) -> None:
    """They would come again: the job ends with the error as it was."""
    pool.begin(A, B)
    error = ValueError("state.generator: found object")
    assert pool.tell(GangFailed(0, error)) == [Dismiss(0), GiveUp(error)]
    assert pool.state.num_restarts == 0


# Stopping.


def test_stop_ends_with_checkpoints(pool: Pool) -> None:
    """Gangs under way are asked for a checkpoint; what waits is not begun; after their last word they go."""
    pool.begin(A, B, C, num_cpus=2)
    assert pool.tell(StopAsked(frozenset({0, 1})), Tick()) == [AskToStop(0), AskToStop(1)]
    assert not pool.state.is_over
    assert pool.tell(GangReported(0, progress(7)), GangReported(0, STOPPED)) == [
        Report(A, progress(7)),
        Report(A, STOPPED),
    ]
    assert pool.tell(GangFreed(0), Tick()) == [Dismiss(0)]
    assert pool.tell(GangReported(1, DONE), GangFreed(1)) == [Report(B, DONE)]
    assert pool.state.is_over


def test_stop_does_not_wait_for_room(pool: Pool) -> None:
    """A gang that the cluster had no room for has no process that could hear it, and may never have one: it goes."""
    pool.begin(A, B, num_cpus=2)
    assert pool.tell(StopAsked(frozenset({1}))) == [Dismiss(0), AskToStop(1)]
    pool.finish(1)
    assert pool.state.is_over


def test_stop_forgets_back_offs(pool: Pool) -> None:
    """A shard that waits out its back-off stays at its checkpoint."""
    pool.begin(A)
    pool.lose(0)
    assert pool.tell(StopAsked(frozenset())) == []
    assert pool.state.is_over


def test_lost_while_stopping(pool: Pool) -> None:
    """A gang that dies before it has written its checkpoint is told of, and its shard is not begun again."""
    pool.begin(A)
    pool.tell(StopAsked(frozenset({0})))
    assert pool.lose(0).num_faults == 1
    assert pool.state.is_over
