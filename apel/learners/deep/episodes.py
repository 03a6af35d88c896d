"""Whole episodes of a run in compiled code, where both its learner and its environment are compiled."""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium import spaces
from numba import types
from numba.extending import overload
from numpy.typing import NDArray

from apel.dynamics.batched_environment import BatchedEnvironment, Runs
from apel.dynamics.worlds import CartPoleWorld, FiniteWorld, HasWorlds, advance, begin
from apel.experience.sight import Sight
from apel.experience.trajectory import Trajectory
from apel.learners.banks.batched_learner import BatchedLearner
from apel.learners.deep import acer, dqn, sac
from apel.learners.deep.deep_learner import BatchedDeepLearner, Steps
from apel.learners.deep.encoding import Frames
from apel.numerics.compiled import njit

_ACT = {dqn.DqnArrays: dqn.act, acer.AcerArrays: acer.act, sac.SacArrays: sac.act}
_LEARN = {dqn.DqnArrays: dqn.learn, acer.AcerArrays: acer.learn, sac.SacArrays: sac.learn}


# numba wants plain functions.
# ruff: noqa: PLW0108


def act(learner: Any, runs: Any, frames: Any, actions: Any, probability: Any) -> None:
    """See `apel.learners.deep.deep_learner.Algorithm`."""
    learner.act(runs, frames, actions, probability)


def learn(learner: Any, runs: Any, steps: Any) -> None:
    """See `apel.learners.deep.deep_learner.Algorithm`."""
    learner.learn(runs, steps)


def show(world: Any, seen: Any, entries: Any, step: int, frame: Any) -> None:
    """Write what the learner sees of an entry as a memory stores it: looked up in ``seen``, or as it is."""
    frame[:] = seen[entries[step], 0] if isinstance(world, FiniteWorld) else entries[step].view(np.uint8)


@overload(act, strict=False)
def _act(learner: Any, runs: Any, frames: Any, actions: Any, probability: Any) -> Any:
    kind: Any = getattr(learner, "instance_class", None)
    algorithm = _ACT.get(kind)
    return algorithm and (
        lambda learner, runs, frames, actions, probability: algorithm(learner, runs, frames, actions, probability)
    )


@overload(learn, strict=False)
def _learn(learner: Any, runs: Any, steps: Any) -> Any:
    kind: Any = getattr(learner, "instance_class", None)
    algorithm = _LEARN.get(kind)
    return algorithm and (lambda learner, runs, steps: algorithm(learner, runs, steps))


@overload(show, strict=False)
def _show(world: Any, seen: Any, entries: Any, step: Any, frame: Any) -> Any:
    if isinstance(world, types.BaseNamedTuple) and world.instance_class is FiniteWorld:
        return _show_number
    return _show_observation


def _show_number(world: Any, seen: Any, entries: Any, step: Any, frame: Any) -> None:
    frame[:] = seen[np.int64(entries[step]), 0]


def _show_observation(world: Any, seen: Any, entries: Any, step: Any, frame: Any) -> None:
    frame[:] = entries[step].view(np.uint8)


@njit
def play_episode(
    learner: Any,
    world: Any,
    runs: Runs,
    start: Any,
    seen: Frames,
    one: Steps,
    entries: Any,
    actions: NDArray[np.int64],
    rewards: NDArray[np.float64],
    probabilities: NDArray[np.float64],
) -> tuple[int, bool]:
    """Play and learn until the end: how many steps there were, and whether the episode was terminated.

    ``one`` is room for a step; the last four arrays are written, a row per step (of entries one more).
    """
    begin(world, start, entries)
    show(world, seen, entries, 0, one.frames[0, 0])
    step = 0
    while True:
        act(learner, runs, one.frames, one.action, one.probability)
        actions[step] = one.action[0]
        probabilities[step] = one.probability[0]
        step += 1
        reward, terminated, truncated = advance(world, one.action[0], step, entries)
        show(world, seen, entries, step, one.next_frames[0, 0])
        rewards[step - 1] = one.reward[0] = reward
        one.terminated[0], one.truncated[0] = terminated, truncated
        learn(learner, runs, one)
        if terminated or truncated:
            return step, terminated
        one.frames[:] = one.next_frames


def player_of(
    learner: BatchedLearner, environment: BatchedEnvironment, sight: Sight, action_space: spaces.Discrete
) -> EpisodePlayer | None:
    """What plays episodes of a learner's runs; None where that cannot be, or would not be the same, bit for bit."""
    if not isinstance(learner, BatchedDeepLearner) or not isinstance(environment, HasWorlds):
        return None
    if not (learner.is_alone and sight.is_memoryless):
        return None
    worlds = [environment.world(run) for run in range(learner.num_runs)]
    is_finite = isinstance(worlds[0], FiniteWorld)
    if None in worlds or not (sight.is_whole or is_finite):
        return None
    seen = np.zeros((0, 1, learner.encoder.frame_bytes), dtype=np.uint8)
    if is_finite:
        states = np.arange(worlds[0].num_states)
        seen = learner.encoder.stored(sight.start(np.zeros_like(states), environment.decode(states)))
    return EpisodePlayer(learner, worlds, seen, int(action_space.n), int(action_space.start))


class EpisodePlayer:
    """Plays episodes of any run.

    Parameters
    ----------
    learner:
        Of compiled networks.
    worlds:
        Of every run, of one kind.
    seen:
        For finite ones, what the learner sees of each state, as a memory stores it.
    num_actions, first_action:
        How many actions there are, and the number of the first.
    """

    def __init__(
        self, learner: BatchedDeepLearner, worlds: list[Any], seen: Frames, num_actions: int, first_action: int
    ) -> None:
        self._learner, self._worlds, self._seen, self._first_action = learner, worlds, seen, first_action
        most, encoder = worlds[0].max_steps, learner.encoder
        kind: Any = np.uint16 if len(seen) <= np.iinfo(np.uint16).max else np.int32
        shape: tuple[int, ...] = (most + 1,)
        if isinstance(worlds[0], CartPoleWorld):
            kind, shape = np.float32, (most + 1, 4)
        self._room = (
            np.zeros(shape, dtype=kind),
            np.zeros(most, dtype=np.int64),
            np.zeros(most),
            np.zeros((most, num_actions)),
        )
        frames, next_frames = np.zeros((2, 1, encoder.stack, encoder.frame_bytes), dtype=np.uint8)
        ends = np.zeros((2, 1), dtype=np.bool_)
        self._one = Steps(
            frames,
            np.zeros(1, dtype=np.int64),
            np.zeros(1),
            next_frames,
            ends[0],
            ends[1],
            np.zeros((1, num_actions)),
            own=np.ones(1, dtype=np.bool_),
        )

    def play(self, run: int, start: NDArray[Any]) -> Trajectory:
        """An episode of a run, from what its environment makes of its seed."""
        world, runs = self._worlds[run], np.array([run], dtype=np.int64)
        self._learner.reserve(runs, world.max_steps)
        length, terminated = play_episode(self._learner.learner, world, runs, start, self._seen, self._one, *self._room)
        entries, actions, rewards, probabilities = self._room
        return Trajectory(
            observation=entries[: length + 1].copy(),
            action=actions[:length] + self._first_action,
            reward=rewards[:length].copy(),
            terminated=bool(terminated),
            probability=probabilities[:length].copy(),
        )
