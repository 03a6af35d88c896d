"""Which of what several runs remember their learners played themselves, and how a share of every minibatch is drawn of
that.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from apel.numerics.compiled import njit
from apel.numerics.streams import Stream, integer

_FORGOTTEN, _ADDED = range(2)


class Own(NamedTuple):
    """Of R runs that number what they remember in the order in which it comes, and keep it in N slots: number n lies in
    slot n mod N. N is 0 where nobody asks who played.
    """

    is_own: NDArray[np.bool_]
    """``[R, N]``, by slot."""
    numbers: NDArray[np.int64]
    """``[R, N]``: those of what is own, a ring."""
    counts: NDArray[np.int64]
    """``[R, 2]``: how many of them were forgotten, and how many there ever were."""
    part: int
    """How many of a minibatch are to be own, at least."""


@njit(inline="always")
def num_own(own: Own, run: int) -> int:
    """How much of what a run remembers is own."""
    return own.counts[run, _ADDED] - own.counts[run, _FORGOTTEN]


@njit
def keep(own: Own, run: int, number: int, oldest: int, is_own: bool) -> None:
    """Note who played what comes now, under the next ``number``, and forget what has one below ``oldest``."""
    slots = own.is_own.shape[1]
    if slots == 0:
        return
    # First, for of N own ones the newest takes the place of the oldest.
    while num_own(own, run) > 0 and own.numbers[run, own.counts[run, _FORGOTTEN] % slots] < oldest:
        own.counts[run, _FORGOTTEN] += 1
    own.is_own[run, number % slots] = is_own
    if is_own:
        own.numbers[run, own.counts[run, _ADDED] % slots] = number
        own.counts[run, _ADDED] += 1


@njit
def own_part(own: Own, run: int, size: int) -> int:
    """How many of a minibatch of so many are drawn from what is own: none as long as there is nothing."""
    return min(own.part, size) if num_own(own, run) > 0 else 0


@njit
def draw_own(own: Own, run: int, stream: Stream) -> int:
    """The number of something own, drawn uniformly."""
    place = own.counts[run, _FORGOTTEN] + integer(stream, num_own(own, run))
    return own.numbers[run, place % own.numbers.shape[1]]


def own_of(num_runs: int, slots: int, part: int) -> Own:
    """Of runs that remember nothing yet; both numbers are 0 where nobody asks who played."""
    return Own(
        np.zeros((num_runs, slots), dtype=np.bool_),
        np.zeros((num_runs, slots), dtype=np.int64),
        np.zeros((num_runs, 2), dtype=np.int64),
        part,
    )


def rebuild(own: Own, is_own: NDArray[np.bool_] | None, begin: NDArray[np.int64], end: NDArray[np.int64]) -> None:
    """Go back to what was so remembered.

    Parameters
    ----------
    own:
        Where to.
    is_own:
        ``[R, ≤ N]``, by slot; None where nobody asked: nothing counts as own.
    begin, end:
        ``int64[R]``: the numbers of the oldest that a run remembers, and of the next one to come.
    """
    slots = own.is_own.shape[1]
    own.is_own[:] = False
    own.counts[:] = 0
    if is_own is None or slots == 0:
        return
    own.is_own[:, : is_own.shape[1]] = is_own
    for run, numbers in enumerate(map(np.arange, begin, end)):
        kept = numbers[own.is_own[run, numbers % slots]]
        own.numbers[run, : len(kept)] = kept
        own.counts[run, _ADDED] = len(kept)
