"""Code as users write it, named by import path in the tests' experiments."""

from __future__ import annotations

import os
import sys
import time
from pathlib import Path
from typing import Any, ClassVar

import gymnasium
import numpy as np
from gymnasium import spaces

from apel import Trajectory, Transition


class Corridor(gymnasium.Env[int, int]):
    """Five cells in a row; the right end pays 1. Fails in the way it is told to, in the given episode.

    While a file named ``slow_while`` is there every episode takes a twentieth of a second.
    """

    def __init__(self, fault: str = "", episode: int = 40, length: int = 5, slow_while: str = "") -> None:
        self._slow_while = slow_while
        self.observation_space = spaces.Discrete(length)
        self.action_space = spaces.Discrete(2)
        self._fault, self._fault_episode, self._episode = fault, episode, -2
        self._cell = self._steps = 0

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[int, dict[str, Any]]:
        super().reset(seed=seed)
        if self._slow_while and Path(self._slow_while).exists():
            time.sleep(0.05)
        self._episode += 1
        self._cell = self._steps = 0
        return 0, {"optimal_length": 4}

    def step(self, action: int) -> tuple[int, float, bool, bool, dict[str, Any]]:
        if self._episode >= self._fault_episode and self._fault == "raise":
            message = "the motor is stuck"
            raise OSError(message)
        if self._episode >= self._fault_episode and self._fault == "exit":
            sys.exit("the window was closed")
        self._steps += 1
        self._cell = min(max(self._cell + (1 if action else -1), 0), 4)
        reward = 1.0 if self._cell == 4 else -0.1
        if self._episode >= self._fault_episode and self._fault == "nan":
            reward = float("nan")
        if self._episode >= self._fault_episode and self._fault == "huge":
            reward = 1e308
        return self._cell, reward, self._cell == 4, self._steps >= 30, {}


class Marked(Corridor):
    """A file in ``folder`` says that it is open."""

    def __init__(self, folder: str, fault: str = "", episode: int = 40) -> None:
        super().__init__(fault, episode)
        self._mark = Path(folder, f"{os.getpid()}-{id(self)}")
        self._mark.touch()

    def close(self) -> None:
        self._mark.unlink()


class Walker:
    """Prefers one action; learns nothing."""

    off_policy: ClassVar[bool] = True

    def __init__(self, observation_space: Any, action_space: Any, seed: int, share: float = 0.8) -> None:
        self.generator = np.random.default_rng(seed)
        self.share = share
        self.num_seen = 0

    def act(self, observation: Any) -> tuple[int, Any]:
        return int(self.generator.random() < self.share), np.array([1 - self.share, self.share])

    def learn(self, transition: Transition) -> None:
        self.num_seen += 1

    def end_episode(self) -> None:
        return

    def state(self) -> dict[str, Any]:
        return {"generator": self.generator.bit_generator.state, "num_seen": self.num_seen}

    def restore(self, state: dict[str, Any]) -> None:
        self.generator.bit_generator.state = state["generator"]
        self.num_seen = state["num_seen"]


class Framed(Corridor):
    """Shows where it is as an image of one row."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.observation_space = spaces.Box(0.0, 1.0, (width,), np.float32)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        _, info = super().reset(seed=seed)
        return self._image(), info

    def step(self, action: int) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        _, *rest = super().step(action)
        return self._image(), *rest

    def _image(self) -> Any:
        return (np.arange(self.observation_space.shape[0]) == self._cell).astype(np.float32)


class Clocked(Walker):
    """Knows how many episodes it has seen end."""

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        self.episode = 0

    def end_episode(self) -> None:
        self.episode += 1

    def state(self) -> dict[str, Any]:
        return {**super().state(), "episode": self.episode}

    def restore(self, state: dict[str, Any]) -> None:
        super().restore(state)
        self.episode = state["episode"]


class Tiring(Clocked):
    """Fails at the end of the episode with this number, whoever plays it."""

    def __init__(self, *arguments: Any, last: int) -> None:
        super().__init__(*arguments)
        self._last = last

    def end_episode(self) -> None:
        super().end_episode()
        if self.episode == self._last + 1:
            message = "out of ideas"
            raise RuntimeError(message)


class Reticent(Clocked):
    """Does not say its probabilities in every third episode."""

    def act(self, observation: Any) -> tuple[int, Any]:
        action, probability = super().act(observation)
        return action, probability if self.episode % 3 else None


class Counting(Walker):
    """Counts what it sees in an array, in place, and keeps the array that it is given to go on from."""

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        self.counts = np.zeros(5)

    def learn(self, transition: Transition) -> None:
        self.counts[transition.observation] += 1

    def state(self) -> dict[str, Any]:
        return {**super().state(), "counts": self.counts}

    def restore(self, state: dict[str, Any]) -> None:
        super().restore(state)
        self.counts = state["counts"]


class OnPolicy(Walker):
    """A learner that may not learn from others."""

    off_policy: ClassVar[bool] = False


class Forgetful(Walker):
    """A learner whose state no checkpoint can hold."""

    def state(self) -> dict[str, Any]:
        return {"generator": object()}


class Superstitious(Walker):
    """A learner that refuses one seed."""

    def __init__(self, observation_space: Any, action_space: Any, seed: int, unlucky: int = -1) -> None:
        super().__init__(observation_space, action_space, seed)
        if seed == unlucky:
            message = "this seed brings no luck"
            raise ValueError(message)


class Choosy(Walker):
    """A learner that raises when it sees what another did in episode 20 or later."""

    def __init__(self, observation_space: Any, action_space: Any, seed: int) -> None:
        super().__init__(observation_space, action_space, seed)
        self.num_episodes = 0

    def end_episode(self) -> None:
        self.num_episodes += 1
        if self.num_episodes > 20:
            message = "out of ideas"
            raise RuntimeError(message)


class RoundRobin:
    """A selector in plain Python: each learner in turn."""

    fields: ClassVar[dict[str, list[float]]] = {"episode": [0.0]}

    def select(self, state: Any, rng: np.random.Generator) -> int:
        return int(state.episode[0]) % len(state.probability)

    def observe(self, state: Any, selected: int, performance: float) -> None:
        state.episode[0] += 1


def shortness(trajectory: Trajectory) -> float:
    """A user's own performance measure."""
    return 1.0 / len(trajectory)


def no_number(trajectory: Trajectory) -> float:
    """A measure that fails."""
    return float("inf")


NOT_A_LEARNER = 3


class Hungry(Walker):
    """Takes all memory that it gets, once: in the first process that comes to its hundredth action."""

    def __init__(self, *arguments: Any, marker: str, **options: Any) -> None:
        super().__init__(*arguments, **options)
        self._marker, self._num_actions = Path(marker), 0

    def act(self, observation: Any) -> tuple[int, Any]:
        self._num_actions += 1
        if self._num_actions == 100 and not self._marker.exists():
            self._marker.touch()
            eaten = []
            for _ in range(200):
                eaten.append(np.ones(2**23))  # 64 MiB
                time.sleep(0.03)
        return super().act(observation)


class SeesGpus(Walker):
    """Refuses to act where it does not see as many GPUs as expected."""

    def __init__(self, observation_space: Any, action_space: Any, seed: int, expected: int) -> None:
        super().__init__(observation_space, action_space, seed)
        self.expected = expected

    def act(self, observation: Any) -> tuple[int, Any]:
        visible = [name for name in os.environ.get("CUDA_VISIBLE_DEVICES", "").split(",") if name]
        if len(visible) != self.expected:
            message = f"found the GPUs {visible}, expected {self.expected}"
            raise RuntimeError(message)
        return super().act(observation)


def leave(*_: Any, **__: Any) -> None:
    """Ends the program, as a learner."""
    sys.exit()
