"""One run of a deep learner as a plain learner: a batch of one, with the environment's own numbering of actions."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from gymnasium import spaces

from apel.learners import HasActionValues, Learner, SingleLearner, Transition
from apel.learners.base import Freezable
from apel.learners.deep.acer import Acer
from apel.learners.deep.dqn import Dqn
from apel.learners.deep.sac import DiscreteSac
from cluster.checkpoint import pack, unpack
from tests.apel.learners.deep.driving import assert_same_state
from tests.apel.learners.deep.steps import runs_of, transitions

SPACE = spaces.Box(-1.0, 1.0, (2,))
ACTIONS = spaces.Discrete(3, start=5)
NETWORK = {"hidden": [16], "activation": "relu"}
LEARNERS: dict[str, tuple[type[SingleLearner], dict[str, Any]]] = {
    "dqn": (Dqn, {"learning_starts": 5, "batch_size": 4, "network": NETWORK, "head_hidden": [16]}),
    "acer": (Acer, {"learning_starts": 1, "rollout": 4, "batch_size": 2, "network": NETWORK}),
    "sac": (DiscreteSac, {"learning_starts": 5, "batch_size": 4, "network": NETWORK}),
}
each_learner = pytest.mark.parametrize("kind", LEARNERS)


def make(kind: str, seed: int = 3) -> SingleLearner:
    constructor, options = LEARNERS[kind]
    return constructor(SPACE, ACTIONS, seed, **options)


def play(learner: SingleLearner, steps: int, *, knows: bool = True) -> list[Any]:
    """A made-up environment; without ``knows`` nobody says how probable the actions were."""
    rng = np.random.default_rng(1)
    observation, done = rng.uniform(-1, 1, size=2), []
    for t in range(steps):
        action, probability = learner.act(observation)
        following = rng.uniform(-1, 1, size=2)
        ends = t % 5 == 4
        learner.learn(
            Transition(observation, action, float(action == 6), following, ends, False, probability if knows else None)
        )
        if ends:
            learner.end_episode()
        done.append((action, probability.tolist(), learner.action_values(observation).tolist()))
        observation = following
    return done


@each_learner
def test_is_a_learner(kind: str) -> None:
    """It satisfies all protocols: it can vote, freeze, and learn from others."""
    learner = make(kind)
    assert isinstance(learner, Learner)
    assert isinstance(learner, HasActionValues)
    assert isinstance(learner, Freezable)
    assert learner.off_policy


@each_learner
def test_actions_are_those_of_the_environment(kind: str) -> None:
    """An action space {5, 6, 7} is acted in and learned in as such, with probabilities in its order."""
    done = play(make(kind), 60)
    assert {action for action, _, _ in done} == {5, 6, 7}
    assert all(probability[action - 5] > 0.0 for action, probability, _ in done)


@each_learner
@pytest.mark.parametrize("knows", [True, False])
def test_is_a_stack_of_one(kind: str, knows: bool) -> None:
    """The same transitions, with actions counted from 0 and NaN for what is not known, leave the same state."""
    learner = make(kind)
    stack = type(learner).batched_type(SPACE, 3, [3], **LEARNERS[kind][1])
    rng = np.random.default_rng(2)
    for t in range(30):
        seen, following = rng.uniform(-1, 1, size=(2, 2))
        action, reward, probability = int(rng.integers(3)), float(rng.normal()), rng.dirichlet(np.ones(3))
        ends, cut = t % 7 == 6, t % 9 == 8
        learner.learn(Transition(seen, action + 5, reward, following, ends, cut, probability if knows else None))
        stack.learn(
            runs_of(0),
            transitions(
                [seen],
                [following],
                action=action,
                reward=reward,
                terminated=ends,
                truncated=cut,
                probability=[probability] if knows else None,
            ),
        )
    assert_same_state(learner.state(), stack.state())
    first, second = learner.act(seen), stack.act(runs_of(0), seen[None])
    assert (first[0], first[1].tolist()) == (second[0][0] + 5, second[1][0].tolist())


@each_learner
def test_restored_learner_goes_on_identically(kind: str) -> None:
    """A state that went through a file, restored into a learner of another seed."""
    learner, other = make(kind), make(kind, seed=99)
    play(learner, 33)
    learner.freeze()
    other.restore(unpack(pack(learner.state())))
    assert play(other, 30, knows=False) == play(learner, 30, knows=False)
    assert_same_state(other.state(), learner.state())


@each_learner
def test_frozen_policy_stays(kind: str) -> None:
    """It acts on what it knew when it froze while it goes on learning."""
    learner, observation = make(kind), np.array([0.5, -0.5])
    play(learner, 20)
    learner.freeze()
    before = learner.action_values(observation).tolist()
    play(learner, 20)
    assert learner.action_values(observation).tolist() == before
    learner.freeze()
    assert learner.action_values(observation).tolist() != before
