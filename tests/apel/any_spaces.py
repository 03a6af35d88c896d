"""An environment, and a learner, of any spaces."""

from __future__ import annotations

import copy
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces

from apel.learners.base import Transition
from apel.learners.supported_spaces import SupportedSpaces

ACTIONS: dict[str, Any] = {
    "Discrete": spaces.Discrete(3, start=-1),
    "Box": spaces.Box(np.array([-1, 0], np.float32), np.array([1, 5], np.float32)),
    "wide Box": spaces.Box(-np.inf, np.inf, (2, 2), np.float64),
    "Box of bytes": spaces.Box(0, 9, (2,), np.uint8),
    "MultiDiscrete": spaces.MultiDiscrete([3, 2], start=[1, -4]),
    "MultiBinary": spaces.MultiBinary((2, 2)),
}
OBSERVATIONS: dict[str, Any] = {
    "Box": spaces.Box(-1, 1, (3,), np.float32),
    "image": spaces.Box(0, 255, (2, 4, 3), np.uint8),
    "single": spaces.Box(-1, 1, (), np.float64),
    "Discrete": spaces.Discrete(4, start=2),
    "MultiDiscrete": spaces.MultiDiscrete([[2, 3], [4, 5]]),
    "MultiBinary": spaces.MultiBinary(3),
    "finite Tuple": spaces.Tuple([spaces.Discrete(3, start=-1), spaces.MultiBinary(2)]),
    "finite Dict": spaces.Dict({"a": spaces.MultiDiscrete([2, 3]), "b": spaces.Dict({"c": spaces.Discrete(2)})}),
    "Tuple": spaces.Tuple([spaces.Box(-1, 1, (2,)), spaces.Discrete(3)]),
    "Dict": spaces.Dict(
        {
            "position": spaces.Box(-np.inf, np.inf, (2,), np.float64),
            "inside": spaces.Dict({"what": spaces.Discrete(3, start=1), "who": spaces.Tuple([spaces.MultiBinary(2)])}),
            "picture": spaces.Box(0, 255, (2, 2, 1), np.uint8),
        }
    ),
}


class Anything(gymnasium.Env[Any, Any]):
    """Five steps of observations at random; what it is paid follows from the action, into which it writes."""

    seed_bits = 63

    def __init__(self, action: str = "Box", observation: str = "Box") -> None:
        self.action_space = copy.deepcopy(ACTIONS[action])
        self.observation_space = copy.deepcopy(OBSERVATIONS[observation])

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        super().reset(seed=seed)
        self.observation_space.seed(int(self.np_random.integers(2**31)))
        self.steps = 0
        return self.observation_space.sample(), {}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        assert self.action_space.contains(action), action
        reward = float(np.sum(action))
        if isinstance(action, np.ndarray):
            action[...] = 0
        self.steps += 1
        return self.observation_space.sample(), reward, self.steps == 5, False, {}


class Watcher:
    """Acts at random, knows μ of every other action, and remembers all it is told."""

    off_policy = True
    supported_spaces: SupportedSpaces | None = None

    def __init__(self, observation_space: Any, action_space: Any, seed: int) -> None:
        self.space, self.action_space = observation_space, copy.deepcopy(action_space)
        self.action_space.seed(seed % 2**31)
        self.memory: list[Transition] = []

    def act(self, observation: Any) -> tuple[Any, Any]:
        action = self.action_space.sample()
        mu = np.full(3, 1 / 3) if isinstance(self.action_space, spaces.Discrete) else 0.25
        return action, mu

    def greedy_action(self, observation: Any) -> Any:
        return self.action_space.low if isinstance(self.action_space, spaces.Box) else self.action_space.sample()

    def learn(self, transition: Transition) -> None:
        self.memory.append(copy.deepcopy(transition))
        if isinstance(transition.action, np.ndarray):
            transition.action[...] = 0
        _spoil(transition.next_observation)

    def end_episode(self) -> None:
        pass

    def state(self) -> dict[str, Any]:
        return {}

    def restore(self, state: dict[str, Any]) -> None:
        pass


class Whole(Watcher):
    """Sees observations with all their parts."""

    supported_spaces = SupportedSpaces(("Discrete", "Box", "MultiDiscrete", "MultiBinary"), ("Dict", "Tuple"))


class Mistaken(Watcher):
    """Answers something at its third step."""

    def __init__(self, observation_space: Any, action_space: Any, seed: int, answer: Any, mu: Any = None) -> None:
        super().__init__(observation_space, action_space, seed)
        self.answer, self.mu = answer, mu

    def act(self, observation: Any) -> tuple[Any, Any]:
        if len(self.memory) < 2:
            return super().act(observation)
        return (self.action_space.sample() if self.answer is None else self.answer), self.mu


def _spoil(observation: Any) -> None:
    """Write into every array of it."""
    for part in observation.values() if isinstance(observation, dict) else []:
        _spoil(part)
    if isinstance(observation, np.ndarray):
        observation[...] = 0
