"""Any learner on any environment with a discrete action space, for all runs of a shard: a loop over objects."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np

from apel.book import Book
from apel.learners.base import Failure, Performance, Played, State, StreakLimit
from apel.learners.member import Member
from apel.learners.streaks import play_streaks
from apel.selection import Selector
from apel.streams import episode_seed, evaluation_seed
from apel.trajectory import Trajectory, TrajectoryBatch


class GenericBank:
    """One `Member` and one environment per run.

    Environments are reseeded for every episode, from the run's key, so that an episode does not depend on those
    before it.
    """

    def __init__(
        self,
        members: Sequence[Member],
        environments: Sequence[gymnasium.Env[Any, Any]],
        environment_keys: Sequence[int],
        performance: Performance,
    ) -> None:
        self._members = members
        self._environments = environments
        self._keys = [np.uint64(key) for key in environment_keys]
        self._performance = performance

    def play(
        self, runs: Sequence[int], book: Book, selector: Selector, me: int, limit: StreakLimit, *, record: bool
    ) -> Played:
        """See `LearnerBank`."""
        return play_streaks(self, runs, book, selector, me, limit, self._performance, record=record)

    def learn(self, batch: TrajectoryBatch) -> tuple[Failure, ...]:
        """Learn from others' episodes; a run whose learner raises fails alone."""
        failures: dict[int, Failure] = {}
        for run, episode, trajectory in batch.trajectories():
            if run in failures:
                continue
            try:
                self._members[run].learn(trajectory, episode)
            except Exception as error:  # noqa: BLE001 - whatever a user's code raises ends this run, and only this one
                failures[run] = Failure(run, episode, f"{type(error).__name__}: {error}")
        return tuple(failures.values())

    def state(self) -> State:
        """The states of all learners."""
        return {"learners": [member.learner.state() for member in self._members]}

    def restore(self, state: State) -> None:
        """Go back to what `state` returned."""
        for member, one in zip(self._members, state["learners"], strict=True):
            member.learner.restore(one)

    def play_one(self, run: int, episode: int) -> Trajectory:
        """See `apel.learners.streaks.Player`."""
        return self._members[run].play(self._environments[run], episode_seed(self._keys[run], episode), episode)

    def evaluate_one(self, run: int, episode: int) -> tuple[int, float]:
        """See `apel.learners.streaks.Player`."""
        return self._members[run].evaluate(self._environments[run], evaluation_seed(self._keys[run], episode))
