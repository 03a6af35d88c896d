"""A sliding window over the last episodes: counts and sums per learner, and the least and largest performance.

Everything is carried along, so that an episode costs amortised O(1) whatever the window's length. The extremes are kept
by two monotone queues (each episode enters and leaves each of them once at most). Sums are exact for whole numbers
below 2⁵³; otherwise they carry the rounding of what has passed through, until their learner leaves the window.

A window is one block of a state:

    capacity | begin | end | tracks extremes | head, tail of minima | head, tail of maxima | counts[n] | sums[n]
    | (learner, performance)[capacity] | minima[capacity] | maxima[capacity]

``begin`` and ``end`` are numbers of episodes, and episode e stands at place e mod capacity. The last two blocks are
there only where extremes are tracked.
"""

from __future__ import annotations

import numpy as np

from apel.compiled import njit
from apel.selection import Row

_CAPACITY, _BEGIN, _END, _TRACKS, _MINIMA, _MAXIMA = 0, 1, 2, 3, 4, 6
_HEAD = 8


def new_window(num_learners: int, capacity: int, *, tracks_extremes: bool) -> Row:
    """An empty window that can hold ``capacity`` episodes, one more than are kept after `drop_before`."""
    block = np.zeros(_HEAD + 2 * num_learners + (4 if tracks_extremes else 2) * capacity)
    block[_CAPACITY], block[_TRACKS] = capacity, tracks_extremes
    return block


@njit
def past_episodes(block: Row) -> int:
    """Number of all episodes so far."""
    return int(block[_END])


@njit
def episodes_inside(block: Row) -> int:
    """Number of episodes in the window."""
    return int(block[_END]) - int(block[_BEGIN])


@njit
def counts(block: Row, num_learners: int) -> Row:
    """Episodes in the window by learner, ``float64[learners]``."""
    return block[_HEAD : _HEAD + num_learners]


@njit
def sums(block: Row, num_learners: int) -> Row:
    """Sum of the performances in the window by learner, ``float64[learners]``."""
    return block[_HEAD + num_learners : _HEAD + 2 * num_learners]


@njit
def extremes(block: Row, num_learners: int) -> tuple[float, float]:
    """The least and the largest performance in the window, where they are tracked; else, or if it is empty, 0 and 1."""
    capacity = int(block[_CAPACITY])
    if block[_TRACKS] == 0.0 or episodes_inside(block) == 0:
        return 0.0, 1.0
    ring = block[_HEAD + 2 * num_learners :]
    least = int(ring[2 * capacity + int(block[_MINIMA]) % capacity])
    largest = int(ring[3 * capacity + int(block[_MAXIMA]) % capacity])
    return ring[2 * (least % capacity) + 1], ring[2 * (largest % capacity) + 1]


@njit
def _append_extreme(block: Row, queue: int, sign: float, ring: Row, places: Row, episode: int) -> None:
    """Append an episode to a queue whose performances, times ``sign``, fall from head to tail."""
    capacity = places.shape[0]
    head, tail = int(block[queue]), int(block[queue + 1])
    value = sign * ring[2 * (episode % capacity) + 1]
    while tail > head and sign * ring[2 * (int(places[(tail - 1) % capacity]) % capacity) + 1] <= value:
        tail -= 1
    places[tail % capacity] = episode
    block[queue + 1] = tail + 1


@njit
def append(block: Row, num_learners: int, learner: int, performance: float) -> None:
    """Take in one episode."""
    capacity, episode = int(block[_CAPACITY]), int(block[_END])
    ring = block[_HEAD + 2 * num_learners :]
    ring[2 * (episode % capacity)] = learner
    ring[2 * (episode % capacity) + 1] = performance
    block[_HEAD + learner] += 1.0
    block[_HEAD + num_learners + learner] += performance
    block[_END] = episode + 1
    if block[_TRACKS] != 0.0:
        _append_extreme(block, _MINIMA, -1.0, ring, ring[2 * capacity : 3 * capacity], episode)
        _append_extreme(block, _MAXIMA, 1.0, ring, ring[3 * capacity : 4 * capacity], episode)


@njit
def drop_before(block: Row, num_learners: int, begin: int) -> None:
    """Forget the episodes before ``begin``."""
    capacity = int(block[_CAPACITY])
    ring = block[_HEAD + 2 * num_learners :]
    for episode in range(int(block[_BEGIN]), begin):
        learner = int(ring[2 * (episode % capacity)])
        block[_HEAD + learner] -= 1.0
        block[_HEAD + num_learners + learner] -= ring[2 * (episode % capacity) + 1]
        if block[_HEAD + learner] == 0.0:
            block[_HEAD + num_learners + learner] = 0.0
        if block[_TRACKS] != 0.0:
            if int(ring[2 * capacity + int(block[_MINIMA]) % capacity]) == episode:
                block[_MINIMA] += 1.0
            if int(ring[3 * capacity + int(block[_MAXIMA]) % capacity]) == episode:
                block[_MAXIMA] += 1.0
    block[_BEGIN] = begin
