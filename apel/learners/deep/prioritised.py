"""Priorities of the transitions in a replay memory (Schaul et al. 2016), in sum trees."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from pydantic.dataclasses import dataclass

from apel.batched import Runs
from apel.compiled import njit
from apel.learners.base import State
from apel.learners.deep.draws import Streams
from apel.learners.deep.options import NonNegative, Positive, Share
from apel.learners.q_learning import OPTIONS_CONFIG
from apel.streams import uniform


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


class Priorities:
    """The priorities of the transitions of R runs: two binary trees each, of sums and of minima.

    Leaf i stands at ``leaves + i``; node i has the children 2 i and 2 i + 1, the root is node 1.
    """

    def __init__(self, num_runs: int, capacity: int, options: PriorityOptions) -> None:
        self._options = options
        self._leaves = 1 << max(capacity - 1, 1).bit_length()
        self._sums = np.zeros((num_runs, 2 * self._leaves))
        self._minima = np.full((num_runs, 2 * self._leaves), np.inf)
        self._largest = np.ones(num_runs)

    def add(self, runs: Runs, slots: NDArray[np.int64]) -> None:
        """Give one new transition of each run the largest priority there has been, so that it is drawn soon."""
        self._set(runs, slots[:, None], self._largest[runs][:, None])

    def draw(
        self, runs: Runs, size: NDArray[np.int64], batch_size: int, correction: NDArray[np.float64], streams: Streams
    ) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
        """Slots ``int64[A, B]``, one from each of B equal shares of the mass, and importance weights ``float32[A, B]``.

        The weights are (N p)⁻ᵝ over the largest that any transition of the run has, with β = ``correction`` ``[A]``.
        """
        slots = np.empty((len(runs), batch_size), dtype=np.int64)
        weights = np.empty((len(runs), batch_size))
        _draw(self._sums, self._minima, self._leaves, runs, size, correction, streams, slots, weights)
        return slots, weights.astype(np.float32)

    def update(self, runs: Runs, slots: NDArray[np.int64], errors: NDArray[np.float32]) -> None:
        """New priorities |error| + ε, both arrays ``[A, B]``."""
        priorities = np.abs(errors).astype(np.float64) + self._options.epsilon
        self._set(runs, slots, priorities)
        self._largest[runs] = np.maximum(self._largest[runs], priorities.max(axis=1))

    def correction(self, progress: NDArray[np.float64]) -> NDArray[np.float64]:
        """β after the share ``progress`` ``[A]`` of the learner's steps."""
        start = self._options.correction
        return start + (1.0 - start) * np.minimum(progress, 1.0)

    def state(self) -> State:
        """The leaves, and the largest priorities."""
        return {"masses": self._sums[:, self._leaves :].copy(), "largest": self._largest.copy()}

    def restore(self, state: State) -> None:
        """Go back to what `state` returned."""
        self._largest = np.array(state["largest"])
        masses = state["masses"]
        self._sums[:, self._leaves :] = masses
        self._minima[:, self._leaves :] = np.where(masses > 0, masses, np.inf)
        _rebuild(self._sums, self._minima, self._leaves)

    def _set(self, runs: Runs, slots: NDArray[np.int64], priorities: NDArray[np.float64]) -> None:
        _set(self._sums, self._minima, self._leaves, runs, slots, priorities**self._options.exponent)


@njit
def _set(
    sums: NDArray[np.float64],
    minima: NDArray[np.float64],
    leaves: int,
    runs: Runs,
    slots: NDArray[np.int64],
    masses: NDArray[np.float64],
) -> None:
    for i in range(runs.shape[0]):
        total, least = sums[runs[i]], minima[runs[i]]
        for j in range(slots.shape[1]):
            node = leaves + slots[i, j]
            total[node] = least[node] = masses[i, j]
            node //= 2
            while node > 0:
                total[node] = total[2 * node] + total[2 * node + 1]
                least[node] = min(least[2 * node], least[2 * node + 1])
                node //= 2


@njit
def _rebuild(sums: NDArray[np.float64], minima: NDArray[np.float64], leaves: int) -> None:
    for run in range(sums.shape[0]):
        for node in range(leaves - 1, 0, -1):
            sums[run, node] = sums[run, 2 * node] + sums[run, 2 * node + 1]
            minima[run, node] = min(minima[run, 2 * node], minima[run, 2 * node + 1])


@njit
def _draw(
    sums: NDArray[np.float64],
    minima: NDArray[np.float64],
    leaves: int,
    runs: Runs,
    size: NDArray[np.int64],
    correction: NDArray[np.float64],
    streams: Streams,
    slots: NDArray[np.int64],
    weights: NDArray[np.float64],
) -> None:
    batch_size = slots.shape[1]
    for i in range(runs.shape[0]):
        total = sums[runs[i]]
        for j in range(batch_size):
            mass = (j + uniform(streams[runs[i]])) / batch_size * total[1]
            node = 1
            while node < leaves:
                node *= 2
                # The right half may be empty where rounding has left a little mass over.
                if mass >= total[node] and total[node + 1] > 0.0:
                    mass -= total[node]
                    node += 1
            slots[i, j] = min(node - leaves, size[runs[i]] - 1)
            weights[i, j] = (total[node] / minima[runs[i], 1]) ** -correction[i]
