"""SSBAS: sliding stochastic bandit algorithm selection (Laroche & Féraud 2018, arXiv 1701.08810; §5.1).

At meta-time τ (the number of past selections) UCB1 is played over the last ⌊τ/2⌋ selections. The window's counts and
sums are carried along, so that an episode costs O(1) whatever the window's length.
"""

from __future__ import annotations

import math
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from pydantic.dataclasses import dataclass

from apel.selection import SELECTOR_CONFIG, Row, compiled_observe, compiled_select, header
from apel.streams import integer

# The state behind the common blocks: τ | counts[n] | sums[n] | (learner, performance) of the window, as a ring.


@compiled_select
def _select(parameters: Row, num_learners: int, state: Row, stream: NDArray[np.uint64]) -> int:
    """A learner missing from the window first, else argmax x̄ₖ + √(ξ ln n / nₖ); ties uniformly at random."""
    exploration = parameters[0]
    first = 3 * num_learners + 1
    in_window = int(state[first - 1]) // 2
    logarithm = math.log(in_window) if in_window > 0 else 0.0
    probability = state[:num_learners]
    best, num_best = -np.inf, 0
    for k in range(num_learners):
        count = state[first + k]
        index = np.inf
        if count > 0.0:
            index = state[first + num_learners + k] / count + math.sqrt(exploration * logarithm / count)
        probability[k] = index
        if index > best:
            best, num_best = index, 1
        elif index == best:
            num_best += 1
    pick = integer(stream, num_best)
    selected = 0
    for k in range(num_learners):
        if probability[k] == best:
            if pick == 0:
                selected = k
            pick -= 1
            probability[k] = 1.0 / num_best
        else:
            probability[k] = 0.0
    return selected


@compiled_observe
def _observe(parameters: Row, num_learners: int, state: Row, selected: int, performance: float) -> None:
    """Append (learner, performance), advance τ, and drop what has left the window of the last ⌊τ/2⌋."""
    first = 3 * num_learners + 1
    ring = state[first + 2 * num_learners :]
    capacity = ring.shape[0] // 2
    state[num_learners + selected] = performance
    past = int(state[first - 1])
    ring[2 * (past % capacity)] = selected
    ring[2 * (past % capacity) + 1] = performance
    state[first + selected] += 1.0
    state[first + num_learners + selected] += performance
    start_before, start_after = past - past // 2, past + 1 - (past + 1) // 2
    state[first - 1] = past + 1
    for dropped in range(start_before, start_after):
        learner = int(ring[2 * (dropped % capacity)])
        state[first + learner] -= 1.0
        state[first + num_learners + learner] -= ring[2 * (dropped % capacity) + 1]
        if state[first + learner] == 0.0:
            state[first + num_learners + learner] = 0.0


@dataclass(frozen=True, config=SELECTOR_CONFIG)
class Ssbas:
    """UCB1 over the last half of all selections; performances are used as they are, not normalised.

    Attributes
    ----------
    exploration:
        ξ > 0, the weight of the confidence bonus.
    """

    exploration: Annotated[float, Field(gt=0.0)] = 4.921

    select = staticmethod(_select)
    observe = staticmethod(_observe)

    def parameters(self) -> Row:
        """``float64[1]``: ξ."""
        return np.array([self.exploration])

    def initial_state(self, num_learners: int, num_episodes: int) -> Row:
        """``float64[5 · learners + 1 + 2 · (⌊episodes/2⌋ + 2)]``; the window is what needs memory."""
        capacity = num_episodes // 2 + 2
        return np.concatenate([header(num_learners), np.zeros(1 + 2 * num_learners + 2 * capacity)])
