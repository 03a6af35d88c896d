"""On-policy algorithms of stable-baselines3 as members: they do what SB3 does, with their own episodes alone."""

from __future__ import annotations

import copy
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium import spaces

from apel import ActingFloor, Ensemble
from apel.configs import EnvironmentConfig, LearnerConfig
from apel.environments import make_world
from apel.learners.base import Transition
from apel.learners.starting import begin
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


def made(name: str, seed: int = SEED, **changed: Any) -> StableBaselinesOnPolicy:
    options = {"algorithm": f"stable_baselines3:{name}", "total_timesteps": 300, **OPTIONS[name], **changed}
    return StableBaselinesOnPolicy(SPACE, spaces.Discrete(2), seed, **options)


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
    reference = MAKERS[name](
        "MlpPolicy", environment(), seed=learner.algorithm.seed, device="cpu", **copy.deepcopy(OPTIONS[name])
    )
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


def test_checkpoint_of_observations_with_parts() -> None:
    """They are columns of the rollout, too, and are stored with it."""
    space = spaces.Dict({"track": SPACE})
    learners = [
        StableBaselinesOnPolicy(space, spaces.Discrete(2), seed, policy="MultiInputPolicy", **OPTIONS["PPO"])
        for seed in (1, 2)
    ]
    played(learners[0], parts(), 40, 1)
    learners[1].restore(unpack(pack(learners[0].state())))
    assert played(learners[0], parts(), 40, 2) == played(learners[1], parts(), 40, 2)
    for key, value in learners[0].algorithm.policy.state_dict().items():
        assert torch.equal(value, learners[1].algorithm.policy.state_dict()[key]), key


def parts() -> Any:
    """CartPole, whose observations have one part."""
    return gymnasium.wrappers.TransformObservation(
        environment(), lambda seen: {"track": seen}, spaces.Dict({"track": SPACE})
    )


@pytest.mark.parametrize(
    ("name", "changed"),
    [
        ("PPO", {"gamma": 0.5, "ent_coef": 0.1, "n_epochs": 3, "batch_size": 8}),
        ("PPO", {"n_steps": 48}),
        ("PPO", {"n_steps": 20, "batch_size": 10}),
        ("A2C", {"n_steps": 3, "gae_lambda": 0.7, "rms_prop_eps": 0.1}),
        ("A2C", {"use_rms_prop": False}),
    ],
)
@pytest.mark.parametrize("num_steps", [64, 75])
def test_one_that_begins_with_another_keeps_its_own_options(name: str, changed: dict[str, Any], num_steps: int) -> None:
    """It takes over what was learned, and then learns with its own options, whatever they are."""
    old, new = made(name), made(name, 3, **changed)
    played(old, environment(), num_steps, 1)
    numbers, of_optimiser = new.state()["numbers"], optimiser_options(new)
    begin(new, unpack(pack(old.state())))
    assert all(vars(new.algorithm)[option] == numbers[option] for option in changed if option in numbers)
    assert optimiser_options(new) == of_optimiser
    buffer, is_alike = new.algorithm.rollout_buffer, "n_steps" not in changed
    assert (buffer.gamma, buffer.gae_lambda) == (new.algorithm.gamma, new.algorithm.gae_lambda)
    assert (buffer.buffer_size, len(buffer.rewards)) == (new.algorithm.n_steps, new.algorithm.n_steps)
    assert buffer.pos == (old.algorithm.rollout_buffer.pos if is_alike else 0)
    for key, value in old.algorithm.policy.state_dict().items():
        assert torch.equal(value, new.algorithm.policy.state_dict()[key]), key
    assert new.algorithm.num_timesteps == num_steps
    before = {key: value.clone() for key, value in new.algorithm.policy.state_dict().items()}
    played(new, environment(), 60, 2)
    assert any(not torch.equal(before[key], value) for key, value in new.algorithm.policy.state_dict().items())


def test_actions_may_count_from_elsewhere() -> None:
    """SB3 counts from 0; what is played lies in the space, and all of it is played."""
    space = spaces.MultiDiscrete([2, 3], start=[1, -1])
    learner = StableBaselinesOnPolicy(SPACE, space, 1, **OPTIONS["A2C"], algorithm="stable_baselines3:A2C")
    here, taken = np.zeros(4, dtype=np.float32), list[Any]()
    for _ in range(60):
        action, probability = learner.act(here)
        taken.append(action)
        learner.learn(Transition(here, action, 1.0, here, False, False, probability))
    assert all(space.contains(action) for action in taken)
    assert {tuple(action.tolist()) for action in taken} == {(i, j) for i in (1, 2) for j in (-1, 0, 1)}
    buffer = learner.algorithm.rollout_buffer
    np.testing.assert_array_equal(buffer.actions[buffer.pos - 1, 0], taken[-1] - space.start)
    with pytest.raises(ValueError, match="expected one of a single dimension"):
        StableBaselinesOnPolicy(SPACE, spaces.MultiDiscrete([[2, 2], [2, 2]]), 1, **OPTIONS["A2C"])


def optimiser_options(learner: StableBaselinesOnPolicy) -> dict[str, Any]:
    """By name; pairs as lists, as checkpoints have them."""
    (options,) = learner.algorithm.policy.optimizer.param_groups
    return {name: np.array(value).tolist() for name, value in options.items() if name != "params"}


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
