"""stable-baselines3 as a base learner: it does what SB3 does, and knows of no other learner in the process."""

from __future__ import annotations

import random
import subprocess
import sys
from collections.abc import Iterator
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium import spaces

from apel.configs import EnvironmentConfig, LearnerConfig
from apel.environments import make_world
from apel.learners.base import HasActionValues, Learner, Transition
from apel.learners.stable_baselines.adapter import StableBaselines
from apel.learners.starting import begin
from apel.run.criterion import Criterion
from apel.selectors import Apel
from cluster.checkpoint import pack, unpack
from tests.apel.rounds import assert_same_rows, ensemble_rows, make_banks, play_rounds

pytest.importorskip("stable_baselines3")
import torch
from stable_baselines3 import DQN
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm

HERE = "tests.apel.learners.test_stable_baselines"
SEED = 12345678901234567890
SMALL = {"policy_kwargs": {"net_arch": [8]}}
EAGER = {"learning_starts": 20, "buffer_size": 150, "target_update_interval": 30, "exploration_fraction": 0.5, **SMALL}
CART_POLE = gymnasium.make("CartPole-v1").observation_space


class Sure(DQN):
    """Explores in a way of its own: never."""

    def predict(self, *arguments: Any, deterministic: bool = False) -> Any:
        return self.policy.predict(arguments[0], deterministic=True)


class Stubborn(OffPolicyAlgorithm):
    """No relative of DQN: it has a policy that it never trains."""

    policy_aliases = DQN.policy_aliases

    def __init__(self, policy: str, env: Any, **options: Any) -> None:
        super().__init__(policy, env, 0.1, sde_support=False, supported_action_spaces=(spaces.Discrete,), **options)
        self._setup_model()
        self.num_trained = 0

    def train(self, gradient_steps: int, batch_size: int) -> None:
        self.num_trained += gradient_steps


def falling(progress: float) -> float:
    """A learning rate that ends at zero."""
    return 0.01 * progress


def cart_pole(**options: Any) -> StableBaselines:
    return StableBaselines(CART_POLE, spaces.Discrete(2), options.pop("seed", SEED), **{**EAGER, **options})


def episodes(learner: Learner, environment: Any, num_steps: int, seed: int | None = None) -> Iterator[int]:
    """Let ``learner`` play; yields its actions."""
    observation, _ = environment.reset(seed=seed)
    for _ in range(num_steps):
        action, probability = learner.act(observation)
        following, reward, terminated, truncated, _ = environment.step(action)
        learner.learn(Transition(observation, action, float(reward), following, terminated, truncated, probability))
        observation = following
        yield action
        if terminated or truncated:
            learner.end_episode()
            observation, _ = environment.reset()


def random_transitions(seed: int, num_steps: int) -> list[Transition]:
    """What another learner did: twelve-step episodes of noise."""
    draws = np.random.default_rng(seed)
    observations = draws.normal(size=(num_steps + 1, 4)).astype(np.float32)
    return [
        Transition(
            observations[i],
            int(draws.integers(2)),
            float(draws.normal()),
            observations[i + 1],
            False,
            i % 12 == 11,
            None,
        )
        for i in range(num_steps)
    ]


def parameters(learner: StableBaselines) -> dict[str, Any]:
    return {name: tensor.clone() for name, tensor in learner.algorithm.policy.state_dict().items()}


def assert_same_parameters(one: dict[str, Any], other: dict[str, Any]) -> None:
    assert one.keys() == other.keys()
    for name in one:
        assert torch.equal(one[name], other[name]), name


LOOPS = {
    "steps": {"train_freq": 4},
    "episodes": {"train_freq": (2, "episode"), "gradient_steps": -1, "tau": 0.5},
    "several steps of return": {"train_freq": 3, "gradient_steps": 2, "n_steps": 3},
    "schedules": {"learning_rate": falling, "learning_starts": 0, "exploration_final_eps": 0.2},
    "half the memory": {"optimize_memory_usage": True, "replay_buffer_kwargs": {"handle_timeout_termination": False}},
}


@pytest.mark.parametrize("name", LOOPS)
def test_alone_it_does_what_sb3_does(name: str) -> None:
    """The same actions, replay buffer and parameters, to the last bit, as ``learn()`` of SB3 itself.

    Episodes are cut off after 30 steps, so that truncation is among what is compared.
    """
    learner = cart_pole(total_timesteps=300, **LOOPS[name])
    first = parameters(learner)
    environment = gymnasium.make("CartPole-v1", max_episode_steps=30)
    reference = DQN("MlpPolicy", environment, seed=learner.algorithm.seed, device="cpu", **{**EAGER, **LOOPS[name]})
    reference.learn(300)
    own = gymnasium.make("CartPole-v1", max_episode_steps=30)
    actions = list(episodes(learner, own, reference.num_timesteps, learner.algorithm.seed))
    assert_same_parameters(parameters(learner), dict(reference.policy.state_dict()))
    assert any(not torch.equal(first[name], value) for name, value in parameters(learner).items())
    replay, expected = learner.algorithm.replay_buffer, reference.replay_buffer
    assert expected is not None
    for column in ("observations", "actions", "rewards", "dones", "timeouts"):
        np.testing.assert_array_equal(getattr(replay, column), getattr(expected, column), err_msg=column)
    assert replay.full
    assert len(set(actions)) == 2
    for counter in ("num_timesteps", "_n_updates", "_episode_num", "_n_calls", "exploration_rate"):
        assert getattr(learner.algorithm, counter) == getattr(reference, counter), counter


def test_learns_from_what_others_did() -> None:
    """Shown only how another acts at random, it finds the one good action of each state."""
    learner = StableBaselines(
        spaces.Discrete(5),
        spaces.Discrete(5, start=1),
        SEED,
        learning_rate=0.01,
        learning_starts=20,
        train_freq=1,
        **SMALL,
    )
    draws = np.random.default_rng(7)
    state = 0
    for _ in range(400):
        action, following = int(draws.integers(1, 6)), int(draws.integers(5))
        learner.learn(Transition(state, action, float(action == state + 1), following, True, False, None))
        learner.end_episode()
        state = following
    assert [int(np.argmax(learner.action_values(state))) for state in range(5)] == [0, 1, 2, 3, 4]
    assert {learner.act(0)[0] for _ in range(200)} <= {1, 2, 3, 4, 5}


def test_truncation() -> None:
    """Only a state in which the episode terminated has no value."""
    learner = cart_pole()
    one = random_transitions(3, 1)[0]
    for terminated, truncated in ((False, False), (True, False), (False, True), (True, True)):
        learner.learn(one._replace(terminated=terminated, truncated=truncated))
    replay = learner.algorithm.replay_buffer
    assert replay.dones[:4, 0].tolist() == [0, 1, 1, 1]
    assert replay.timeouts[:4, 0].tolist() == [0, 0, 1, 0]
    assert learner.algorithm._episode_num == 3


def test_learners_do_not_disturb_each_other() -> None:
    """Two learners that take turns, with others drawing from the process's streams, do what each does alone."""
    others = random_transitions(5, 90)

    def life(seed: int) -> Iterator[Any]:
        learner = cart_pole(seed=seed, exploration_final_eps=0.5)
        for transition in others:
            learner.learn(transition)
            yield learner.act(transition.observation)[0]
        yield parameters(learner)

    alone = [list(life(seed)) for seed in (1, 2)]
    together: list[list[Any]] = [[], []]
    for pair in zip(life(1), life(2), strict=True):
        random.random(), np.random.random(), torch.rand(1), gymnasium.make("CartPole-v1").action_space.sample()  # noqa: NPY002
        for one, it in zip(together, pair, strict=True):
            one.append(it)
    assert together[0][:-1] == alone[0][:-1] != alone[1][:-1] == together[1][:-1]
    assert_same_parameters(together[0][-1], alone[0][-1])
    assert_same_parameters(together[1][-1], alone[1][-1])


def test_the_process_s_random_states_stay() -> None:
    """No call draws from the process's streams, nor from those of the spaces it was given."""

    def states() -> list[Any]:
        words = np.random.get_state(legacy=False)  # noqa: NPY002
        return [
            random.getstate(),
            repr(words),
            torch.get_rng_state().tolist(),
            *(s.np_random.bit_generator.state for s in own),
        ]

    own = [spaces.Box(-1, 1, (4,)), spaces.Discrete(2)]
    before = states()
    learner = StableBaselines(own[0], own[1], SEED, **EAGER)
    assert states() == before
    for transition in random_transitions(1, 40):
        learner.act(transition.observation)
        assert states() == before
        learner.learn(transition)
        learner.action_values(transition.observation)
        learner.end_episode()
        assert states() == before
    learner.freeze()
    learner.restore(learner.state())
    assert states() == before


@pytest.mark.parametrize("num_steps", [0, 14, 90, 210])
@pytest.mark.parametrize("algorithm", ["stable_baselines3:DQN", f"{HERE}:Stubborn"])
def test_checkpoint(num_steps: int, algorithm: str) -> None:
    """After a checkpoint at any step, with the buffer empty, begun or full, nothing differs from going on."""
    options = {**EAGER, "learning_rate": 0.01} if algorithm.endswith("DQN") else {"buffer_size": 150, **SMALL}
    options = {**options, "algorithm": algorithm, "train_freq": 4}
    one, other = (StableBaselines(CART_POLE, spaces.Discrete(2), seed, **options) for seed in (1, 2))
    environments = [gymnasium.make("CartPole-v1") for _ in range(2)]
    list(episodes(one, environments[0], num_steps, 1))
    if algorithm.endswith("DQN") and num_steps == 90:
        one.freeze()
    list(episodes(other, environments[1], 30, 1))  # what it has learned must go
    content = pack(one.state())
    actions = list(episodes(one, environments[0], 61, 5))
    other.restore(unpack(content))
    assert list(episodes(other, environments[1], 61, 5)) == actions
    assert_same_parameters(parameters(one), parameters(other))
    assert pack(one.state()) == pack(other.state())
    if isinstance(one, HasActionValues):
        assert one.action_values(np.ones(4)).tolist() == other.action_values(np.ones(4)).tolist()


def test_checkpoint_with_half_the_memory() -> None:
    """The last next observation, which stands where the next step will be written, is part of the state."""
    half = {"optimize_memory_usage": True, "replay_buffer_kwargs": {"handle_timeout_termination": False}}
    one, other = cart_pole(seed=1, **half), cart_pole(seed=2, **half)
    for transition in random_transitions(1, 41):
        one.learn(transition)
    other.restore(unpack(pack(one.state())))
    np.testing.assert_array_equal(other.algorithm.replay_buffer.observations, one.algorithm.replay_buffer.observations)
    assert one.algorithm.replay_buffer.observations[41].any()


def test_one_that_begins_with_another_keeps_the_options_of_its_optimiser() -> None:
    """What the other's remembers of gradients is taken over, but not what its constructor was told."""
    told = {"net_arch": [8], "optimizer_kwargs": {"eps": 0.1}}
    old, new = cart_pole(), cart_pole(seed=1, policy_kwargs=told, learning_rate=0.5)
    list(episodes(old, gymnasium.make("CartPole-v1"), 60, 1))
    begin(new, unpack(pack(old.state())))
    (group,) = new.algorithm.policy.optimizer.param_groups
    assert (group["eps"], group["lr"]) == (0.1, 0.5)
    assert_same_parameters(parameters(new), parameters(old))
    moments, expected = (one.algorithm.policy.optimizer.state_dict()["state"] for one in (new, old))
    assert len(expected) > 0
    assert all(torch.equal(moments[key]["exp_avg"], expected[key]["exp_avg"]) for key in expected)


def test_probabilities() -> None:
    """μ is uniform before ``learning_starts``, then 1 − ε + ε/n for the greedy action and ε/n for the others."""
    learner = cart_pole(total_timesteps=100, exploration_final_eps=0.1)
    rates = []
    for transition in random_transitions(2, 60):
        rate = 1.0 if learner.algorithm.num_timesteps < 20 else learner.algorithm.exploration_rate
        expected = np.full(2, rate / 2)
        expected[np.argmax(learner.action_values(transition.observation))] += 1 - rate
        _, probability = learner.act(transition.observation)
        assert probability is not None
        np.testing.assert_allclose(probability, expected, rtol=0, atol=1e-15)
        assert probability.sum() == pytest.approx(1.0, abs=1e-12)
        rates.append(rate)
        learner.learn(transition)
    assert rates[:20] == [1.0] * 20
    assert rates[20] == pytest.approx(1 - 0.9 * 20 / 50)  # falls from 1 to 0.1 within half of the 100 steps
    assert rates[50:] == pytest.approx([0.1] * 10)


def test_actions_follow_the_probabilities() -> None:
    """Of 1000 actions, as many are greedy as μ says: 800 ± 50, which is four standard deviations."""
    learner = cart_pole(total_timesteps=20, exploration_final_eps=0.4)
    for transition in random_transitions(2, 30):
        learner.learn(transition)
    observation = np.zeros(4, dtype=np.float32)
    _, probability = learner.act(observation)
    assert probability is not None
    assert sorted(probability.tolist()) == pytest.approx([0.2, 0.8])
    count = sum(learner.act(observation)[0] == np.argmax(probability) for _ in range(1000))
    assert abs(count - 800) <= 50


def test_schedules_stay_at_their_end() -> None:
    """Beyond ``total_timesteps`` no rate becomes negative."""
    learner = cart_pole(total_timesteps=30, learning_rate=f"{HERE}:falling", train_freq=1)
    for transition in random_transitions(2, 45):
        learner.learn(transition)
    assert learner.algorithm.exploration_rate == pytest.approx(0.05)
    assert learner.algorithm.policy.optimizer.param_groups[0]["lr"] == 0.0
    assert learner.algorithm._n_updates == 25


def test_frozen_policy() -> None:
    """It acts on what it knew, with today's ε, while it goes on learning."""
    learner = cart_pole(train_freq=1, learning_rate=0.05, total_timesteps=40)
    transitions = random_transitions(2, 80)
    observations = np.array([transition.observation for transition in transitions])
    for transition in transitions[:40]:
        learner.learn(transition)
    learner.freeze()
    known = [learner.action_values(observation).tolist() for observation in observations]
    learned = parameters(learner)
    for transition in transitions[40:]:
        learner.learn(transition)
    assert [learner.action_values(observation).tolist() for observation in observations] == known
    greedy = [int(np.argmax(learner.act(observation)[1])) for observation in observations]
    assert greedy == [int(np.argmax(values)) for values in known]
    assert not torch.equal(learned["q_net.q_net.0.weight"], parameters(learner)["q_net.q_net.0.weight"])
    learner.freeze()
    assert [learner.action_values(observation).tolist() for observation in observations] != known


def test_algorithms_of_unknown_exploration() -> None:
    """Where the exploration is not DQN's own, μ is not known and nothing can be frozen; values only of DQN's kin."""
    sure = cart_pole(algorithm=f"{HERE}:Sure")
    stubborn = StableBaselines(CART_POLE, spaces.Discrete(2), SEED, algorithm=f"{HERE}:Stubborn", buffer_size=50)
    for transition in random_transitions(2, 130):
        for learner in (sure, stubborn):
            assert learner.act(transition.observation)[1] is None
            learner.learn(transition)
    for learner in (sure, stubborn):
        with pytest.raises(TypeError, match=r"found the algorithm \w+, expected one that explores as those"):
            learner.freeze()
    assert isinstance(sure, HasActionValues)
    assert not isinstance(stubborn, HasActionValues)
    assert stubborn.algorithm.num_trained == 30  # 130 steps, of which 100 were before learning starts


def test_quantile_regression() -> None:
    """QR-DQN's values are the means of its quantiles."""
    pytest.importorskip("sb3_contrib")
    learner = cart_pole(algorithm="sb3_contrib:QRDQN", policy_kwargs={"net_arch": [8], "n_quantiles": 5})
    for transition in random_transitions(2, 30):
        learner.learn(transition)
    observation = np.zeros(4, dtype=np.float32)
    with torch.no_grad():
        quantiles = learner.algorithm.quantile_net(torch.zeros(1, 4)).numpy()
    assert quantiles.shape == (1, 5, 2)
    np.testing.assert_allclose(learner.action_values(observation), quantiles[0].mean(axis=0), rtol=1e-6)
    assert learner.act(observation)[1] is not None


def test_images() -> None:
    """Pictures get to the networks and into the buffer with the channels first, also the last one of an episode."""
    space = spaces.Box(0, 255, (36, 36, 3), np.uint8)
    learner = StableBaselines(space, spaces.Discrete(2), SEED, policy="CnnPolicy", buffer_size=10)
    pictures = np.random.default_rng(1).integers(0, 256, size=(2, 36, 36, 3), dtype=np.uint8)
    learner.act(pictures[0])
    learner.learn(Transition(pictures[0], 1, 1.0, pictures[1], True, False, None))
    replay = learner.algorithm.replay_buffer
    np.testing.assert_array_equal(replay.observations[0, 0], pictures[0].transpose(2, 0, 1))
    np.testing.assert_array_equal(replay.next_observations[0, 0], pictures[1].transpose(2, 0, 1))
    assert learner.action_values(pictures[0]).shape == (2,)


def test_options_as_a_file_has_them() -> None:
    """Classes and functions by import path, and a list where SB3 wants a tuple."""
    learner = cart_pole(
        train_freq=[1, "episode"], policy_kwargs={"net_arch": [3], "activation_fn": "torch.nn:Tanh"}, learning_rate=0.5
    )
    assert learner.algorithm.train_freq.unit.value == "episode"
    assert isinstance(learner.algorithm.q_net.q_net[1], torch.nn.Tanh)


def test_in_ensembles() -> None:
    """With Q-learning, several runs in turn in one process, measured greedily: rows as those of each run on its own."""
    learners = [
        LearnerConfig(
            f"{StableBaselines.__module__}:StableBaselines", {"learning_starts": 10, "buffer_size": 500, **SMALL}
        ),
        LearnerConfig("q_learning"),
    ]
    seeds = [1892932127, 501869158]
    config = EnvironmentConfig("apel/Maze-v0", {"size": 3, "max_steps": 20}, run_seed="maze_seed")
    worlds = [make_world(config, seed) for seed in seeds]
    criterion = Criterion("length", 3, below=0.5, evaluation="greedy")
    rows, _ = ensemble_rows(learners, worlds, seeds, Apel(), 25, criterion=criterion)
    banks = make_banks(learners, worlds, seeds, evaluates=True)
    played = play_rounds(banks, worlds, seeds, Apel(), 25, criterion=criterion)
    assert not played.failures
    assert_same_rows(played.rows, rows)
    assert {row[1] for row in rows[0]} == {0, 1}


REFUSED: dict[str, tuple[dict[str, Any], str]] = {
    "on-policy": (
        {"algorithm": "stable_baselines3:PPO"},
        "algorithm: found 'stable_baselines3:PPO', expected a subclass of stable-baselines3's OffPolicyAlgorithm",
    ),
    "continuous only": (
        {"algorithm": "stable_baselines3:SAC"},
        r"found the action space Discrete\(2\), expected Box, or another learner, such as voting, dqn, .*3:DQN",
    ),
    "no algorithm": ({"algorithm": "stable_baselines3:DQ"}, "found 'stable_baselines3:DQ', expected an import path"),
    "no module": ({"algorithm": "stable_baselines4:DQN"}, "No module named 'stable_baselines4'"),
    "no policy": ({"policy": "Mlp"}, "Policy Mlp unknown"),
    "no such option": ({"buffer": 3}, "unexpected keyword argument 'buffer'"),
    "no function": ({"learning_rate": f"{HERE}:rising"}, f"found '{HERE}:rising', expected an import path"),
    "an option of the loop": ({"verbose": 1}, "found the option 'verbose', which has no effect here"),
    "no time": ({"total_timesteps": 0}, "total_timesteps: found 0, expected at least 1"),
    "no device": ({"device": "abacus"}, "device: found 'abacus', expected one that torch knows"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_refused_options(name: str) -> None:
    """What cannot work is refused before anything is played, through `apel.building` as directly."""
    options, message = REFUSED[name]
    world = make_world(EnvironmentConfig("CartPole-v1"), 1)
    with pytest.raises(ValueError, match=f"StableBaselines: .*{message}"):
        make_banks([LearnerConfig(f"{StableBaselines.__module__}:StableBaselines", options)], [world], [1])


@pytest.mark.parametrize(
    ("observations", "actions", "message"),
    [
        (CART_POLE, spaces.MultiBinary(2), "found the action space MultiBinary.*, expected a Discrete one or a Box"),
        (CART_POLE, spaces.Box(-1, np.inf, (1,)), "found the action space Box.*, expected real numbers"),
        (CART_POLE, spaces.Box(-1, 1, (1,), np.int8), "found the action space Box.*, expected real numbers"),
        (CART_POLE, spaces.Box(1, 1, (1,)), "found the action space Box.*, expected real numbers"),
        (spaces.Tuple([CART_POLE]), spaces.Discrete(2), "found the observation space Tuple.*, expected Box"),
        (spaces.Dict({"a": spaces.Dict({"b": CART_POLE})}), spaces.Discrete(2), "found the observation space Dict"),
    ],
)
def test_refused_spaces(observations: Any, actions: Any, message: str) -> None:
    """Spaces that SB3 would fail on later, or that trajectories cannot hold."""
    with pytest.raises(ValueError, match=message):
        StableBaselines(observations, actions, SEED)


def test_learner_without_values_cannot_be_evaluated() -> None:
    """An algorithm whose values are not known is refused where they would be needed."""
    config = LearnerConfig(f"{StableBaselines.__module__}:StableBaselines", {"algorithm": f"{HERE}:Stubborn"})
    world = make_world(EnvironmentConfig("CartPole-v1"), 1)
    with pytest.raises(ValueError, match="StableBaselines has no action_values: it cannot be evaluated"):
        make_banks([config], [world], [1], evaluates=True)
    with pytest.raises(ValueError, match="StableBaselines: found the algorithm Stubborn, expected one that explores"):
        make_banks([config], [world], [1], freezes=True)


def test_not_installed(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without stable-baselines3 the error says how to install it."""
    for module in ("stable_baselines3", "stable_baselines3.common.off_policy_algorithm"):
        monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(ValueError, match=r'found no stable-baselines3 .*: pip install "apel\[sb3\]"'):
        cart_pole()


def test_importing_is_cheap() -> None:
    """Neither torch nor stable-baselines3 is imported before a learner is made."""
    code = (
        "import sys, apel.learners.stable_baselines.adapter; "
        "sys.exit(bool({'torch', 'stable_baselines3'} & set(sys.modules)))"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
