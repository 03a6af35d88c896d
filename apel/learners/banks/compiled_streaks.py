"""Compiled loops over episodes: whole streaks of tabular learners, and learning from the episodes of others."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from apel.dynamics.finite_model import FiniteTables
from apel.experience.trajectory import Episodes
from apel.learners.banks.streaks import streak_goes_on
from apel.learners.tabular.kernels import TrajectoryRoom, evaluate_episode, freeze_at_epoch, learn_step, play_episode
from apel.learners.tabular.tables import Tables
from apel.numerics.compiled import njit
from apel.numerics.streams import episode_seed, evaluation_seed, start_stream
from apel.run.criterion import evaluates_greedily, measure_of
from apel.run.selection import Observe, Select
from apel.run.state import Book, advance


@njit
def play_compiled_streaks(
    runs: NDArray[np.int64],
    world: FiniteTables,
    environment_key: NDArray[np.uint64],
    tables: Tables,
    book: Book,
    select: Select,
    observe: Observe,
    me: int,
    by_length: bool,
    most: NDArray[np.int64],
    bytes_per_step: int,
    record: bool,
    recording: TrajectoryRoom,
    episodes: Episodes,
) -> int:
    """Play each run's streak (see `streak_goes_on`), of steps of so many bytes; returns the number of episodes."""
    stream, streak = np.empty(2, dtype=np.uint64), np.empty(3, dtype=np.int64)
    count, start = 0, 0
    for run in runs:
        streak[:] = 0
        goes_on = True
        while goes_on:
            episode = book.episode[run]
            start_stream(episode_seed(environment_key[run], episode), stream)
            length, episode_return, terminated = play_episode(
                world, tables, run, episode, stream, recording, start, count, record
            )
            performance = -float(length) if by_length else episode_return
            measure = measure_of(book.criterion_parameters[run], length, episode_return)
            if evaluates_greedily(book.criterion_parameters[run]):
                start_stream(evaluation_seed(environment_key[run], episode), stream)
                evaluated_length, evaluated_return = evaluate_episode(world, tables, run, stream)
                measure = measure_of(book.criterion_parameters[run], evaluated_length, evaluated_return)
            episodes.run[count] = run
            episodes.episode[count] = episode
            episodes.length[count] = length
            episodes.episode_return[count] = episode_return
            episodes.performance[count] = performance
            episodes.measure[count] = measure
            episodes.terminated[count] = terminated
            count += 1
            start += length
            streak[0] += 1
            streak[1] += length
            streak[2] += length * bytes_per_step
            advance(book, select, observe, run, length, episode_return, performance, measure)
            goes_on = streak_goes_on(book, run, me, streak, most)
    return count


@njit
def skip_episodes(episodes: Episodes, tables: Tables) -> None:
    """What a run's epochs ask for where nothing is learned from its episodes."""
    for e in range(episodes.run.shape[0]):
        freeze_at_epoch(tables, episodes.run[e], episodes.episode[e])


@njit
def learn_episodes(
    episodes: Episodes,
    observation: NDArray[Any],
    action: NDArray[Any],
    reward_code: NDArray[Any],
    reward_value: NDArray[np.float64],
    tables: Tables,
) -> None:
    """Learn from every step of a batch, in order."""
    start = 0
    for e in range(episodes.run.shape[0]):
        run, length = episodes.run[e], episodes.length[e]
        freeze_at_epoch(tables, run, episodes.episode[e])
        last = length - 1 if episodes.terminated[e] else length
        for member in range(run * tables.num_members, (run + 1) * tables.num_members):
            rows, values = tables.row[tables.row_set[member]], tables.value[member]
            row = np.int64(rows[observation[start + e]])
            for step in range(length):
                next_row = np.int64(rows[observation[start + e + step + 1]])
                reward = reward_value[reward_code[start + step]]
                learn_step(tables, member, values, row, np.int64(action[start + step]), reward, next_row, step == last)
                row = next_row
            tables.steps[member] += length
            tables.episode[member] += 1
        start += length
