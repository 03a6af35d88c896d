"""stable-baselines3's algorithms with continuous actions as base learners."""

from __future__ import annotations

import copy
import pkgutil
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium import spaces

from apel.learners.base import HasActionValues, HasGreedyAction, Transition
from apel.learners.starting import begin
from cluster.checkpoint import pack, unpack
from tests.apel.learners.test_stable_baselines import SEED, assert_same_parameters, episodes, parameters

pytest.importorskip("stable_baselines3")
pytest.importorskip("sb3_contrib")
from apel.learners.stable_baselines.adapter import StableBaselines
from apel.learners.stable_baselines.exploration import noise_of

SMALL = {"learning_starts": 20, "batch_size": 8, "buffer_size": 40, "policy_kwargs": {"net_arch": [6]}}
NOISE = {"type": "ornstein_uhlenbeck", "sigma": 0.3, "theta": 0.2}
ALGORITHMS: dict[str, dict[str, Any]] = {
    "stable_baselines3:SAC": {},
    "stable_baselines3:TD3": {"action_noise": NOISE},
    "stable_baselines3:DDPG": {"action_noise": {"type": "normal", "sigma": 0.2}, "train_freq": [1, "episode"]},
    "sb3_contrib:TQC": {"action_noise": {"type": "normal", "sigma": 0.2}},
    "sb3_contrib:CrossQ": {},
}
PENDULUM = gymnasium.make("Pendulum-v1")
UNEVEN = spaces.Box(np.array([-1, 0], np.float32), np.array([1, 5], np.float32))


def pendulum() -> gymnasium.Env[Any, Any]:
    return gymnasium.make("Pendulum-v1", max_episode_steps=25)


def learner_of(algorithm: str, actions: spaces.Box = UNEVEN, **options: Any) -> StableBaselines:
    observations = PENDULUM.observation_space
    return StableBaselines(
        observations, actions, options.pop("seed", SEED), algorithm=algorithm, **{**SMALL, **options}
    )


def transitions(count: int, actions: spaces.Box = UNEVEN) -> list[Transition]:
    """What another learner did."""
    draws = np.random.default_rng(4)
    observations = draws.normal(size=(count + 1, 3)).astype(np.float32)
    chosen = [draws.uniform(actions.low, actions.high).astype(np.float32) for _ in range(count)]
    return [
        Transition(observations[i], chosen[i], float(chosen[i].sum()), observations[i + 1], False, i % 9 == 8, None)
        for i in range(count)
    ]


@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_alone_it_does_what_sb3_does(algorithm: str) -> None:
    """The same actions, buffer and parameters, to the last bit, as ``learn()`` of SB3 itself."""
    options = ALGORITHMS[algorithm]
    environment = pendulum()
    space: Any = environment.action_space
    learner = learner_of(algorithm, space, total_timesteps=45, **options)
    first = parameters(learner)
    theirs = {**copy.deepcopy(SMALL), **options, "action_noise": noise_of(options.get("action_noise"), space)}
    if "train_freq" in theirs:
        theirs["train_freq"] = tuple(theirs["train_freq"])
    kind: Any = pkgutil.resolve_name(algorithm)
    reference = kind("MlpPolicy", environment, seed=learner.algorithm.seed, device="cpu", **theirs)
    reference.learn(45)
    actions = list(episodes(learner, pendulum(), reference.num_timesteps, learner.algorithm.seed))
    assert_same_parameters(parameters(learner), dict(reference.policy.state_dict()))
    assert any((first[name] != value).any() for name, value in parameters(learner).items())
    for column in ("observations", "actions", "rewards", "dones", "timeouts"):
        found, expected = (getattr(one.replay_buffer, column) for one in (learner.algorithm, reference))
        np.testing.assert_array_equal(found, expected, err_msg=column)
    assert len({float(action[0]) for action in actions}) > 35


def test_one_that_begins_with_another_keeps_its_own_entropy_coefficient() -> None:
    """Where it is told, and not learned."""
    old, new = (learner_of("stable_baselines3:SAC", seed=seed, ent_coef=0.1 * seed) for seed in (1, 2))
    begin(new, unpack(pack(old.state())))
    assert float(new.algorithm.ent_coef_tensor) == pytest.approx(0.2)
    assert_same_parameters(parameters(new), old.algorithm.policy.state_dict())


def test_one_that_begins_with_another_keeps_its_own_noise_and_returns() -> None:
    """Noise of another kind has no past here; nor is the memory told the other one's γ, or how many steps it sums."""
    normal, process = ({"type": name, "sigma": 0.1} for name in ("normal", "ornstein_uhlenbeck"))
    old = learner_of("stable_baselines3:TD3", PENDULUM.action_space, action_noise=normal, n_steps=2, gamma=0.9)
    new = learner_of("stable_baselines3:TD3", PENDULUM.action_space, seed=2, action_noise=process, n_steps=5, gamma=0.8)
    list(episodes(old, pendulum(), 48, 1))
    begin(new, unpack(pack(old.state())))
    memory = new.algorithm.replay_buffer
    assert (memory.gamma, memory.n_steps, memory.size()) == (0.8, 5, 40)
    list(episodes(new, pendulum(), 48, 1))
    assert np.abs(new.algorithm.action_noise.noise_prev).max() > 0


@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_checkpoint(algorithm: str) -> None:
    """After a checkpoint in the middle of a rollout nothing differs from going on, the noise's past included."""
    one, other = (learner_of(algorithm, PENDULUM.action_space, seed=seed, **ALGORITHMS[algorithm]) for seed in (1, 2))
    list(episodes(one, pendulum(), 48, 1))
    list(episodes(other, pendulum(), 10, 1))  # what it has learned must go
    one.freeze()
    content = pack(one.state())
    actions = list(episodes(one, pendulum(), 20, 5))
    other.restore(unpack(content))
    assert list(episodes(other, pendulum(), 20, 5)) == actions
    assert_same_parameters(parameters(one), parameters(other))
    assert pack(one.state()) == pack(other.state())


@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_learns_from_others_and_acts_within_bounds(algorithm: str) -> None:
    """Others' actions are remembered scaled; its own lie within bounds of any width, the greedy one too."""
    learner = learner_of(algorithm, **ALGORITHMS[algorithm])
    shown = transitions(40)
    for transition in shown:
        learner.learn(transition)
        action, _ = learner.act(transition.observation)
        assert UNEVEN.contains(action)
    replay = learner.algorithm.replay_buffer
    np.testing.assert_allclose(replay.actions[7, 0], [shown[7].action[0], shown[7].action[1] / 2.5 - 1], rtol=1e-5)
    assert isinstance(learner, HasGreedyAction)
    assert not isinstance(learner, HasActionValues)
    before = pack(learner.state())
    greedy = learner.greedy_action(shown[0].observation)
    assert UNEVEN.contains(greedy)
    np.testing.assert_array_equal(greedy, learner.greedy_action(shown[0].observation))
    assert pack(learner.state()) == before
    learner.freeze()
    for transition in transitions(60):
        learner.learn(transition)
    np.testing.assert_array_equal(greedy, learner.greedy_action(shown[0].observation))
    learner.freeze()
    assert (greedy != learner.greedy_action(shown[0].observation)).any()


def test_actions_rounded_across_a_bound_are_put_onto_it() -> None:
    """Where low + (high − low) is not high in ``float32``."""
    space = spaces.Box(np.float32(-1.4), np.float32(0.8), (1,))
    learner = learner_of("stable_baselines3:TD3", space, learning_starts=0)
    beyond = learner.algorithm.policy.unscale_action(np.ones((1, 1), np.float32))
    assert beyond[0, 0] > space.high[0]
    assert space.contains(learner._within_bounds(beyond[0]))


@pytest.mark.parametrize("algorithm", ["stable_baselines3:SAC", "sb3_contrib:TQC", "sb3_contrib:CrossQ"])
def test_density(algorithm: str) -> None:
    """Uniform before learning starts; then that of the squashed Gaussian: what is drawn is as likely as it says."""
    space = spaces.Box(np.array([-3], np.float32), np.array([5], np.float32))
    learner, shown = learner_of(algorithm, space), transitions(40, space)
    for transition in shown[:20]:
        action, density = learner.act(transition.observation)
        assert density == pytest.approx(1 / 8)
        learner.learn(transition._replace(action=action))
    for transition in shown[20:]:
        learner.learn(transition)
    drawn = [learner.act(shown[0].observation) for _ in range(600)]
    actions = np.array([action[0] for action, _ in drawn])
    order = np.argsort(actions)
    densities = np.array([density for _, density in drawn], dtype=np.float64)[order]
    sorted_actions = actions[order]
    middle = (sorted_actions > -2.5) & (sorted_actions < 4.5)
    inside = np.trapezoid(densities[middle], sorted_actions[middle])
    assert abs(inside - middle.mean()) < 0.09  # four standard deviations of the mean, and the trapezia
    assert 0.3 < inside <= 1.01


def test_densities_that_are_not_known() -> None:
    for algorithm, options in (("TD3", {}), ("SAC", {"action_noise": NOISE}), ("DDPG", {})):
        learner = learner_of(f"stable_baselines3:{algorithm}", **options)
        assert [learner.act(one.observation)[1] for one in transitions(3)] == [None] * 3


REFUSED: dict[str, tuple[dict[str, Any], str]] = {
    "a number for noise": ({"action_noise": 0.1}, "action_noise: found 0.1, expected {type: normal or ornstein"),
    "no such noise": ({"action_noise": {"type": "pink"}}, "action_noise: found .*pink.*, expected {type: normal or"),
    "noise without size": ({"action_noise": {"type": "normal"}}, "action_noise.sigma: found none"),
    "negative noise": ({"action_noise": {"type": "normal", "sigma": -1}}, "action_noise.sigma: found -1"),
    "another's option": ({"action_noise": {"type": "normal", "sigma": 1, "theta": 1}}, r"action_noise.theta: found 1"),
    "noise of rollouts": ({"use_sde": True}, "found use_sde: True, expected False"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_refused_options(name: str) -> None:
    options, message = REFUSED[name]
    with pytest.raises(ValueError, match=message):
        learner_of("stable_baselines3:SAC", **options)


def test_noise_of_discrete_actions_is_refused() -> None:
    with pytest.raises(ValueError, match=r"action_noise: found .* for the actions Discrete"):
        StableBaselines(PENDULUM.observation_space, spaces.Discrete(2), 1, action_noise={"type": "normal", "sigma": 1})


def test_observations_with_parts() -> None:
    """``MultiInputPolicy`` sees a Dict; all of its parts are in the buffer, and in the checkpoint."""
    space = spaces.Dict(
        {
            "at": spaces.Box(-1, 1, (2,)),
            "what": spaces.Discrete(3, start=1),
            "grid": spaces.MultiDiscrete([[2, 3], [2, 2]]),
        }
    )
    space.seed(1)
    made = [
        StableBaselines(space, UNEVEN, seed, algorithm="stable_baselines3:SAC", policy="MultiInputPolicy", **SMALL)
        for seed in (1, 2)
    ]
    one, other = made
    seen = [space.sample() for _ in range(41)]
    for i, transition in enumerate(transitions(40)):
        one.learn(transition._replace(observation=seen[i], next_observation=seen[i + 1]))
    other.restore(unpack(pack(one.state())))
    assert one.algorithm.replay_buffer.observations["what"][5, 0] == seen[5]["what"] - 1
    for name, column in one.algorithm.replay_buffer.next_observations.items():
        np.testing.assert_array_equal(column, other.algorithm.replay_buffer.next_observations[name])
    np.testing.assert_array_equal(one.act(seen[0])[0], other.act(seen[0])[0])
