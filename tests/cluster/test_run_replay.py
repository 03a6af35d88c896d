"""A run played again, where that goes wrong; that it is the stored run is tested in `tests.jobs.films.test_watch`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from cluster.run_replay import replay_run
from tests.cluster.shards import shard_of, with_user_code


def test_end_before_the_episode(small: Path) -> None:
    """A run that ends before the wanted episode is refused."""
    shard = shard_of(small, "criterion=null", "episodes=20")
    with pytest.raises(ValueError, match="found the end of the run after 20 episodes, expected more than 20"):
        replay_run(shard.arm, shard.runs[0], 20)


def test_failure_before_the_episode(small: Path) -> None:
    """What ended the run is named."""
    shard = shard_of(small, *with_user_code("raise"))
    assert len(replay_run(shard.arm, shard.runs[0], 3).learner) == 4
    with pytest.raises(ValueError, match="OSError: the motor is stuck"):
        replay_run(shard.arm, shard.runs[0], 70)


def test_learner_that_cannot_be_built(small: Path) -> None:
    """It is told like a bad field."""
    shard = shard_of(small)
    run = replace(shard.runs[0], learners=(replace(shard.runs[0].learners[0], type="no.such:Learner"),) * 2)
    with pytest.raises(ValueError, match=r"importing 'no\.such' failed"):
        replay_run(shard.arm, run, 3)
