from __future__ import annotations

import pickle
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from apel.learners.banks.compiled_streaks import learn_episodes
from apel.learners.base import Played
from apel.run.state import _replay
from cluster.local import LocalHosts
from tests.cluster.shards import Memory, play, shard_of


def arrived(value: Any) -> Any:
    """What comes out at the other end of Ray: the same arrays, on memory that cannot be written to."""
    buffers: list[pickle.PickleBuffer] = []
    data = pickle.dumps(value, protocol=5, buffer_callback=buffers.append)
    return pickle.loads(data, buffers=[buffer.raw().tobytes() for buffer in buffers])


class DistantHosts(LocalHosts):
    """Hosts in this process whose answers arrive as from another."""

    def play(self, orders: Sequence[Sequence[int]]) -> list[Played]:
        answers = arrived(super().play(orders))
        self._last = arrived(self._last)
        assert not any(column.flags.writeable for played in answers for column in played.episodes)
        return answers  # type: ignore[no-any-return]


@pytest.mark.parametrize("arm", ["APEL", "SSBAS"])
def test_actors_have_nothing_left_to_compile(small: Path, arm: str) -> None:
    """Kernels that were compiled for what is at hand serve for what arrives from an actor, which cannot be written to:
    else every actor would compile them anew, side by side, for a minute.
    """
    if not hasattr(_replay, "signatures"):
        pytest.skip("nothing is compiled")
    shard = shard_of(small, arm=arm)
    here, there = Memory(), Memory()
    play(shard, here)
    forms = [list(kernel.signatures) for kernel in (learn_episodes, _replay)]
    play(shard, there, hosts=DistantHosts())
    assert [list(kernel.signatures) for kernel in (learn_episodes, _replay)] == forms
    assert here.sorted_rows() == there.sorted_rows()
    assert here.runs is not None
    assert there.runs is not None
    for name, column in vars(here.runs).items():
        np.testing.assert_array_equal(column, getattr(there.runs, name))
