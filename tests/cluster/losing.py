"""Shards that lose their hosts."""

from __future__ import annotations

import numpy as np
import pytest

from cluster.coordinator import Coordinator
from cluster.shard import Execution, Shard
from tests.cluster.shards import FailingHosts, Memory


def assert_goes_on(shard: Shard, rounds: int) -> None:
    """Lost after so many rounds, it plays those that were left, and ends with the rows, train times and steady states
    of an undisturbed one.
    """
    # An arm of one learner has streaks ten times as long.
    undisturbed, memory = Memory(), Memory()
    execution = Execution(streak_episodes=1, streak_steps=5, checkpoint_seconds=0.0, checkpoint_share=1.0)
    never, again = FailingHosts(10**6), FailingHosts(10**6)
    list(Coordinator(never, undisturbed, undisturbed, execution).run(shard))
    with pytest.raises(ConnectionError):
        list(Coordinator(FailingHosts(rounds), memory, memory, execution).run(shard))
    assert memory.num_checkpoints == rounds
    memory.rows.clear()
    list(Coordinator(again, memory, memory, execution).run(shard))
    assert 0 < again.played < never.played, "it began anew, or there was nothing left to do"
    assert memory.sorted_rows() == undisturbed.sorted_rows()
    assert memory.runs is not None
    assert undisturbed.runs is not None
    for name in ("position", "train_time", "censored", "episodes", "steps", "steady_state"):
        np.testing.assert_array_equal(getattr(memory.runs, name), getattr(undisturbed.runs, name))
