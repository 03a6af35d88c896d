"""On-policy algorithms of stable-baselines3 as members: they do what SB3 does, with their own episodes alone."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium import spaces

from apel import ActingFloor, Ensemble
from apel.configs import EnvironmentConfig, LearnerConfig
from apel.environments import make_world
from apel.learners.base import Transition
from apel.selectors import Fixed, Uniform
from cluster.checkpoint import pack, unpack

pytest.importorskip("stable_baselines3")
import torch
from stable_baselines3 import A2C, PPO

from apel.learners.stable_baselines.on_policy import StableBaselinesOnPolicy

SEED = 12345678901234567890
SPACE = gymnasium.make("CartPole-v1").observation_space
OPTIONS: dict[str, dict[str, Any]] = {
    "PPO": {"n_steps": 32, "batch_size": 16, "n_epochs": 2, "policy_kwargs": {"net_arch": [8]}},
    "A2C": {"n_steps": 7, "policy_kwargs": {"net_arch": [8]}},
}
MAKERS: dict[str, Any] = {"PPO": PPO, "A2C": A2C}


def made(name: str, seed: int = SEED) -> StableBaselinesOnPolicy:
    path = f"stable_baselines3:{name}"
    return StableBaselinesOnPolicy(
        SPACE, spaces.Discrete(2), seed, algorithm=path, total_timesteps=300, **OPTIONS[name]
    )


def played(learner: Any, environment: Any, num_steps: int, seed: int | None) -> list[int]:
    """Let ``learner`` play; its actions."""
    actions = []
    observation, _ = environment.reset(seed=seed)
    for _ in range(num_steps):
        action, probability = learner.act(observation)
        assert probability.sum() == pytest.approx(1.0)
        following, reward, terminated, truncated, _ = environment.step(action)
        learner.learn(Transition(observation, action, float(reward), following, terminated, truncated, probability))
        observation = following
        actions.append(action)
        if terminated or truncated:
            observation, _ = environment.reset()
    return actions


def environment() -> Any:
    return gymnasium.make("CartPole-v1", max_episode_steps=25)


@pytest.mark.parametrize("name", OPTIONS)
def test_alone_it_does_what_sb3_does(name: str) -> None:
    """The same parameters, to the last bit, as ``learn()`` of SB3 itself, truncated episodes included."""
    learner = made(name)
    reference = MAKERS[name]("MlpPolicy", environment(), seed=learner.algorithm.seed, device="cpu", **OPTIONS[name])
    first = {key: value.clone() for key, value in reference.policy.state_dict().items()}
    reference.learn(300)
    actions = played(learner, environment(), reference.num_timesteps, learner.algorithm.seed)
    own, expected = learner.algorithm.policy.state_dict(), reference.policy.state_dict()
    assert any(not torch.equal(first[key], expected[key]) for key in first)
    for key in expected:
        assert torch.equal(own[key], expected[key]), key
    assert learner.algorithm.num_timesteps == reference.num_timesteps
    assert set(actions) == {0, 1}


@pytest.mark.parametrize("name", OPTIONS)
@pytest.mark.parametrize("num_steps", [64, 75])
def test_checkpoint(name: str, num_steps: int) -> None:
    """One that goes on from a stored state does what the other does, in the middle of a rollout and at its end."""
    one, other = made(name), made(name, seed=3)
    played(one, environment(), num_steps, 1)
    other.restore(unpack(pack(one.state())))
    assert played(one, environment(), 50, 2) == played(other, environment(), 50, 2)
    for key, value in one.algorithm.policy.state_dict().items():
        assert torch.equal(value, other.algorithm.policy.state_dict()[key]), key


def test_probabilities_are_those_of_the_draws() -> None:
    """Shares of 400 actions are within four standard errors of μ."""
    learner = made("PPO")
    observation = np.array([0.3, -1.0, 0.1, 0.5], dtype=np.float32)
    drawn = [learner.act(observation) for _ in range(400)]
    share, chance = np.mean([action for action, _ in drawn]), drawn[0][1][1]
    assert abs(share - chance) < 4 * np.sqrt(chance * (1 - chance) / 400)


def test_member_of_an_ensemble() -> None:
    """It learns from the steps that it played, and from no other; without saying so it is refused."""
    world = make_world(EnvironmentConfig("CartPole-v1"), run_seed=5)
    options = {"algorithm": "stable_baselines3:PPO", **OPTIONS["PPO"]}
    member = LearnerConfig("stable_baselines_on_policy", options, learns_from="own")
    random = LearnerConfig("stable_baselines_on_policy", {**options, "n_steps": 10_000}, learns_from="own")
    ensemble = Ensemble(world, [member, random], Uniform(), 5, 20)
    records = list(ensemble.run())
    for index, learner in enumerate(ensemble.learners):
        steps = sum(record.length for record in records if record.selected == index)
        assert learner.algorithm.num_timesteps == steps > 0  # type: ignore[attr-defined]
    with pytest.raises(ValueError, match="only with learns_from: own"):
        Ensemble(world, [LearnerConfig("stable_baselines_on_policy", options)], Uniform(), 5, 20)


def test_floor_in_a_script() -> None:
    """A floor lets one play that the selector would never choose."""
    world = make_world(EnvironmentConfig("FrozenLake-v1"), run_seed=5)
    learners = [LearnerConfig("q_learning")] * 2
    records = list(Ensemble(world, learners, Fixed(), 5, 100, acting_floor=ActingFloor(0.2)).run())
    shares = [sum(r.length for r in records if r.selected == index) for index in (0, 1)]
    assert shares[1] >= 0.17 * sum(shares)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"algorithm": "stable_baselines3:DQN"}, "OnPolicyAlgorithm"),
        ({"use_sde": True}, "use_sde: found true, expected false"),
    ],
)
def test_refused(options: dict[str, Any], message: str) -> None:
    """What cannot be done is said."""
    with pytest.raises(ValueError, match=message):
        StableBaselinesOnPolicy(SPACE, spaces.Discrete(2), 1, **options)
