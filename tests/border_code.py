"""Environments and learners as people write them, at the border: what they answer is right, nearly right, or wrong."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, ClassVar

import gymnasium
import numpy as np
from gymnasium import spaces


class Track(gymnasium.Env[Any, Any]):
    """A way of ``length`` steps, whatever the actions; a subclass says where one is."""

    action_space = spaces.Discrete(2)

    def __init__(self, length: int = 5) -> None:
        self.length, self.at = length, 0

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        super().reset(seed=seed)
        self.at = 0
        return self.seen(), {}

    def step(self, action: Any) -> Any:
        self.at += 1
        return self.seen(), -1.0, self.at >= self.length, False, {}

    def seen(self) -> Any:
        raise NotImplementedError


class Reusing(Track):
    """Writes each observation into the same array; ``shared``: into one that all environments of the process share."""

    observation_space = spaces.Box(0.0, 8.0, (1,), np.float32)
    of_all = np.zeros(1, np.float32)

    def __init__(self, *, shared: bool = False) -> None:
        super().__init__(8)
        self.buffer = self.of_all if shared else np.zeros(1, np.float32)

    def seen(self) -> Any:
        self.buffer[0] = self.at
        return self.buffer


class Forms(Track):
    """Says the same thing in several forms."""

    kinds: ClassVar[Mapping[str, tuple[spaces.Space[Any], Callable[[int], Any]]]] = {
        "list": (spaces.MultiDiscrete([9, 4]), lambda at: [at, 1]),
        "tuple": (spaces.MultiDiscrete([9, 4]), lambda at: (at, 1)),
        "int32": (spaces.MultiDiscrete([9, 4]), lambda at: np.array([at, 1], np.int32)),
        "whole floats": (spaces.MultiDiscrete([9, 4]), lambda at: np.array([at, 1.0])),
        "array": (spaces.MultiDiscrete([9, 4]), lambda at: np.array([at, 1])),
        "int": (spaces.Discrete(9), lambda at: at),
        "np.int8": (spaces.Discrete(9), np.int8),
        "0-d": (spaces.Discrete(9), np.array),
        "float": (spaces.Discrete(9), float),
        "bool list": (spaces.MultiBinary(2), lambda at: [at > 2, True]),
        "bools": (spaces.MultiBinary(2), lambda at: np.array([at > 2, True])),
        "bits": (spaces.MultiBinary(2), lambda at: np.array([at > 2, True], np.int8)),
        "float64": (spaces.Box(-1, 9, (2,), np.float32), lambda at: np.array([at / 3, 1])),
        "float list": (spaces.Box(-1, 9, (2,), np.float32), lambda at: [at / 3, 1]),
        "object": (spaces.Box(-1, 9, (2,), np.float32), lambda at: np.array([at / 3, 1], dtype=object)),
        "float32": (spaces.Box(-1, 9, (2,), np.float32), lambda at: np.array([at / 3, 1], np.float32)),
        "bytes as floats": (spaces.Box(0, 255, (2,), np.uint8), lambda at: np.array([at, 255.0])),
        "bytes": (spaces.Box(0, 255, (2,), np.uint8), lambda at: np.array([at, 255], np.uint8)),
        "number": (spaces.Box(-1, 9, (), np.float32), lambda at: at / 3),
        "number as array": (spaces.Box(-1, 9, (), np.float32), lambda at: np.array(at / 3)),
    }

    def __init__(self, kind: str) -> None:
        super().__init__()
        self.observation_space, self._said = self.kinds[kind]

    def seen(self) -> Any:
        return self._said(self.at)


class Wrong(Track):
    """Answers what it must not, at its third step (or where an episode begins), in every second run."""

    kinds: ClassVar[Mapping[str, Any]] = {
        "text": [0.1, "n/a"],
        "none": [0.1, None],
        "nothing": None,
        "ragged": [[0.1], 0.1, [0.2, 0.3]],
        "nan": np.array([0.1, np.nan], np.float32),
        "beyond": np.array([0.1, 1.5], np.float32),
        "shape": np.zeros(3, np.float32),
        "number": 0.5,
        "complex": [0.1j, 0.2],
        "too large": [0.1, 1e300],
    }

    observation_space = spaces.Box(-1, 1, (2,), np.float32)

    def __init__(self, kind: str, where: int = 3, wrong: int = 0, ending: bool = False) -> None:
        super().__init__(3 if ending else 5)
        self._kind, self._where, self._is_wrong = kind, where, wrong % 2 == 0

    def seen(self) -> Any:
        return self.kinds[self._kind] if self._is_wrong and self.at == self._where else [0.1 * self.at, 0.5]


class Answers(Track):
    """Answers ``step`` or ``reset`` in another form than Gymnasium's."""

    observation_space = spaces.Discrete(9)
    rewards: ClassVar[Mapping[str, Any]] = {
        "reward none": None,
        "reward nan": float("nan"),
        "reward inf": np.inf,
        "reward array": np.array([1.0]),
        "reward text": "1.0",
        "reward complex": 1j,
        "reward 0-d": np.array(1.0),
        "reward np": np.float32(1.0),
        "reward int": 1,
        "reward bool": True,
    }
    ends: ClassVar[Mapping[str, Any]] = {
        "end none": None,
        "end array": np.array([False]),
        "end text": "False",
        "end float": 0.0,
        "end np": np.bool_(False),
        "end int": 0,
        "end 0-d": np.array(False),
    }

    def __init__(self, kind: str) -> None:
        super().__init__()
        self._kind = kind

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        answer = super().reset(seed=seed)
        return {"reset alone": answer[0], "reset pair": (0, 1), "reset three": (*answer, {})}.get(self._kind, answer)

    def step(self, action: Any) -> Any:
        observation, reward, terminated, truncated, info = super().step(action)
        if self._kind == "four":
            return observation, reward, terminated, info
        if self._kind == "nothing":
            return None
        reward = self.rewards.get(self._kind, reward)
        if not terminated:
            truncated = self.ends.get(self._kind, truncated)
        return observation, reward, terminated, truncated, info

    def seen(self) -> Any:
        return self.at


class Learner:
    """Draws actions; learns nothing."""

    off_policy: ClassVar[bool] = True

    def __init__(self, observation_space: Any, action_space: Any, seed: int, label: str = "") -> None:
        self.generator, self.path = np.random.default_rng(seed), Path(label)

    def act(self, observation: Any) -> Any:
        return int(self.generator.integers(2)), None

    def learn(self, step: Any) -> None:
        pass

    def end_episode(self) -> None:
        pass

    def state(self) -> dict[str, Any]:
        return {"generator": self.generator.bit_generator.state}

    def restore(self, state: dict[str, Any]) -> None:
        self.generator.bit_generator.state = state["generator"]


class Hoarder(Learner):
    """Keeps transitions by reference, as most hand-written replay memories do."""

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        self.memory: list[Any] = []

    def learn(self, step: Any) -> None:
        self.memory.append(step)

    @property
    def num_wrong(self) -> int:
        """Steps of `Reusing` whose next observation is not the successor."""
        return sum(float(step.next_observation[0]) != float(step.observation[0]) + 1 for step in self.memory)


class Scaling(Hoarder):
    """Works in place, in all that it is shown."""

    def act(self, observation: Any) -> Any:
        observation /= 8.0
        assert 0 <= observation[0] <= 1
        return int(self.generator.integers(2)), np.array([0.5, 0.5])

    def learn(self, step: Any) -> None:
        super().learn(step._replace(observation=step.observation.copy(), next_observation=step.next_observation.copy()))
        for array in (step.observation, step.next_observation, step.probability):
            np.divide(array, 8.0, out=array)


class Rewriting(Hoarder):
    """Keeps its probabilities in one array: that of action 1 is .1 at the first step, .2 at the second, and so on."""

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        self.probability = np.zeros(2)

    def act(self, observation: Any) -> Any:
        p = 0.1 * (observation + 1)
        self.probability[:] = 1 - p, p
        return int(self.generator.random() < p), self.probability


class Odd(Learner):
    """Answers ``act`` in many forms."""

    kinds: ClassVar[Mapping[str, Any]] = {
        "int": (1, None),
        "np.int64": (np.int64(1), None),
        "np.bool": (np.bool_(True), None),
        "bool": (True, None),
        "0-d": (np.array(1), None),
        "list of two": [1, None],
        "one-hot": (1, [0.0, 1.0]),
        "list": (1, [0.5, 0.5]),
        "float32": (1, np.array([1 / 3, 2 / 3], np.float32)),
        "array of one": (np.array([1]), None),
        "float": (1.0, None),
        "text": ("1", None),
        "none": (None, None),
        "too large": (7, None),
        "negative": (-1, None),
        "alone": 1,
        "three": (1, None, {}),
        "logarithms": (1, np.log([0.5, 0.5])),
        "scalar": (1, 0.5),
        "short": (1, np.array([1.0])),
        "long": (1, np.full(3, 1 / 3)),
        "sum": (1, np.array([0.9, 0.9])),
        "nan": (1, np.array([np.nan, 1.0])),
        "all nan": (1, np.array([np.nan, np.nan])),
        "below 0": (1, np.array([-0.5, 1.5])),
        "matrix": (1, np.array([[0.5, 0.5]])),
        "of texts": (1, ["a", "b"]),
    }

    def __init__(self, *arguments: Any, kind: str) -> None:
        super().__init__(*arguments)
        self.answer = self.kinds[kind]

    def act(self, observation: Any) -> Any:
        return self.answer


class Legacy(Track):
    """Seeds as MinAtar and many older environments do: ``RandomState`` takes 32 bits."""

    observation_space = spaces.Discrete(3)

    def __init__(self) -> None:
        super().__init__(2)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        self.random = np.random.RandomState(seed)
        return super().reset(seed=seed)

    def step(self, action: Any) -> Any:
        observation, _, *rest = super().step(action)
        return observation, float(self.random.rand()), *rest

    def seen(self) -> Any:
        return self.at


class Drift(Track):
    """A random walk that begins at about 5."""

    observation_space = spaces.Box(-np.inf, np.inf, (1,), np.float32)
    x = 0.0

    def seen(self) -> Any:
        self.x = float(self.np_random.normal(5, 2)) if self.at == 0 else self.x + float(self.np_random.normal())
        return np.array([self.x], np.float32)


def normalised() -> gymnasium.Env[Any, Any]:
    """By Gymnasium's own wrappers, whose running mean and variance live in the environment."""
    drift = gymnasium.wrappers.NormalizeObservation(Drift())
    return gymnasium.wrappers.NormalizeReward(drift)


class Curriculum(Drift):
    """Becomes longer from episode to episode; what it has come to can be stored, or cannot."""

    def __init__(self) -> None:
        super().__init__(2)
        self.num_episodes = 0

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        self.num_episodes += 1
        self.length = 2 + self.num_episodes // 5
        return super().reset(seed=seed)


class StoredCurriculum(Curriculum):
    def state(self) -> dict[str, Any]:
        return {"num_episodes": self.num_episodes}

    def restore(self, state: dict[str, Any]) -> None:
        self.num_episodes = state["num_episodes"]


def normalised_curriculum() -> gymnasium.Env[Any, Any]:
    """What the wrapper carries is known; what it wraps carries more."""
    return gymnasium.wrappers.NormalizeObservation(Curriculum())
