"""Compiled loops of tabular Q-learning (Algorithm 2): Q-tables of many runs, whole streaks on finite environments.

An environment step with its update costs tens of nanoseconds here. The readable statement of the same algorithm is
`apel.learners.q_learning.QLearning`; both draw the same numbers in the same order.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from apel.book import RUNNING, Book, advance
from apel.compiled import njit
from apel.finite import FiniteTables, draw_distractor, draw_outcome, draw_start
from apel.selection import Observe, Select
from apel.streams import Stream, episode_seed, integer, start_stream, uniform
from apel.trajectory import Episodes


class QTables(NamedTuple):
    """The learners of R runs, as arrays."""

    value: NDArray[np.float64]
    """``float64[R, rows, actions]``."""
    row: NDArray[np.int32]
    """``int32[row sets, states]``: the row of each state, once for each representation among the runs."""
    row_set: NDArray[np.int64]
    """``int64[R]``: which of the row sets is the run's."""
    stream: NDArray[np.uint64]
    """``uint64[R, 2]``."""
    steps: NDArray[np.int64]
    """``int64[R]``: observed environment steps."""
    learning_rate: NDArray[np.float64]
    discount: NDArray[np.float64]
    exploration: NDArray[np.float64]
    """``float64[R, 2]``: ε before and after the switch, or at the start and the end of the decay."""
    switch_episode: NDArray[np.int64]
    decay_steps: NDArray[np.float64]
    """``float64[R]``: 0 for an ε that does not decay."""


class Recording(NamedTuple):
    """Where trajectories are written: N steps of room."""

    observation: NDArray[Any]
    action: NDArray[Any]
    reward_code: NDArray[Any]
    probability: NDArray[np.float64]
    """``float64[N, actions]``, or ``float64[0, actions]`` where nobody asked for it."""


@njit(inline="always")
def _exploration_rate(tables: QTables, run: int, episode: int) -> float:
    if tables.decay_steps[run] > 0.0:
        start, end = tables.exploration[run, 0], tables.exploration[run, 1]
        return end + (start - end) * math.exp(-tables.steps[run] / tables.decay_steps[run])
    return tables.exploration[run, 0] if episode < tables.switch_episode[run] else tables.exploration[run, 1]


@njit(inline="always")
def _maximum(values: NDArray[np.float64], row: int) -> float:
    best = values[row, 0]
    for action in range(1, values.shape[1]):
        best = values[row, action] if values[row, action] > best else best
    return best


@njit(inline="always")
def _greedy(values: NDArray[np.float64], row: int) -> tuple[float, int, int]:
    """The best value, the first action that has it, and how many have it."""
    # Without branches, which would be mispredicted.
    best = _maximum(values, row)
    first, ties = 0, 0
    for action in range(values.shape[1] - 1, -1, -1):
        equal = values[row, action] == best
        ties += equal
        first = action if equal else first
    return best, first, ties


@njit(inline="always")
def _break_tie(values: NDArray[np.float64], row: int, best: float, position: int) -> int:
    """The action at ``position`` among those of the best value."""
    for action in range(values.shape[1]):
        if values[row, action] == best:
            if position == 0:
                return action
            position -= 1
    return 0


@njit
def _write_probability(
    probability: NDArray[np.float64], values: NDArray[np.float64], row: int, best: float, ties: int, exploration: float
) -> None:
    """μ(·|s) of the ε-greedy policy, with the values before this step's update."""
    num_actions = values.shape[1]
    for action in range(num_actions):
        greedy = (1.0 - exploration) / ties if values[row, action] == best else 0.0
        probability[action] = exploration / num_actions + greedy


@njit(inline="always")
def _update(
    values: NDArray[np.float64], row: int, action: int, reward: float, following: float, rate: float, discount: float
) -> None:
    """Eq. 2.8."""
    target = reward + discount * following
    values[row, action] += rate * (target - values[row, action])


@njit
def play_episode(
    world: FiniteTables,
    tables: QTables,
    run: int,
    episode: int,
    environment_stream: Stream,
    recording: Recording,
    start: int,
    position: int,
    record: bool,
) -> tuple[int, float, bool]:
    """One episode, learning while acting: its length, its return, and whether it terminated.

    Step t is recorded at ``start + t``, observations one place later per recorded episode (``position`` of them
    before).
    """
    model = world.model[run]
    next_cell, code_of, terminal_of = world.next_cell[model], world.reward_code[model], world.terminal[model]
    rows, values, stream = tables.row[tables.row_set[run]], tables.value[run], tables.stream[run]
    rate, discount = tables.learning_rate[run], tables.discount[run]
    decays = tables.decay_steps[run] > 0.0
    exploration = _exploration_rate(tables, run, episode)
    cell, distractor = draw_start(world, model, environment_stream)
    state = cell * world.num_distractor_values + distractor
    row = np.int64(rows[state])
    best, greedy, ties = _greedy(values, row)
    total = 0.0
    for step in range(world.max_steps):
        if uniform(stream) < exploration:
            action = integer(stream, values.shape[1])
        else:
            action = greedy if ties == 1 else _break_tie(values, row, best, integer(stream, ties))
        outcome = draw_outcome(world, model, cell, action, environment_stream)
        reward_code = code_of[cell, action, outcome]
        reward = world.reward_value[reward_code]
        terminal = terminal_of[cell, action, outcome]
        if record:
            recording.observation[start + position + step] = state
            recording.action[start + step] = action
            recording.reward_code[start + step] = reward_code
            if recording.probability.shape[0] > 0:
                _write_probability(recording.probability[start + step], values, row, best, ties, exploration)
        cell = np.int64(next_cell[cell, action, outcome])
        state = cell * world.num_distractor_values + draw_distractor(world, environment_stream)
        next_row = np.int64(rows[state])
        best, greedy, ties = _greedy(values, next_row)
        _update(values, row, action, reward, 0.0 if terminal else best, rate, discount)
        if next_row == row:
            best, greedy, ties = _greedy(values, row)
        row = next_row
        total += reward
        tables.steps[run] += 1
        if decays:
            exploration = _exploration_rate(tables, run, episode)
        if terminal:
            break
    if record:
        recording.observation[start + position + step + 1] = state
    return step + 1, total, terminal


@njit
def play_compiled_streaks(
    runs: NDArray[np.int64],
    world: FiniteTables,
    environment_key: NDArray[np.uint64],
    tables: QTables,
    book: Book,
    select: Select,
    observe: Observe,
    me: int,
    by_length: bool,
    max_episodes: int,
    max_steps: int,
    record: bool,
    recording: Recording,
    episodes: Episodes,
) -> int:
    """Play each run's streak, of at most ``max_episodes`` or until ``max_steps``; returns the number of episodes."""
    stream = np.empty(2, dtype=np.uint64)
    count, start = 0, 0
    for run in runs:
        streak_episodes, streak_steps = 0, 0
        while True:
            episode = book.episode[run]
            start_stream(episode_seed(environment_key[run], episode), stream)
            length, episode_return, terminated = play_episode(
                world, tables, run, episode, stream, recording, start, count, record
            )
            performance = -float(length) if by_length else episode_return
            episodes.run[count] = run
            episodes.episode[count] = episode
            episodes.length[count] = length
            episodes.episode_return[count] = episode_return
            episodes.performance[count] = performance
            episodes.terminated[count] = terminated
            count += 1
            start += length
            streak_episodes += 1
            streak_steps += length
            advance(book, select, observe, run, length, episode_return, performance)
            if book.status[run] != RUNNING or book.learner[run] != me:
                break
            if streak_episodes >= max_episodes or streak_steps >= max_steps:
                break
    return count


@njit
def learn_episodes(
    episodes: Episodes,
    observation: NDArray[Any],
    action: NDArray[Any],
    reward_code: NDArray[Any],
    reward_value: NDArray[np.float64],
    tables: QTables,
) -> None:
    """Eq. 2.8 for every step of a batch, in order."""
    start = 0
    for e in range(episodes.run.shape[0]):
        run, length = episodes.run[e], episodes.length[e]
        rows = tables.row[tables.row_set[run]]
        values = tables.value[run]
        rate, discount = tables.learning_rate[run], tables.discount[run]
        last = length - 1
        for step in range(length):
            row = rows[observation[start + e + step]]
            following = 0.0
            if step < last or not episodes.terminated[e]:
                following = _maximum(values, rows[observation[start + e + step + 1]])
            reward = reward_value[reward_code[start + step]]
            _update(values, row, np.int64(action[start + step]), reward, following, rate, discount)
        tables.steps[run] += length
        start += length
