"""From a step of the environments to what learners are told of it: the one place where channels, exclusion, bins,
stacks, private rewards and private ends meet.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from apel.dynamics.batched_environment import Runs
from apel.experience.frame_stacking import ViewStacks
from apel.experience.representations import View


class Told(NamedTuple):
    """What the learners of A runs are told of one step."""

    reward: NDArray[np.float64]
    next_observation: NDArray[Any]
    """``[A, …]``, or ``object[A]`` where runs have views of their own."""
    terminated: NDArray[np.bool_]
    truncated: NDArray[np.bool_]
    coming: NDArray[Any]
    """What they see when they act next: the next observation, but where an episode has begun for them alone."""


class Sight:
    """The eyes of R runs.

    Parameters
    ----------
    views:
        One per run.

    Attributes
    ----------
    is_memoryless:
        Nobody stacks: what a run sees of a step does not depend on the steps before.
    is_whole:
        Everybody sees observations as they are.
    """

    def __init__(self, views: Sequence[View]) -> None:
        self._views: list[View] = []
        kinds = [self._kind_of(view) for view in views]
        self._kind = np.array(kinds, dtype=np.int64)
        self._stacks = [ViewStacks(len(views), view.stack, view.space) for view in self._views]
        self.is_memoryless = all(view.stack == 1 for view in self._views)
        self.is_whole = self.is_memoryless and all(view.is_whole for view in self._views)
        self._has_private_ends = any(view.has_private_end for view in self._views)

    def start(self, runs: Runs, observations: NDArray[Any]) -> NDArray[Any]:
        """What the learners see at the raw observations ``[A, …]``, where an episode begins for them."""
        return self._seen(runs, observations, begins=True)

    def step(
        self,
        runs: Runs,
        observations: NDArray[Any],
        reward: NDArray[np.float64],
        terminated: NDArray[np.bool_],
        truncated: NDArray[np.bool_],
    ) -> Told:
        """What the learners are told of a step that led to the raw ``observations`` ``[A, …]``."""
        seen = self._seen(runs, observations, begins=False)
        reward, ends = self._judged(runs, observations, reward, terminated)
        coming = self._coming(runs, observations, seen, ends & ~terminated)
        return Told(reward, seen, ends, truncated & ~ends, coming)

    def ends(self, runs: Runs, observations: NDArray[Any]) -> NDArray[np.bool_]:
        """``bool[A]``: whether an episode ends for the learners alone."""
        goes_on = np.zeros(len(runs), dtype=np.bool_)
        return self._judged(runs, observations, np.zeros(len(runs)), goes_on)[1]

    def push(self, runs: Runs, observations: NDArray[Any]) -> NDArray[Any]:
        """What the learners see when they act after a step, of which they are told nothing else."""
        seen = self._seen(runs, observations, begins=False)
        return self._coming(runs, observations, seen, self.ends(runs, observations))

    def _coming(
        self, runs: Runs, observations: NDArray[Any], seen: NDArray[Any], again: NDArray[np.bool_]
    ) -> NDArray[Any]:
        if not self._has_private_ends or not again.any():
            return seen
        coming = seen.copy()  # learners may keep what they were told
        coming[again] = self.start(runs[again], observations[again])
        return coming

    def _seen(self, runs: Runs, observations: NDArray[Any], *, begins: bool) -> NDArray[Any]:
        if len(self._views) == 1:
            return self._stacked(0, runs, observations, begins=begins)
        seen = np.empty(len(runs), dtype=object)
        for kind, chosen in self._kinds(runs):
            rows = self._stacked(kind, runs[chosen], observations[chosen], begins=begins)
            for position, row in zip(chosen.tolist(), rows, strict=True):
                seen[position] = row
        return seen

    def _stacked(self, kind: int, runs: Runs, observations: NDArray[Any], *, begins: bool) -> NDArray[Any]:
        stacks, viewed = self._stacks[kind], self._views[kind].batch(observations)
        return stacks.start(runs, viewed) if begins else stacks.push(runs, viewed)

    def _judged(
        self, runs: Runs, observations: NDArray[Any], reward: NDArray[np.float64], terminated: NDArray[np.bool_]
    ) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
        if len(self._views) == 1:
            view = self._views[0]
            return view.rewards(reward, observations), view.terminals(terminated, observations)
        paid, ends = reward.copy(), terminated.copy()
        for kind, chosen in self._kinds(runs):
            view, there = self._views[kind], observations[chosen]
            paid[chosen] = view.rewards(reward[chosen], there)
            ends[chosen] = view.terminals(terminated[chosen], there)
        return paid, ends

    def _kind_of(self, view: View) -> int:
        """Its position among different views, which it may have to join."""
        for kind, known in enumerate(self._views):
            if view is known or view.sees_like(known):
                return kind
        self._views.append(view)
        return len(self._views) - 1

    def _kinds(self, runs: Runs) -> Iterator[tuple[int, NDArray[np.int64]]]:
        """The views among ``runs``, each with the positions of those that have it."""
        kinds = self._kind[runs]
        for kind in np.unique(kinds).tolist():
            yield kind, np.flatnonzero(kinds == kind)
