"""A finite environment with Gymnasium's interface, and the tables of Gymnasium's own finite environments."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Protocol, runtime_checkable

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from apel.dynamics.finite_model import FiniteModel
from apel.environments.misuse import NO_EPISODE, check_step
from apel.numerics.streams import integer, stream_of_seed, uniform

_TOLERANCE = 1e-9  # of a sum of probabilities, such as three thirds


@runtime_checkable
class HasFiniteModel(Protocol):
    """An environment that exposes its tables."""

    @property
    def finite_model(self) -> FiniteModel:
        """The environment's tables."""
        ...


@runtime_checkable
class HasTransitionTable(Protocol):
    """An environment in the style of Gymnasium's toy-text family (FrozenLake, CliffWalking, Taxi)."""

    P: dict[int, dict[int, list[tuple[float, int, float, bool]]]]
    """For each state and action the outcomes ``(probability, next state, reward, terminated)``."""
    initial_state_distrib: NDArray[np.float64]


class FiniteEnvironment(gymnasium.Env[Any, np.int64]):
    """Plays the tables of a `FiniteModel`, step by step, with the same streams as compiled code.

    The observation is ``int64[features]``, or a plain number where there is only one feature. After
    ``reset(seed=s)`` the whole episode is a function of ``s`` and the actions; without a seed, ``s`` is drawn from the
    environment's generator, as Gymnasium prescribes.
    """

    def __init__(self, model: FiniteModel) -> None:
        self.finite_model = model
        self.observation_space = (
            spaces.MultiDiscrete(list(model.feature_sizes))
            if len(model.feature_sizes) > 1
            else spaces.Discrete(model.feature_sizes[0])
        )
        self.action_space = spaces.Discrete(model.num_actions)
        self._stream = stream_of_seed(0)
        self._values = model.feature_values()
        self._cell = 0
        self._steps = NO_EPISODE

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Start an episode."""
        super().reset(seed=seed)
        episode_seed = int(self.np_random.integers(2**63)) if seed is None else seed
        self._stream = stream_of_seed(episode_seed)
        model = self.finite_model
        start = 0
        if len(model.start_cell) > 1:
            start = int(np.searchsorted(model.start_cumulative, uniform(self._stream), side="right"))
        self._cell = int(model.start_cell[start])
        self._steps = 0
        return self._observe(), dict(model.info)

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Play one action.

        Raises
        ------
        RuntimeError
            If no episode is under way.
        ValueError
            If there is no such action.
        """
        check_step(action, self.action_space, self._steps)
        model = self.finite_model
        outcomes = model.cumulative[self._cell, action]
        outcome = 0
        if len(outcomes) > 1:
            outcome = int(np.searchsorted(outcomes, uniform(self._stream), side="right"))
        reward = float(model.reward[self._cell, action, outcome])
        terminated = bool(model.terminal[self._cell, action, outcome])
        self._cell = int(model.next_cell[self._cell, action, outcome])
        self._steps += 1
        truncated = not terminated and self._steps >= model.max_steps
        observation = self._observe()
        if terminated or truncated:
            self._steps = NO_EPISODE
        return observation, reward, terminated, truncated, {}

    def _observe(self) -> Any:
        distractor_values = self.finite_model.num_distractor_values
        distractor = integer(self._stream, distractor_values) if distractor_values > 1 else 0
        values: NDArray[np.int64] = self._values[self._cell * distractor_values + distractor]
        return values.copy() if len(values) > 1 else int(values[0])


def fault_of_toy_text(raw: Any) -> str | None:
    """Why the tables of such an environment say too little, or something else than its spaces; None where they do not.

    Probabilities that do not add up to 1 mean something to Gymnasium's draws, but not to these tables.
    """
    starts = np.asarray(raw.initial_state_distrib, dtype=np.float64)
    num_states, num_actions = len(raw.P), len(next(iter(raw.P.values()), ()))
    if type(raw.P) is not dict or set(raw.P) != set(range(num_states)) or starts.shape != (num_states,):
        return "its tables are not of states that are numbered from 0"
    for state, actions in raw.P.items():
        if set(actions) != set(range(num_actions)):
            return f"its tables have other actions in state {state} than elsewhere"
        for action, outcomes in actions.items():
            if not _is_distribution([outcome[0] for outcome in outcomes]):
                return f"the probabilities of action {action} in state {state} are no distribution"
            if not all(outcome[1] in raw.P and math.isfinite(outcome[2]) for outcome in outcomes):
                return f"action {action} in state {state} leads to what is no state, or pays what is no number"
    if not _is_distribution(starts.tolist()):
        return "the probabilities of its starts are no distribution"
    if raw.observation_space != spaces.Discrete(num_states) or raw.action_space != spaces.Discrete(num_actions):
        found = f"{raw.observation_space} and {raw.action_space}"
        return f"its spaces {found} are not those of its tables, of {num_states} states and {num_actions} actions"
    return None


def _is_distribution(probability: Sequence[float]) -> bool:
    return all(p >= 0.0 for p in probability) and abs(math.fsum(probability) - 1.0) < _TOLERANCE


def toy_text_model(raw: HasTransitionTable, max_steps: int) -> FiniteModel:
    """The tables of such an environment."""
    num_states, num_actions = len(raw.P), len(raw.P[0])
    width = max(len(outcomes) for actions in raw.P.values() for outcomes in actions.values())
    shape = (num_states, num_actions, width)
    probability, reward = np.zeros(shape), np.zeros(shape)
    next_cell, terminal = np.zeros(shape, dtype=np.int32), np.zeros(shape, dtype=np.bool_)
    for state, actions in raw.P.items():
        for action, outcomes in actions.items():
            for k, (p, successor, r, end) in enumerate(outcomes):
                probability[state, action, k] = p
                next_cell[state, action, k] = successor
                reward[state, action, k] = r
                terminal[state, action, k] = end
    starts = np.flatnonzero(raw.initial_state_distrib)
    return FiniteModel(
        next_cell=next_cell,
        cumulative=_cumulative(probability),
        reward=reward,
        terminal=terminal,
        start_cell=starts.astype(np.int32),
        start_cumulative=_cumulative(np.asarray(raw.initial_state_distrib, dtype=np.float64)[starts]),
        max_steps=max_steps,
        features=("state",),
        feature_sizes=(num_states,),
    )


def _cumulative(probability: NDArray[np.float64]) -> NDArray[np.float64]:
    """Cumulative sums over the last axis that end in exactly 1, and reach it at the last possible outcome."""
    total = np.cumsum(probability, axis=-1)
    possible_later = np.cumsum(probability[..., ::-1], axis=-1)[..., ::-1] - probability > 0
    return np.where(possible_later, total, 1.0)
