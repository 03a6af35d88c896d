"""A share of its own of what a learner replays: stable-baselines3's, learners in ensembles, and who is refused."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
import pytest
from gymnasium import spaces

from apel import Ensemble, OwnShare, Transition, Uniform
from apel.building import make_bank, make_learner
from apel.building.learners import no_replay_memory
from apel.building.registry import LEARNERS, load
from apel.configs import EnvironmentConfig, LearnerConfig
from apel.environments import make_world
from apel.learners.base import HasReplayMemory
from cluster.checkpoint import pack, unpack

pytest.importorskip("stable_baselines3")
from stable_baselines3.common.buffers import ReplayBuffer

from apel.learners.stable_baselines.adapter import StableBaselines

HERE = "tests.apel.learners.test_own_share"
SEEN, PARTS = spaces.Box(-1.0, 1.0, (2,)), spaces.Dict({"a": spaces.Box(-1.0, 1.0, (2,))})
SMALL = {
    "policy_kwargs": {"net_arch": [4]},
    "buffer_size": 60,
    "batch_size": 10,
    "learning_starts": 10,
    "train_freq": 12,
    "gradient_steps": 1,
}
HALF = {"optimize_memory_usage": True, "replay_buffer_kwargs": {"handle_timeout_termination": False}}
KINDS: dict[str, dict[str, Any]] = {
    "DQN": {"algorithm": "stable_baselines3:DQN"},
    "half the memory": {"algorithm": "stable_baselines3:DQN", **HALF},
    "several steps of return": {"algorithm": "stable_baselines3:DQN", "n_steps": 2},
    "SAC": {"algorithm": "stable_baselines3:SAC"},
    "parts": {"algorithm": "stable_baselines3:DQN", "policy": "MultiInputPolicy"},
}
SHARE = OwnShare(own_share=0.3)


class Choosy(ReplayBuffer):
    """Chooses what is learned from in a way of its own."""

    def sample(self, batch_size: int, env: Any = None) -> Any:
        return self._get_samples(np.zeros(batch_size, dtype=np.int64), env)


class Hoarder:
    """A user's learner with a memory, which notes what it is asked for."""

    off_policy = True
    shares: ClassVar[list[float]] = []

    def __init__(self, observation_space: Any, action_space: Any, seed: int) -> None:
        """Nothing to be set up."""

    def replay_own(self, share: float) -> None:
        """Note it."""
        self.shares.append(share)

    def act(self, observation: Any) -> tuple[int, None]:
        """Always the same."""
        return 0, None

    def learn(self, transition: Transition) -> None:
        """Not at all."""

    def end_episode(self) -> None:
        """Nothing."""

    def state(self) -> dict[str, Any]:
        """Nothing."""
        return {}

    def restore(self, state: dict[str, Any]) -> None:
        """Nothing."""


def learner_of(kind: str, seed: int = 5) -> StableBaselines:
    seen = PARTS if kind == "parts" else SEEN
    actions = spaces.Box(-1.0, 1.0, (1,)) if kind == "SAC" else spaces.Discrete(2)
    learner = StableBaselines(seen, actions, seed, **SMALL, **KINDS[kind])
    learner.replay_own(SHARE.own_share)
    return learner


def live(learner: StableBaselines, kind: str, episodes: int, seed: int = 3) -> list[tuple[float, float]]:
    """Episodes of three steps, a tenth of them the learner's own, whose rewards are 1 and else 0: of each minibatch
    its share of own steps, and that of the memory.
    """
    draws, found, rewards = np.random.default_rng(seed), list[tuple[float, float]](), list[float]()
    buffer = learner.algorithm.replay_buffer
    sample = buffer.sample

    def watched(*arguments: Any, **named: Any) -> Any:
        batch = sample(*arguments, **named)
        found.append((float((batch.rewards > 0).float().mean()), float(np.mean(rewards[-buffer.buffer_size :]))))
        return batch

    buffer.sample = watched
    for _ in range(episodes):
        own = bool(draws.random() < 0.1)
        for step in range(3):
            one, other = draws.uniform(-1, 1, (2, 2)).astype(np.float32)
            seen, coming = ({"a": one}, {"a": other}) if kind == "parts" else (one, other)
            action: Any = np.zeros(1, np.float32) if kind == "SAC" else 1
            if own:
                action = learner.act(seen)[0]
            rewards.append(float(own))
            learner.learn(Transition(seen, action, float(own), coming, step == 2, False, None))
        learner.end_episode()
    del buffer.sample
    return found


@pytest.mark.parametrize("kind", KINDS)
def test_share_is_reached(kind: str) -> None:
    """Over 1 000 episodes every minibatch of stable-baselines3's has the share once there is an own step, and the mean
    is that of the rule within sampling error: ⌈share · B⌉ own ones, and of the rest as many as the memory has.
    """
    found = np.array([pair for pair in live(learner_of(kind), kind, 1000 if kind == "DQN" else 300) if pair[1] > 0])
    assert len(found) > 50
    assert found[:, 0].min() >= SHARE.own_share
    expected = 0.3 + 0.7 * found[:, 1]
    error = np.sqrt(0.25 * 7 / 10**2 / len(found))  # of the mean of 7 draws in 10, at most
    assert abs(found[:, 0].mean() - expected.mean()) < 4 * error


@pytest.mark.parametrize("kind", KINDS)
def test_checkpoint(kind: str) -> None:
    """One that goes on from a stored state draws what the other draws, who played included."""
    one, other = learner_of(kind), learner_of(kind, seed=6)
    live(one, kind, 33, seed=7)
    live(other, kind, 15, seed=8)
    other.restore(unpack(pack(one.state())))
    drawn = live(one, kind, 40)
    assert any(pair[0] >= SHARE.own_share for pair in drawn)
    assert live(other, kind, 40) == drawn
    assert pack(other.state()) == pack(one.state())


def test_a_state_without_a_word_of_who_played() -> None:
    """Steps of a learner that did not ask are nobody's own."""
    plain = StableBaselines(SEEN, spaces.Discrete(2), 1, **SMALL, **KINDS["DQN"])
    live(plain, "DQN", 100)
    asking = learner_of("DQN")
    live(asking, "DQN", 100, seed=9)
    assert asking.state()["own"].any()
    asking.restore(plain.state())
    assert not asking.state()["own"].any()
    plain.restore(learner_of("DQN").state())
    assert "own" not in plain.state()


def test_in_an_ensemble() -> None:
    """Who played is known of every step, whatever the type of the learner."""
    world = make_world(EnvironmentConfig("apel/CartPole-v0"), run_seed=5)
    deep = {"learning_starts": 10, "network": {"hidden": [4]}}
    configs = [
        LearnerConfig("dqn", deep, learns_from=SHARE),
        LearnerConfig("sac", deep, learns_from=SHARE),
        LearnerConfig("stable_baselines", {"learning_starts": 10, "buffer_size": 1000}, learns_from=SHARE),
    ]
    ensemble = Ensemble(world, configs, Uniform(), 5, 12)
    records = list(ensemble.run())
    played = [np.repeat([r.selected == i for r in records], [r.length for r in records]) for i in range(3)]
    states: list[Any] = [learner.state() for learner in ensemble.learners]
    found = [states[0]["replay"]["own"][0], states[1]["replay"]["own"][0], states[2]["own"]]
    for own, expected in zip(found, played, strict=True):
        np.testing.assert_array_equal(own, expected)
        assert 0 < expected.sum() < len(expected)


@pytest.mark.parametrize(
    ("config", "expected"),
    [
        (LearnerConfig("q_learning"), "q_learning: learns_from: found own_share"),
        (LearnerConfig("dyna_q"), "dyna_q: learns_from: found own_share"),
        (LearnerConfig("voting", members=(LearnerConfig("q_learning"),)), "voting: learns_from: found own_share"),
        (LearnerConfig("tests.user_code:Walker"), "tests.user_code:Walker: learns_from: found own_share"),
        (LearnerConfig("stable_baselines_on_policy"), "is not off-policy"),
        (LearnerConfig("acer", {"replay_ratio": 0}), "own_share: replay_ratio: found 0, expected at least 1"),
        (
            LearnerConfig("stable_baselines", {**SMALL, "replay_buffer_class": f"{HERE}:Choosy"}),
            "stable_baselines: learns_from: found own_share",
        ),
    ],
)
def test_refused(config: LearnerConfig, expected: str) -> None:
    """Who has no memory to draw from is told so, and who has one; alone and for a shard."""
    config = LearnerConfig(config.type, config.options, members=config.members, learns_from=SHARE)
    is_deep = config.type in ("acer", "stable_baselines", "stable_baselines_on_policy")
    world = make_world(EnvironmentConfig("apel/CartPole-v0" if is_deep else "FrozenLake-v1"), 1)
    with pytest.raises(ValueError, match=expected):
        make_learner(config, world, 1, 0)
    with pytest.raises(ValueError, match=expected):
        make_bank([config], [world], [1], 0, "return", with_probability=False)


def test_members_have_none_of_their_own() -> None:
    """A vote learns from what it is told, on tables too."""
    world = make_world(EnvironmentConfig("FrozenLake-v1"), 1)
    config = LearnerConfig("voting", members=(LearnerConfig("q_learning", learns_from="own"),))
    with pytest.raises(ValueError, match="found learns_from of a learner that votes"):
        make_bank([config], [world], [1], 0, "return", with_probability=False)


def test_ones_own_learner() -> None:
    """A learner with `replay_own` is told its share, once."""
    Hoarder.shares.clear()
    world = make_world(EnvironmentConfig("FrozenLake-v1"), 1)
    make_learner(LearnerConfig(Hoarder, learns_from=SHARE), world, 1, 0)
    make_learner(LearnerConfig(Hoarder), world, 1, 0)
    assert Hoarder.shares == [0.3]


def test_message_names_all_who_have_a_memory() -> None:
    """The list in the message is that of the shipped learners with `replay_own`."""
    named = no_replay_memory(LearnerConfig("x")).partition("memory: ")[2].partition(", or")[0].split(", ")
    shipped = [name for name, one in LEARNERS.items() if issubclass(_class(one), HasReplayMemory)]
    assert sorted(named) == sorted(shipped)


def _class(one: Any) -> type:
    return load(one) if isinstance(one, str) else one
