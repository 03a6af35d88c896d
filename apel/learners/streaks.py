"""Streaks of any learner, selector and performance measure: the plain form of what the compiled banks do."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from apel.book import RUNNING, Book, advance_run
from apel.learners.base import Failure, Performance, Played, StreakLimit
from apel.selection import Selector
from apel.trajectory import Episodes, Trajectory, batch_of


def measure(performance: Performance, trajectory: Trajectory) -> float:
    """How good an episode was; larger is better."""
    if performance == "return":
        return trajectory.undiscounted_return
    if performance == "negative_length":
        return -float(len(trajectory))
    return float(performance(trajectory))


def play_streaks(
    play_one: Callable[[int, int], Trajectory],
    runs: Sequence[int],
    book: Book,
    selector: Selector,
    me: int,
    limit: StreakLimit,
    performance: Performance,
    *,
    record: bool,
) -> Played:
    """Play the streak of each run with ``play_one(run, episode)``; a run that raises fails alone."""
    trajectories: list[Trajectory] = []
    rows: list[tuple[int, int, int, float, float, bool]] = []
    failures: list[Failure] = []
    steps_per_run = max(limit.steps // len(runs), 1)
    for run in runs:
        streak_episodes, streak_steps = 0, 0
        while book.status[run] == RUNNING and book.learner[run] == me:
            episode = int(book.episode[run])
            try:
                trajectory = play_one(run, episode)
                value = measure(performance, trajectory)
                total = trajectory.undiscounted_return
                advance_run(book, selector, run, len(trajectory), total, value)
            except Exception as error:  # noqa: BLE001 - whatever a user's code raises ends this run, and only this one
                failures.append(Failure(run, episode, f"{type(error).__name__}: {error}"))
                break
            rows.append((run, episode, len(trajectory), total, value, trajectory.terminated))
            if record:
                trajectories.append(trajectory)
            streak_episodes += 1
            streak_steps += len(trajectory)
            if streak_episodes >= limit.episodes or streak_steps >= steps_per_run:
                break
    episodes = Episodes.empty(len(rows))
    for column, values in zip(episodes, zip(*rows, strict=True), strict=False):
        column[:] = values
    batch = batch_of(episodes, trajectories) if trajectories else None
    return Played(episodes, batch, (*failures, *not_finite_failures(episodes)))


def not_finite_failures(episodes: Episodes) -> tuple[Failure, ...]:
    """One failure per episode whose performance is no number."""
    bad = np.flatnonzero(~np.isfinite(episodes.performance))
    return tuple(
        Failure(int(episodes.run[i]), int(episodes.episode[i]), not_finite_message(float(episodes.performance[i])))
        for i in bad
    )


def not_finite_message(performance: float) -> str:
    """What is wrong with a performance that is no number."""
    return f"found the performance {performance}, expected a finite number"
