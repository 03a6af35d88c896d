"""Some hundred steps of an environment held against the faster form in which it is to be played.

What is faster and differs would be wrong without a word; a few milliseconds at the start are the price of knowing.
"""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np

from apel.dynamics.batched_environment import BatchedEnvironment
from apel.dynamics.finite_model import FiniteModel
from apel.environments.finite_environment import FiniteEnvironment

_NUM_EPISODES, _NUM_STEPS, _NUM_PAIRS = 8, 200, 200
_ONLY = np.zeros(1, dtype=np.int64)

Seen = tuple[Any, float, bool, bool]
"""Observation, reward, terminated, truncated; the end of a step that terminates is no truncation besides."""


def plays_otherwise(environment: gymnasium.Env[Any, Any], model: FiniteModel) -> str | None:
    """Where ``environment`` does not play value for value what `FiniteEnvironment` plays of ``model`` with the same
    seeds and actions; None where nothing was found.
    """
    return _first_difference(environment, _Twin(FiniteEnvironment(model)))


def plays_beside_its_batch(environment: gymnasium.Env[Any, Any], batched: BatchedEnvironment) -> str | None:
    """The same of an environment and its form for many runs, of which this one is the first."""
    return _first_difference(environment, _TwinOfBatch(batched))


def steps_beside_its_tables(environment: gymnasium.Env[Any, Any], base: Any, model: FiniteModel) -> str | None:
    """Where an environment of Gymnasium's toy-text family does what its tables do not know; None where nothing was
    found.

    Its chance is its own, so that every start and every outcome must be a possible one of the tables. It is ``base``
    inside of ``environment``, whose state is its attribute ``s``.
    """
    rng = np.random.default_rng(0)
    starts, left = set(model.start_cell.tolist()), _NUM_STEPS
    for seed in range(_NUM_EPISODES):
        state, _ = environment.reset(seed=seed)
        if state not in starts:
            return f"the start {state!r}, expected one of {sorted(starts)[:10]}"
        length, is_over = 0, False
        while not is_over and left > 0:
            action, length, left = int(rng.integers(model.num_actions)), length + 1, left - 1
            seen, state_before = _stepped(environment, action), state
            truncated = not seen[2] and length >= model.max_steps
            if difference := _unknown_outcome(model, state_before, action, seen, truncated=truncated):
                return difference
            state, is_over = seen[0], seen[2] or seen[3]
    return _unknown_pair(base, model)


def _unknown_pair(base: Any, model: FiniteModel) -> str | None:
    """Pairs of states and actions all over the tables, since episodes of chance stay near their starts."""
    base.reset(seed=0)
    num_pairs = model.next_cell.shape[0] * model.num_actions
    for pair in np.unique(np.linspace(0, num_pairs - 1, _NUM_PAIRS, dtype=np.int64)).tolist():
        state, action = divmod(pair, model.num_actions)
        base.s = state
        if difference := _unknown_outcome(model, state, action, _stepped(base, action), truncated=False):
            return difference
    return None


def _unknown_outcome(model: FiniteModel, state: int, action: int, seen: Seen, *, truncated: bool) -> str | None:
    possible = np.diff(model.cumulative[state, action], prepend=0.0) > 0
    columns = (model.next_cell, model.reward, model.terminal)
    outcomes = list(zip(*(column[state, action][possible].tolist() for column in columns), strict=True))
    if seen[:3] in outcomes and seen[3] == truncated:
        return None
    return f"{_told(seen)} after action {action} in state {state}, expected {_told_outcomes(outcomes, truncated)}"


class _Twin:
    """The faster form, one episode after the other."""

    def __init__(self, environment: gymnasium.Env[Any, Any]) -> None:
        self._environment = environment

    def reset(self, seed: int) -> Any:
        return self._environment.reset(seed=seed)[0]

    def step(self, action: int) -> Seen:
        return _stepped(self._environment, action)


class _TwinOfBatch:
    def __init__(self, batched: BatchedEnvironment) -> None:
        self._batched = batched

    def reset(self, seed: int) -> Any:
        return self._batched.decode(self._batched.reset(_ONLY, [seed]).entry)[0]

    def step(self, action: int) -> Seen:
        stepped = self._batched.step(_ONLY, np.array([action]))
        reward, terminated, truncated = (float(stepped.reward[0]), *map(bool, stepped[2:4]))
        return self._batched.decode(stepped.entry)[0], reward, terminated, truncated


def _first_difference(environment: gymnasium.Env[Any, Any], twin: _Twin | _TwinOfBatch) -> str | None:
    rng, left = np.random.default_rng(0), _NUM_STEPS
    actions: Any = environment.action_space
    for seed in range(_NUM_EPISODES):
        found, expected, is_over = environment.reset(seed=seed)[0], twin.reset(seed), False
        if not _is_same(found, expected):
            return f"the start {found!r} with seed {seed}, expected {expected!r}"
        while not is_over and left > 0:
            action, left = int(rng.integers(actions.n)), left - 1
            one, other = _stepped(environment, action), twin.step(action)
            if not _is_same(one[0], other[0]) or one[1:] != other[1:]:
                return f"{_told(one)} after action {action}, expected {_told(other)}"
            is_over = one[2] or one[3]
    return None


def _stepped(environment: gymnasium.Env[Any, Any], action: int) -> Seen:
    observation, reward, terminated, truncated, _ = environment.step(action)
    return observation, float(reward), bool(terminated), bool(truncated and not terminated)


def _is_same(one: Any, other: Any) -> bool:
    return bool(np.array_equal(np.asarray(one), np.asarray(other)))


def _told(seen: Seen) -> str:
    observation, reward, terminated, truncated = seen
    end = "terminated" if terminated else "truncated" if truncated else "not over"
    return f"observation {observation!r}, reward {reward!r} and an episode that is {end}"


def _told_outcomes(outcomes: list[tuple[Any, ...]], truncated: bool) -> str:
    return " or ".join(_told((*outcome, truncated)) for outcome in outcomes[:3])
