"""Learners that begin with what another one has learned, and how far the other may differ."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from gymnasium import spaces

import apel
from apel.learners.base import Transition
from apel.learners.deep.acer import Acer
from apel.learners.deep.dqn import Dqn
from apel.learners.deep.sac import DiscreteSac
from apel.learners.starting import begin

SPACE = spaces.Box(-1, 1, (3,))
KINDS: dict[str, Any] = {"dqn": Dqn, "sac": DiscreteSac, "acer": Acer}
SMALL = {"network": {"hidden": [4]}, "learning_starts": 10_000}


def made(kind: str, replay_size: int, num_steps: int) -> Any:
    """A learner that has seen so many steps, none of which had the reward 0."""
    learner = KINDS[kind](SPACE, spaces.Discrete(2), 1, replay_size=replay_size, **SMALL)
    for step in range(num_steps):
        here, there = (np.full(3, 0.01 * number, dtype=np.float32) for number in (step, step + 1))
        learner.learn(Transition(here, step % 2, 1.0 + step, there, False, (step + 1) % 25 == 0, np.full(2, 0.5)))
    return learner


@pytest.mark.parametrize(("kind", "own"), [("dqn", 40), ("sac", 40), ("acer", 3)])
@pytest.mark.parametrize("other", [1_000, 2])
def test_full_memory_fits_one_of_its_size_alone(kind: str, own: int, other: int) -> None:
    """Where the oldest were overwritten the others stand in slots that are not theirs in another size; ACER counts
    segments.
    """
    old = made(kind, own, 120)
    begin(made(kind, own, 0), old.state())
    with pytest.raises(ValueError, match=f"room for {other} in the replay memory, expected {own}"):
        begin(made(kind, other, 0), old.state())


@pytest.mark.parametrize("kind", KINDS)
def test_memory_with_room_left_fits_a_larger_one(kind: str) -> None:
    """All that it remembers is taken over, and nothing else."""
    old, new = made(kind, 500, 50), made(kind, 1_000, 0)
    begin(new, old.state())
    columns = [[np.array(column) for column in memory(one)["columns"]] for one in (old, new)]
    for one, other in zip(*columns, strict=True):
        np.testing.assert_array_equal(one, other)


def memory(learner: Any) -> dict[str, Any]:
    """The state of its memory."""
    (found,) = (part for part in learner.state().values() if isinstance(part, dict) and "columns" in part)
    return found


def test_ensemble_begins_with_what_is_told() -> None:
    """`apel.Ensemble` begins as a job does."""
    config = apel.EnvironmentConfig("FrozenLake-v1")
    world = apel.make_world(config, run_seed=1)
    old = apel.Ensemble(world, [apel.LearnerConfig("q_learning")], apel.Uniform(), 1, 30)
    list(old.run())
    agent = old.agent(config, ["Q"])
    start = agent.content.start("Q", agent.digest)
    new = apel.Ensemble(world, [apel.LearnerConfig("q_learning", start=start)], apel.Uniform(), 1, 30)
    tables = [{key: row.tolist() for key, row in one.learners[0].table.items()} for one in (old, new)]  # type: ignore[attr-defined]
    assert tables[0] == tables[1] != {}


@pytest.mark.parametrize("action", [39_999, 32_768, 32_767])
@pytest.mark.parametrize("kind", ["dqn", "acer"])
def test_more_actions_than_sixteen_bits_count(kind: str, action: int) -> None:
    """The action that is remembered is the one that was taken."""
    heads = {"head_hidden": [4]} if kind == "dqn" else {}
    learner = KINDS[kind](SPACE, spaces.Discrete(40_000), 1, replay_size=40, **SMALL, **heads)
    here = np.zeros(3, dtype=np.float32)
    for _ in range(3):
        learner.learn(Transition(here, action, 1.0, here, True, False, None))
    assert action in memory(learner)["columns"][1]
