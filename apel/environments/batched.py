"""The environments of several runs in lockstep, each kind as fast as it can be (see
`apel.dynamics.batched_environment`).

Whatever the kind, run r plays value for value what its own environment would play alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from apel.dynamics.batched_environment import BatchedEnvironment, Runs, Stepped
from apel.dynamics.finite_model import (
    FiniteModel,
    FiniteTables,
    draw_distractor,
    draw_outcome,
    draw_start,
    stack_models,
)
from apel.dynamics.worlds import FiniteWorld
from apel.environments.cartpole import CartPole, batched_cart_pole, obstacle_to_batch
from apel.environments.environment_list import EnvironmentList
from apel.environments.factory import World
from apel.environments.misuse import NO_EPISODE, check_under_way
from apel.numerics.compiled import njit
from apel.numerics.streams import Stream, start_stream, stream_of_seed


def batched_environment(worlds: Sequence[World]) -> BatchedEnvironment:
    """The environments of these runs, at least one, in the fastest form that fits all of them.

    Raises
    ------
    ValueError
        If they are finite, but differ in shape.
    """
    models = [world.model for world in worlds if world.model is not None]
    if len(models) == len(worlds):
        return BatchedFinite(models)
    return batched_cart_pole([world.environment for world in worlds]) or environment_list(worlds)


def environment_list(worlds: Sequence[World]) -> EnvironmentList:
    """The environments of these runs as they are: whoever looks at one sees what is played."""
    sizes = {None if world.model is None else tuple(world.model.feature_sizes) for world in worlds}
    feature_sizes = sizes.pop() if len(sizes) == 1 else None
    return EnvironmentList([world.environment for world in worlds], feature_sizes, worlds[0].observations)


def way_of_play(world: World) -> str:
    """How the environment of a run is played, and why, in words."""
    if world.model is not None:
        return f"played by its tables ({world.reason})"
    is_cart_pole = isinstance(world.environment.unwrapped, CartPole)
    if is_cart_pole and (obstacle := obstacle_to_batch(world.environment)) is None:
        return "all runs of a shard at once (CartPole, unchanged)"
    return f"step by step: {obstacle if is_cart_pole else world.reason}"


class BatchedFinite:
    """R finite environments in compiled code; draw for draw what `FiniteEnvironment` plays with the same seeds.

    Entries are state numbers, ``uint16[A]`` where they fit, otherwise ``int32[A]``.

    Parameters
    ----------
    models:
        The tables of each run, of equal shapes.
    """

    def __init__(self, models: Sequence[FiniteModel]) -> None:
        self._world = stack_models(models)
        self._num_actions = models[0].num_actions
        values = models[0].feature_values()
        # A single feature is a plain number of a Discrete space.
        self._values = values if values.shape[1] > 1 else values[:, 0]
        self._entry_type = models[0].state_type
        self._streams = np.zeros((len(models), 2), dtype=np.uint64)
        self._cells = np.zeros(len(models), dtype=np.int64)
        self._steps = np.full(len(models), NO_EPISODE, dtype=np.int64)

    def reset(self, runs: Runs, seeds: Sequence[int]) -> Stepped:
        """Start an episode of each run with its seed, 0 … 2⁶⁴ − 1."""
        result = self._room(len(runs))
        words = np.array(seeds, dtype=np.uint64)
        _reset_runs(self._world, runs, words, self._streams, self._cells, self._steps, result.entry)
        return result

    def step(self, runs: Runs, actions: NDArray[np.int64]) -> Stepped:
        """Play one action in each run.

        Raises
        ------
        RuntimeError
            If a run has no episode under way.
        ValueError
            If there is no such action.
        """
        check_under_way(self._steps[runs])
        if ((actions < 0) | (actions >= self._num_actions)).any():
            message = f"found the actions {actions.tolist()}, expected numbers from 0 to {self._num_actions - 1}"
            raise ValueError(message)
        result = self._room(len(runs))
        columns = (result.entry, result.reward, result.terminated, result.truncated)
        _step_runs(self._world, runs, actions, self._streams, self._cells, self._steps, *columns)
        return result

    def decode(self, entries: NDArray[Any]) -> NDArray[np.int64]:
        """``int64[…, features]``, or ``int64[…]`` where there is only one feature."""
        return self._values[entries]

    def world(self, run: int) -> FiniteWorld:
        """See `apel.dynamics.worlds.HasWorlds`."""
        room = np.zeros(1, dtype=np.int64), np.zeros(2, dtype=np.uint64)
        return FiniteWorld(self._world, int(self._world.model[run]), self._world.max_steps, *room)

    def start(self, seed: int) -> Stream:
        """See `apel.dynamics.worlds.HasWorlds`: the stream of the episode."""
        return stream_of_seed(seed)

    def _room(self, count: int) -> Stepped:
        return Stepped(
            entry=np.zeros(count, dtype=self._entry_type),
            reward=np.zeros(count),
            terminated=np.zeros(count, dtype=np.bool_),
            truncated=np.zeros(count, dtype=np.bool_),
        )


@njit
def _reset_runs(
    world: FiniteTables,
    runs: Runs,
    seeds: NDArray[np.uint64],
    streams: Stream,
    cells: NDArray[np.int64],
    steps: NDArray[np.int64],
    entry: NDArray[Any],
) -> None:
    """Start an episode of each of A ``runs``; ``entry`` is written, ``[A]``; the other arrays are of all R runs."""
    for i in range(runs.shape[0]):
        run = runs[i]
        start_stream(seeds[i], streams[run])
        cell, distractor = draw_start(world, world.model[run], streams[run])
        cells[run], steps[run] = cell, 0
        entry[i] = cell * world.num_distractor_values + distractor


@njit
def _step_runs(
    world: FiniteTables,
    runs: Runs,
    actions: NDArray[np.int64],
    streams: Stream,
    cells: NDArray[np.int64],
    steps: NDArray[np.int64],
    entry: NDArray[Any],
    reward: NDArray[np.float64],
    terminated: NDArray[np.bool_],
    truncated: NDArray[np.bool_],
) -> None:
    """One step of each of A ``runs``; the last four arrays are written, ``[A]``; those before are of all R runs."""
    for i in range(runs.shape[0]):
        run, action = runs[i], actions[i]
        model, cell, stream = world.model[run], cells[run], streams[run]
        outcome = draw_outcome(world, model, cell, action, stream)
        cells[run] = world.next_cell[model, cell, action, outcome]
        steps[run] += 1
        entry[i] = cells[run] * world.num_distractor_values + draw_distractor(world, stream)
        reward[i] = world.reward_value[world.reward_code[model, cell, action, outcome]]
        terminated[i] = world.terminal[model, cell, action, outcome]
        truncated[i] = not terminated[i] and steps[run] >= world.max_steps
        if terminated[i] or truncated[i]:
            steps[run] = NO_EPISODE
