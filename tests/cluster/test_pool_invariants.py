"""What holds of a pool whatever happens, and what it says of what cannot happen."""

from __future__ import annotations

import random
from collections.abc import Callable

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from apel.run.impossible import ImpossibleStateError
from cluster.errors import ShardLostError
from cluster.pool_events import (
    AskToStop,
    CpusCounted,
    Dismiss,
    GangFreed,
    GangLost,
    GangReported,
    GiveUp,
    Hire,
    JobBegun,
    PoolEvent,
    Start,
    StopAsked,
    Tick,
)
from cluster.pool_state import PoolState, gangs_to_hire
from cluster.shard import Shard
from tests.cluster.pools import DONE, RETRY, STOPPED, A, B, Pool, progress, shard_of

IMPOSSIBLE: dict[str, tuple[list[PoolEvent], str]] = {
    "before the job": ([Tick()], "before the job's beginning"),
    "a second beginning": ([JobBegun((A,), 0.0), JobBegun((B,), 0.0)], "before the job's beginning, or after its end"),
    "after giving up": ([JobBegun((shard_of(0, 1.0),), 0.0), Tick()], "after its end"),
    "the same shard twice": ([JobBegun((A, A), 0.0)], "two shards with one key"),
    "no count of CPUs": ([JobBegun((A,), 0.0), Tick()], "before CPUs were counted"),
    "an unknown gang": ([JobBegun((A,), 0.0), GangReported(3, DONE)], "a gang that plays no shard"),
    "stopped twice": ([JobBegun((A,), 0.0), *[StopAsked(frozenset())] * 2], "second wish to stop"),
    "stop of a gang that does not play": ([JobBegun((A,), 0.0), StopAsked(frozenset({1}))], "gangs that do not play"),
}
BEGUN: list[PoolEvent] = [JobBegun((A,), 0.0), CpusCounted(1), Tick()]
IMPOSSIBLE |= {
    "a word after the end": ([*BEGUN, GangReported(0, DONE), GangReported(0, progress(1))], "after its end"),
    "no word of the end": ([*BEGUN, GangFreed(0)], "without a word of how it ended"),
    "lost twice": ([*BEGUN, GangLost(0, "died"), GangLost(0, "died")], "a gang that plays no shard"),
}


@pytest.mark.parametrize("name", IMPOSSIBLE)
def test_impossible_events(name: str) -> None:
    """What cannot have happened is refused, with the event in words."""
    (*events, last), message = IMPOSSIBLE[name]
    state = PoolState(RETRY)
    for event in events:
        state.handle(event, 0.0)
    with pytest.raises(ImpossibleStateError, match=message) as raised:
        state.handle(last, 0.0)
    assert type(last).__name__ in raised.value.what


def test_clock_that_goes_back() -> None:
    """Back-offs would never end."""
    state = PoolState(RETRY)
    state.handle(JobBegun((A,), 0.0), 5.0)
    with pytest.raises(ImpossibleStateError, match="a clock that goes back"):
        state.handle(CpusCounted(1), 4.9)


def test_impossible_event_tells_its_story() -> None:
    """It comes with what was told and answered before, of the gang in question alone, and without idle ticks."""
    state = PoolState(RETRY)
    for now, event in enumerate((JobBegun((A, B), 0.0), CpusCounted(2), Tick(), Tick(), GangReported(1, DONE))):
        state.handle(event, float(now))
    state.handle(GangLost(0, "node died"), 7.25)
    with pytest.raises(ImpossibleStateError) as raised:
        state.handle(GangFreed(0), 8.0)
    assert raised.value.what == "found an event of a gang that plays no shard: GangFreed(gang=0)"
    assert raised.value.story == (
        "0.0 s: JobBegun(shards=2 shards, num_gpus=0.0) -> nothing",
        (
            "2.0 s: Tick() -> Hire(gang=0, gpus=()), Hire(gang=1, gpus=()), Start(gang=0, shard=APEL · runs 0-0), "
            "Start(gang=1, shard=APEL · runs 1-1)"
        ),
        (
            "7.2 s: GangLost(gang=0, reason='node died', cause=None) -> Dismiss(gang=0), "
            "Report(shard=APEL · runs 0-0, event=ShardRestarted(num_faults=1, delay_seconds=1.0, error='node died'))"
        ),
    )


def test_validate_names_the_broken_rule() -> None:
    """The invariants that all these tests check are checked in earnest."""
    pool = Pool()
    pool.begin(A, B)
    pool.state._queue.append(A)
    with pytest.raises(ImpossibleStateError, match="a shard waits, is played, or is over"):
        pool.state.validate()


@given(st.integers(0, 8), st.integers(0, 12), st.integers(0, 12), st.integers(0, 20))
def test_hired_gangs_fit(num_cpus: int, num_active: int, num_idle: int, num_waiting: int) -> None:
    """Gangs are hired only for waiting shards and free CPUs, and dismissed only where they are idle and in the way."""
    change = gangs_to_hire(num_cpus, num_active + num_idle, num_idle, num_waiting)
    assert -num_idle <= change
    if change > 0:
        assert num_active + num_idle + change <= num_cpus
        assert num_idle + change <= num_waiting
    if num_waiting == 0:
        assert change == -num_idle
    if num_active + num_idle > num_cpus:
        assert num_active + num_idle + change == max(num_cpus, num_active) or num_waiting == 0


class World:
    """A cluster on which anything may happen at any time; it holds the pool to what a driver can carry out."""

    def __init__(self, shards: tuple[Shard, ...], draw: Callable[[int], int]) -> None:
        self.pool = Pool()
        self.draw = draw
        self.gpus: dict[int, tuple[float, ...]] = {}
        self.playing: dict[int, Shard] = {}
        self.done: list[tuple[str, str, int]] = []
        self.num_cpus = 0
        self.tell(JobBegun(shards, 1.0), CpusCounted(0))

    def tell(self, *events: PoolEvent, after: float = 0.0) -> None:
        for instruction in self.pool.tell(*events, after=after):
            match instruction:
                case Hire(gang, gpus):
                    assert gang not in self.gpus
                    self.gpus[gang] = gpus
                case Dismiss(gang):
                    del self.gpus[gang]
                    self.playing.pop(gang, None)
                case Start(gang, shard):
                    assert gang not in self.playing
                    assert self.gpus[gang] == shard.arm.learner_gpus
                    self.playing[gang] = shard
                case AskToStop(gang):
                    assert gang in self.playing
                case GiveUp(error):
                    raise error

    def happen(self, what: int) -> None:
        """One of some things happens; nothing where it cannot."""
        gang = list(self.playing)[self.draw(len(self.playing))] if self.playing else None
        if what == 0:
            self.num_cpus = self.draw(4)
            self.tell(CpusCounted(self.num_cpus))
        elif what == 1 and not self.pool.state.is_stopping and self.draw(4) == 3:
            self.tell(StopAsked(frozenset(one for one in self.playing if self.draw(2))))
        elif what == 2 and gang is not None:
            self.tell(GangReported(gang, progress(self.draw(50))))
        elif what == 3 and gang is not None:
            self.tell(GangLost(gang, "died"))
        elif what == 4 and gang is not None:
            self.end(gang)
        self.tick(self.draw(3))

    def end(self, gang: int) -> None:
        """The gang's shard is done, or at a checkpoint where the job is to stop."""
        self.done.append(self.playing.pop(gang).key)
        self.tell(GangReported(gang, STOPPED if self.pool.state.is_stopping else DONE), GangFreed(gang))

    def tick(self, after: float) -> None:
        """Time passes; then there are no more gangs than CPUs, but for those that play."""
        self.tell(Tick(), after=after)
        assert len(self.gpus) <= max(self.num_cpus, len(self.playing))


@settings(max_examples=200, deadline=None)
@given(
    gpus=st.lists(st.sampled_from([(), (0.5, 0.0), (0.0, 0.5)]), max_size=6),
    happenings=st.lists(st.integers(0, 4), max_size=60),
    seed=st.integers(0, 2**16),
)
def test_whatever_happens(gpus: list[tuple[float, ...]], happenings: list[int], seed: int) -> None:
    """Whatever comes and goes, no rule is broken, and every instruction can be carried out; where CPUs stay in the end
    the job ends, each of its shards done once, or, where it was stopped, at most once.
    """
    shards = tuple(shard_of(index, *some) for index, some in enumerate(gpus))
    draw = random.Random(seed).randrange
    world = World(shards, draw)
    try:
        for what in happenings:
            world.happen(what)
        world.num_cpus = 2
        world.tell(CpusCounted(2))
        for _ in range(2 * len(shards)):
            world.tick(60.0)
            for gang in list(world.playing)[:1]:
                world.end(gang)
    except ShardLostError:
        assert happenings.count(3) >= 3  # as many faults as RETRY allows
        return
    world.tick(60.0)
    assert world.pool.state.is_over
    assert world.gpus == {}
    assert len(set(world.done)) == len(world.done)
    assert world.pool.state.is_stopping or sorted(world.done) == sorted(shard.key for shard in shards)
