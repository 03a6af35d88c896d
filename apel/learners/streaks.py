"""Streaks of any learner, selector and performance measure: the plain form of what the compiled banks do."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from apel.book import RUNNING, Book, advance_run
from apel.learners.base import Failure, Performance, Played, StreakLimit
from apel.metrics import evaluates_greedily, measure_of
from apel.selection import Selector
from apel.trajectory import Episodes, Trajectory, batch_of


def measure(performance: Performance, trajectory: Trajectory) -> float:
    """How good an episode was; larger is better."""
    if performance == "return":
        return trajectory.undiscounted_return
    if performance == "negative_length":
        return -float(len(trajectory))
    return float(performance(trajectory))


EpisodeRow = tuple[int, int, int, float, float, float, bool]
"""The columns of `Episodes` for one episode."""


class Evaluator(Protocol):
    """What plays single episodes without exploring."""

    def evaluate_one(self, run: int, episode: int) -> tuple[int, float]:
        """Length and return of one episode without exploring or learning."""
        ...


class Player(Evaluator, Protocol):
    """What plays single episodes of single runs, without the book."""

    def play_one(self, run: int, episode: int) -> Trajectory:
        """Act in one episode, learning step by step."""
        ...


def criterion_measure(book: Book, player: Evaluator, run: int, trajectory: Trajectory) -> float:
    """What the criterion measures of the coming episode of ``run``, which has just been played."""
    length, episode_return = len(trajectory), trajectory.undiscounted_return
    if evaluates_greedily(book.criterion_parameters):
        length, episode_return = player.evaluate_one(run, int(book.episode[run]))
    return float(measure_of(book.criterion_parameters, length, episode_return))


def play_streaks(
    player: Player,
    runs: Sequence[int],
    book: Book,
    selector: Selector,
    me: int,
    limit: StreakLimit,
    performance: Performance,
    *,
    record: bool,
) -> Played:
    """Play the streak of each run; a run that raises fails alone."""
    trajectories: list[Trajectory] = []
    rows: list[EpisodeRow] = []
    failures: list[Failure] = []
    steps_per_run = max(limit.steps // len(runs), 1)
    for run in runs:
        streak_episodes, streak_steps = 0, 0
        while book.status[run] == RUNNING and book.learner[run] == me:
            episode = int(book.episode[run])
            try:
                trajectory = player.play_one(run, episode)
                value = measure(performance, trajectory)
                total, judged = trajectory.undiscounted_return, criterion_measure(book, player, run, trajectory)
                advance_run(book, selector, run, len(trajectory), total, value, judged)
            except Exception as error:  # noqa: BLE001 - whatever a user's code raises ends this run, and only this one
                failures.append(Failure(run, episode, f"{type(error).__name__}: {error}"))
                break
            rows.append((run, episode, len(trajectory), total, value, judged, trajectory.terminated))
            if record:
                trajectories.append(trajectory)
            streak_episodes += 1
            streak_steps += len(trajectory)
            if streak_episodes >= limit.episodes or streak_steps >= steps_per_run:
                break
    return played(rows, trajectories, failures)


def played(rows: Sequence[EpisodeRow], trajectories: Sequence[Trajectory], failures: Sequence[Failure]) -> Played:
    """The answer of a bank; ``trajectories`` are those of ``rows``, or none."""
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
