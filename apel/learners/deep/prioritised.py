"""Priorities of the transitions in a replay memory (Schaul et al. 2016), in sum trees."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic.dataclasses import dataclass

from apel.learners.base import State
from apel.learners.deep.arithmetic import real_power
from apel.learners.deep.options import NonNegative, Positive, Share
from apel.learners.tabular.q_learning import OPTIONS_CONFIG
from apel.numerics.compiled import njit
from apel.numerics.streams import Stream, uniform


@dataclass(frozen=True, config=OPTIONS_CONFIG)
class PriorityOptions:
    """Proportional prioritisation; the defaults are those of OpenAI Baselines.

    Attributes
    ----------
    exponent:
        α: a transition is drawn with a probability proportional to priorityᵅ; 0 is uniform.
    correction:
        β at the first step; it rises linearly to 1 over the learner's ``total_steps``.
    epsilon:
        Added to each absolute TD error.
    """

    exponent: NonNegative = 0.6
    correction: Share = 0.4
    epsilon: Positive = 1e-6


class Trees(NamedTuple):
    """The priorities of the transitions of R runs: two binary trees each, of sums and of minima; none where R is 0.

    Leaf i stands at ``leaves + i``; node i has the children 2 i and 2 i + 1, the root is node 1.
    """

    sums: NDArray[np.float64]
    """``[R, 2 · leaves]``."""
    minima: NDArray[np.float64]
    largest: NDArray[np.float64]
    """``[R]``: the largest priority that there has been."""
    own: NDArray[np.float64]
    """``[R, 2 · leaves]``: the sums of what is own, with leaves of 0 elsewhere; no rows where nobody asks."""
    exponent: float
    correction: float
    epsilon: float


@njit
def welcome(trees: Trees, run: int, slot: int, is_own: bool) -> None:
    """Give a new transition the largest priority there has been, so that it is drawn soon."""
    _set(trees, run, slot, trees.largest[run], is_own)


@njit
def draw_by_priority(
    trees: Trees,
    run: int,
    size: int,
    progress: float,
    part: int,
    stream: Stream,
    slots: NDArray[np.int64],
    weights: NDArray[np.float32],
) -> None:
    """Write ``slots`` ``[B]``, and importance ``weights`` ``[B]``: the first ``part`` from what is own, one from each
    of so many equal shares of its mass, the others from all in the same way.

    The weights are (N p)⁻ᵝ over the largest that any transition of the run has, with β after the share ``progress`` of
    the learner's steps and p as if all were drawn from all: they correct what priorities change among those of a part,
    and leave the share as it is asked for.
    """
    least = trees.minima[run, 1]
    correction = trees.correction + (1.0 - trees.correction) * min(progress, 1.0)
    part = part if part > 0 and trees.own[run, 1] > 0.0 else 0
    if part > 0:
        _draw_from(trees.own[run], least, correction, size, stream, slots[:part], weights[:part])
    _draw_from(trees.sums[run], least, correction, size, stream, slots[part:], weights[part:])


@njit
def _draw_from(
    total: NDArray[np.float64],
    least: float,
    correction: float,
    size: int,
    stream: Stream,
    slots: NDArray[np.int64],
    weights: NDArray[np.float32],
) -> None:
    batch_size, leaves = slots.shape[0], total.shape[0] // 2
    for j in range(batch_size):
        mass = (j + uniform(stream)) / batch_size * total[1]
        node = 1
        while node < leaves:
            node *= 2
            # The right half may be empty where rounding has left a little mass over.
            if mass >= total[node] and total[node + 1] > 0.0:
                mass -= total[node]
                node += 1
        slots[j] = min(node - leaves, size - 1)
        weights[j] = real_power(least / total[node], correction)


@njit
def reconsider(trees: Trees, run: int, slots: NDArray[np.int64], errors: NDArray[np.float32]) -> None:
    """New priorities |error| + ε, both arrays ``[B]``."""
    for j in range(slots.shape[0]):
        priority = abs(np.float64(errors[j])) + trees.epsilon
        is_own = trees.own.shape[0] > 0 and trees.own[run, trees.own.shape[1] // 2 + slots[j]] > 0.0
        _set(trees, run, slots[j], priority, is_own)
        trees.largest[run] = max(trees.largest[run], priority)


@njit
def _set(trees: Trees, run: int, slot: int, priority: float, is_own: bool) -> None:
    total, least = trees.sums[run], trees.minima[run]
    node = total.shape[0] // 2 + slot
    total[node] = least[node] = real_power(priority, trees.exponent)
    if trees.own.shape[0] > 0:
        _set_sum(trees.own[run], node, total[node] if is_own else 0.0)
    node //= 2
    while node > 0:
        total[node] = total[2 * node] + total[2 * node + 1]
        least[node] = min(least[2 * node], least[2 * node + 1])
        node //= 2


@njit
def _set_sum(total: NDArray[np.float64], node: int, mass: float) -> None:
    total[node] = mass
    node //= 2
    while node > 0:
        total[node] = total[2 * node] + total[2 * node + 1]
        node //= 2


@njit
def _rebuild(sums: NDArray[np.float64], minima: NDArray[np.float64]) -> None:
    for run in range(sums.shape[0]):
        for node in range(sums.shape[1] // 2 - 1, 0, -1):
            sums[run, node] = sums[run, 2 * node] + sums[run, 2 * node + 1]
            minima[run, node] = min(minima[run, 2 * node], minima[run, 2 * node + 1])


@njit
def _rebuild_sums(sums: NDArray[np.float64]) -> None:
    for run in range(sums.shape[0]):
        for node in range(sums.shape[1] // 2 - 1, 0, -1):
            sums[run, node] = sums[run, 2 * node] + sums[run, 2 * node + 1]


class Priorities:
    """The trees of R runs, or of none where there are no ``options``."""

    def __init__(self, num_runs: int, capacity: int, options: PriorityOptions | None) -> None:
        leaves = 1 << max(capacity - 1, 1).bit_length() if options else 1
        count = num_runs if options else 0
        known = options or PriorityOptions()
        self.arrays = Trees(
            np.zeros((count, 2 * leaves)),
            np.full((count, 2 * leaves), np.inf),
            np.ones(count),
            np.zeros((0, 2 * leaves)),
            known.exponent,
            known.correction,
            known.epsilon,
        )

    def keep_own(self) -> None:
        """From now on draw a part of each minibatch from what is own; `arrays` are replaced."""
        self.arrays = self.arrays._replace(own=np.zeros_like(self.arrays.sums))

    def state(self) -> State | None:
        """The leaves, and the largest priorities."""
        sums, _, largest = self.arrays[:3]
        return {"masses": sums[:, sums.shape[1] // 2 :].copy(), "largest": largest.copy()} if len(sums) else None

    def restore(self, state: State | None, is_own: NDArray[np.bool_]) -> None:
        """Go back to what `state` returned, where ``is_own`` ``[R, N]`` says which transitions are own."""
        if state is None:
            return
        sums, minima, largest = self.arrays[:3]
        masses = np.array(state["masses"])
        largest[:] = state["largest"]
        sums[:, sums.shape[1] // 2 :] = masses
        minima[:, sums.shape[1] // 2 :] = np.where(masses > 0, masses, np.inf)
        _rebuild(sums, minima)
        if len(own := self.arrays.own):
            own[:] = 0.0
            own[:, sums.shape[1] // 2 :][:, : is_own.shape[1]] = np.where(is_own, masses[:, : is_own.shape[1]], 0.0)
            _rebuild_sums(own)
