"""Streaks: how long a learner goes on in a run, and what comes of the episodes that it finished."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from apel.experience.action_form import ActionForm
from apel.experience.trajectory import Episodes, Trajectory, batch_of
from apel.learners.base import Failure, Performance, Played, StreakLimit
from apel.numerics.compiled import njit
from apel.run.criterion import evaluates_greedily, measure_of
from apel.run.selection import Selector
from apel.run.state import RUNNING, Book, advance_run
from apel.run.user_code import fault_of, faults_of


def most_per_run(limit: StreakLimit, num_runs: int) -> NDArray[np.int64]:
    """``int64[3]``: episodes, steps and bytes of a run's streak, at least one each."""
    return np.maximum(np.array([limit.episodes, limit.steps // num_runs, limit.nbytes // num_runs]), 1)


@njit
def streak_goes_on(book: Book, run: int, me: int, streak: NDArray[np.int64], most: NDArray[np.int64]) -> bool:
    """Whether learner ``me`` plays the run's next episode too, after a ``streak`` of so many episodes, steps and bytes
    (``int64[3]``, like the ``most`` that it may have).
    """
    if book.status[run] != RUNNING or book.learner[run] != me:
        return False
    if book.pause_every > 0 and book.steps[run] // book.pause_every > (book.steps[run] - streak[1]) // book.pause_every:
        return False
    return streak[0] < most[0] and streak[1] < most[1] and streak[2] < most[2]


def measure(performance: Performance, trajectory: Trajectory) -> float:
    """How good an episode was; larger is better."""
    if performance == "return":
        return trajectory.undiscounted_return
    if performance == "negative_length":
        return -float(len(trajectory))
    return float(performance(trajectory))


class Decoder(Protocol):
    """What knows how observations stand in trajectories, see `apel.dynamics.batched_environment.BatchedEnvironment`."""

    def decode(self, entries: NDArray[Any]) -> NDArray[Any]:
        """The raw observations ``[…, features]``, or ``[…]`` where there is only one feature."""
        ...


class Evaluator(Protocol):
    """What plays single episodes without exploring, and knows the form of what is in trajectories."""

    @property
    def environment(self) -> Decoder:
        """The environments of all runs."""
        ...

    @property
    def actions(self) -> ActionForm:
        """The form of their actions."""
        ...

    def evaluate_one(self, run: int, episode: int) -> tuple[int, float]:
        """Length and return of one episode without exploring or learning."""
        ...


class Streaks:
    """The streaks of one round, and the answer that they add up to.

    Parameters
    ----------
    evaluator:
        Measures the episodes that the criterion wants measured without exploring, and knows what a user's
        ``performance`` is shown.
    runs, book, selector, me, limit, record:
        See `apel.learners.base.LearnerBank`.
    performance:
        How good an episode was.
    raises:
        What a user's code raises is raised; otherwise it ends its run, and only this one.
    """

    def __init__(
        self,
        evaluator: Evaluator,
        runs: Sequence[int],
        book: Book,
        selector: Selector,
        me: int,
        limit: StreakLimit,
        performance: Performance,
        *,
        record: bool,
        raises: bool = False,
    ) -> None:
        self._evaluator, self._book, self._selector, self._me = evaluator, book, selector, me
        self._performance, self._record, self._raises = performance, record, raises
        self._most = most_per_run(limit, len(runs))
        self._streak = {run: np.zeros(3, dtype=np.int64) for run in runs}
        self._rows: list[tuple[Any, ...]] = []
        self._trajectories: list[Trajectory] = []
        self._failures: list[Failure] = []

    def finish(self, run: int, trajectory: Trajectory) -> bool:
        """Take in the run's finished episode; whether its streak goes on."""
        try:
            self._take_in(run, trajectory)
        except BaseException as error:  # noqa: BLE001 - it ends this run, and only this one
            self.fail(run, fault_of("selector", error))
            return False
        nbytes = trajectory.nbytes if self._record else 0
        self._streak[run] += np.array([1, len(trajectory), nbytes])
        return bool(streak_goes_on.py_func(self._book, run, self._me, self._streak[run], self._most))

    def fail(self, run: int, error: BaseException) -> None:
        """The run cannot go on; its episode under way is lost."""
        if self._raises:
            raise error
        self._failures.append(Failure.of(run, int(self._book.episode[run]), error))

    def played(self) -> Played:
        """All finished episodes, and all failures."""
        episodes = Episodes.empty(len(self._rows))
        for column, values in zip(episodes, zip(*self._rows, strict=True), strict=False):
            column[:] = values
        batch = batch_of(episodes, self._trajectories) if self._trajectories else None
        return Played(episodes, batch, (*self._failures, *not_finite_failures(episodes)))

    def _take_in(self, run: int, trajectory: Trajectory) -> None:
        book, episode = self._book, int(self._book.episode[run])
        shown = self._shown(trajectory) if callable(self._performance) else trajectory
        with faults_of("performance"):
            performance = measure(self._performance, shown)
        total = trajectory.undiscounted_return
        judged = self._judged(run, trajectory)
        advance_run(book, self._selector, run, len(trajectory), total, performance, judged)
        self._rows.append((run, episode, len(trajectory), total, performance, judged, trajectory.terminated))
        if self._record:
            self._trajectories.append(trajectory)

    def _shown(self, trajectory: Trajectory) -> Trajectory:
        """What a user's function gets: the same form whatever plays, in arrays of its own.

        Banks keep state numbers and actions in as few bytes as hold them, in which a user's arithmetic would wrap
        around; and what it writes must not reach what is recorded, and what others learn from.
        """
        probability = trajectory.probability
        return replace(
            trajectory,
            observation=np.array(self._evaluator.environment.decode(trajectory.observation)),
            action=self._evaluator.actions.column(self._evaluator.actions.rows(trajectory.action)),
            reward=trajectory.reward.copy(),
            probability=None if probability is None else probability.copy(),
        )

    def _judged(self, run: int, trajectory: Trajectory) -> float:
        """What the criterion measures of the run's episode."""
        parameters = self._book.criterion_parameters[run]
        length, episode_return = len(trajectory), trajectory.undiscounted_return
        if evaluates_greedily(parameters):
            length, episode_return = self._evaluator.evaluate_one(run, int(self._book.episode[run]))
        return float(measure_of(parameters, length, episode_return))


def not_finite_failures(episodes: Episodes) -> tuple[Failure, ...]:
    """One failure per episode whose performance, or return, is no number."""
    performance, episode_return = episodes.performance, episodes.episode_return
    failures = []
    for place in np.flatnonzero(~(np.isfinite(performance) & np.isfinite(episode_return))).tolist():
        what = f"performance {performance[place]}"
        if np.isfinite(performance[place]):
            what = f"return {episode_return[place]}"
        run, episode = int(episodes.run[place]), int(episodes.episode[place])
        failures.append(Failure(run, episode, f"found the {what}, expected a finite number"))
    return tuple(failures)
