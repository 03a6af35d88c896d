"""Others' episodes one after the other, for learners to which the steps of several may be told in one call."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from apel.dynamics.batched_environment import Runs, Stepped
from apel.experience.action_form import ActionForm
from apel.experience.trajectory import TrajectoryBatch


class WholeEpisodes(NamedTuple):
    """All N steps of some episodes, in the order of play."""

    runs: Runs
    """``int64[N]``."""
    episodes: NDArray[np.int64]
    """``int64[N]``: indices on the runs' clocks."""
    entry: NDArray[Any]
    """``[N, …]``: the raw observations before the steps."""
    action: NDArray[Any]
    """As banks have them."""
    stepped: Stepped
    probability: NDArray[np.float64]
    """``float64[N, actions]``: NaN in the episodes in which it is not known."""


def whole_episodes(batch: TrajectoryBatch, actions: ActionForm, most_steps: int) -> Iterator[WholeEpisodes]:
    """As many episodes at a time as have ``most_steps`` together, and at least one."""
    episodes, length = batch.episodes, batch.episodes.length
    end = np.cumsum(length)
    position = np.repeat(np.arange(len(length)), length)
    is_last = np.zeros(len(position), dtype=np.bool_)
    is_last[end - 1] = True
    first = 0
    while first < len(length):
        begin = int(end[first] - length[first])
        after = max(first + 1, int(np.searchsorted(end, begin + most_steps, side="right")))
        steps = slice(begin, int(end[after - 1]))
        which = position[steps]
        # Every episode has an observation more than it has steps.
        entry = batch.observation[begin + first : steps.stop + after]
        is_one, at = after == first + 1, np.arange(len(which)) + which - first
        terminated = is_last[steps] & episodes.terminated[which]
        yield WholeEpisodes(
            runs=episodes.run[which],
            episodes=episodes.episode[which],
            entry=entry[:-1] if is_one else entry[at],
            action=actions.counted(batch.action[steps]),
            stepped=Stepped(
                entry=entry[1:] if is_one else entry[at + 1],
                reward=batch.reward_value[batch.reward_code[steps]],
                terminated=terminated,
                truncated=is_last[steps] & ~terminated,
            ),
            probability=actions.unknown(len(which)) if batch.probability is None else batch.probability[steps],
        )
        first = after
