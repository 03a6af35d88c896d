"""How many gangs there are, whatever comes and goes; and what becomes of shards whose gangs die."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cluster.events import ShardDone, ShardRestarted, ShardStopped
from cluster.pool import gangs_to_hire
from cluster.shard import Execution
from jobs.plan import plan_shards
from jobs.spec_files import load_experiment
from tests.cluster.test_coordinator import Memory


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


@pytest.mark.ray
def test_stop_leaves_checkpoints(ray_session: None, small: Path) -> None:
    """Shards that are asked to stop write a checkpoint and end; those that wait are not begun."""
    from cluster.pool import ShardPool

    overrides = ("episodes=100000", "stop_when_met=false", "record=none")
    shards = plan_shards(load_experiment(str(small), overrides), 1, ["APEL"], set(), 2)
    execution = Execution(streak_episodes=1, progress_seconds=0.0, checkpoint_seconds=1e9)
    memory = Memory()
    heard = 0

    def stopping() -> bool:
        return heard > 5

    events = []
    for shard, event in ShardPool("stopped", "actors", memory, memory, execution).run(shards, stopping):
        events.append((shard.key, event))
        heard += 1
    stopped = {key for key, event in events if isinstance(event, ShardStopped)}
    assert 1 <= len(stopped) <= 2
    assert {key for key, _ in events} == stopped
    assert not any(isinstance(event, ShardDone | ShardRestarted) for _, event in events)
