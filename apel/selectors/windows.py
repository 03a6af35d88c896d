"""A sliding window over the last episodes: counts and sums per learner, and the least and largest performance.

Everything is carried along, so that an episode costs amortised O(1) whatever the window's length. The extremes are kept
by two monotone queues (each episode enters and leaves each of them once at most). Sums are exact for whole numbers
below 2⁵³; otherwise they carry the rounding of what has passed through, until their learner leaves the window.

A window is the last block of a state. ``begin`` and ``end`` are numbers of episodes, and episode e stands at place
e mod capacity.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from apel.numerics.compiled import njit
from apel.numerics.views import REST, Layout, Row


class Window(NamedTuple):
    """What stands in a window's block; ``float64[1]`` where nothing is said."""

    capacity: Row
    begin: Row
    end: Row
    tracks_extremes: Row
    """0 or 1."""
    minima: Row
    """``float64[2]``: head and tail of the queue."""
    maxima: Row
    """``float64[2]``: likewise."""
    num_selections: Row
    """``float64[learners]``: episodes in the window."""
    performance_sum: Row
    """``float64[learners]``: sum of the performances in the window."""
    rings: Row
    """All that goes round: (learner, performance)[capacity], and where extremes are tracked the queues' episodes,
    minima[capacity] | maxima[capacity].
    """


WINDOW = Layout(Window, capacity=1, begin=1, end=1, tracks_extremes=1, minima=2, maxima=2, rings=REST)
view_window = WINDOW.view


def new_window(num_learners: int, capacity: int, *, tracks_extremes: bool) -> Row:
    """The block of an empty window for ``capacity`` episodes, one more than are kept after `drop_before`."""
    rings = np.zeros((4 if tracks_extremes else 2) * capacity)
    return WINDOW.row(num_learners, capacity=capacity, tracks_extremes=tracks_extremes, rings=rings)


@njit
def past_episodes(window: Window) -> int:
    """Number of all episodes so far."""
    return int(window.end[0])


@njit
def episodes_inside(window: Window) -> int:
    """Number of episodes in the window."""
    return int(window.end[0]) - int(window.begin[0])


@njit
def _learner(window: Window, episode: int) -> int:
    return int(window.rings[2 * (episode % int(window.capacity[0]))])


@njit
def _performance(window: Window, episode: int) -> float:
    return window.rings[2 * (episode % int(window.capacity[0])) + 1]


@njit
def _place(window: Window, queue: int, number: int) -> int:
    """Where the ``number``-th episode that entered a queue stands: of minima (``queue`` 0) or of maxima (1)."""
    capacity = int(window.capacity[0])
    return (2 + queue) * capacity + number % capacity


@njit
def _head(window: Window, queue: int) -> int:
    """The episode at the head of a queue."""
    bounds = window.minima if queue == 0 else window.maxima
    return int(window.rings[_place(window, queue, int(bounds[0]))])


@njit
def extremes(window: Window) -> tuple[float, float]:
    """The least and the largest performance in the window, where they are tracked; else, or if it is empty, 0 and 1."""
    if window.tracks_extremes[0] == 0.0 or episodes_inside(window) == 0:
        return 0.0, 1.0
    return _performance(window, _head(window, 0)), _performance(window, _head(window, 1))


@njit
def _append_extreme(window: Window, queue: int, sign: float, episode: int) -> None:
    """Append an episode to a queue whose performances, times ``sign``, fall from head to tail."""
    bounds = window.minima if queue == 0 else window.maxima
    head, tail = int(bounds[0]), int(bounds[1])
    value = sign * _performance(window, episode)
    while tail > head and sign * _performance(window, int(window.rings[_place(window, queue, tail - 1)])) <= value:
        tail -= 1
    window.rings[_place(window, queue, tail)] = episode
    bounds[1] = tail + 1


@njit
def append(window: Window, learner: int, performance: float) -> None:
    """Take in one episode."""
    episode = past_episodes(window)
    place = 2 * (episode % int(window.capacity[0]))
    window.rings[place] = learner
    window.rings[place + 1] = performance
    window.num_selections[learner] += 1.0
    window.performance_sum[learner] += performance
    window.end[0] = episode + 1
    if window.tracks_extremes[0] != 0.0:
        _append_extreme(window, 0, -1.0, episode)
        _append_extreme(window, 1, 1.0, episode)


@njit
def drop_before(window: Window, begin: int) -> None:
    """Forget the episodes before ``begin``."""
    for episode in range(int(window.begin[0]), begin):
        learner = _learner(window, episode)
        window.num_selections[learner] -= 1.0
        window.performance_sum[learner] -= _performance(window, episode)
        if window.num_selections[learner] == 0.0:
            window.performance_sum[learner] = 0.0
        if window.tracks_extremes[0] != 0.0:
            if _head(window, 0) == episode:
                window.minima[0] += 1.0
            if _head(window, 1) == episode:
                window.maxima[0] += 1.0
    window.begin[0] = begin
