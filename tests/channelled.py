"""An environment with channels and signals, and a learner that remembers all it was told."""

from __future__ import annotations

from typing import Any, ClassVar

import gymnasium
import numpy as np
from gymnasium import spaces

from apel.learners import Transition


class Lives(gymnasium.Env[Any, Any]):
    """Three lives of 3, 4 and 5 steps; the picture and the number both show how many steps were taken.

    The reward is 10 per step, the signal ``bonus`` the number of steps, and a life ends with ``life_lost``.
    """

    observation_space = spaces.Dict(
        {"picture": spaces.Box(0, 255, (2, 2), np.uint8), "number": spaces.Discrete(30), "wind": spaces.Discrete(7)}
    )
    action_space = spaces.Discrete(3)
    signals = ("bonus", "life_lost")

    def __init__(self, *, endless: bool = False) -> None:
        self._endless = endless
        self._steps = 0

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        super().reset(seed=seed)
        self._steps = 0
        return self._observation(), {"bonus": 0.0, "life_lost": 0.0}

    def step(self, action: Any) -> Any:
        self._steps += 1
        life_lost = self._steps in (3, 7, 12)
        terminated = self._steps == 12 and not self._endless
        info = {"bonus": float(self._steps), "life_lost": float(life_lost)}
        return self._observation(), 10.0, terminated, self._steps == 14, info

    def _observation(self) -> dict[str, Any]:
        picture = np.full((2, 2), self._steps, dtype=np.uint8)
        return {"picture": picture, "number": self._steps, "wind": int(self.np_random.integers(7))}


class Witness:
    """Learns nothing; remembers what it saw, as text, so that it can be compared and stored."""

    off_policy: ClassVar[bool] = True

    def __init__(self, observation_space: Any, action_space: Any, seed: int) -> None:
        self.space = observation_space
        self.acted: list[Any] = []
        self.learned: list[tuple[Any, int, float, Any, bool, bool]] = []
        self.episodes = 0

    def act(self, observation: Any) -> tuple[int, None]:
        self.acted.append(np.asarray(observation).tolist())
        return len(self.acted) % 3, None

    def learn(self, transition: Transition) -> None:
        seen, following = (
            np.asarray(value).tolist() for value in (transition.observation, transition.next_observation)
        )
        ends = bool(transition.terminated), bool(transition.truncated)
        self.learned.append((seen, int(transition.action), float(transition.reward), following, *ends))

    def end_episode(self) -> None:
        self.episodes += 1

    def state(self) -> dict[str, Any]:
        return {"episodes": self.episodes}

    def restore(self, state: dict[str, Any]) -> None:
        self.episodes = state["episodes"]
