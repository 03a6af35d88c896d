"""An environment with observations of several finite variables, as vectors of whole numbers."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from apel.experience.joint_space import JointSpace


class JointEnvironment(gymnasium.ObservationWrapper[NDArray[np.int64], Any, Any]):
    """See `apel.experience.joint_space.JointSpace`.

    Parameters
    ----------
    environment:
        With observations of such a Tuple or Dict.
    """

    def __init__(self, environment: gymnasium.Env[Any, Any]) -> None:
        super().__init__(environment)
        parts: Any = environment.observation_space
        self._space = JointSpace(parts)
        self.observation_space: spaces.Space[Any] = self._space

    @property
    def features(self) -> tuple[str, ...]:
        """Names of the variables."""
        return self._space.features

    def observation(self, observation: Any) -> NDArray[np.int64]:
        """``int64[features]``."""
        return self._space.vector(observation)
