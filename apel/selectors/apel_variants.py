"""APEL with increments other than 1: the three ideas of chapter 6 (Conclusions and Future Work).

All select as APEL does, and in all of them only a selected learner that is best is incremented. At strength 0 every
increment is 1, and they are APEL, draw for draw and bit for bit. What the text leaves open is chosen here:

    recency   min(1 + s (g − 1), b), g episodes since the learner was last selected
    margin    1 − s + s min(d/D, b), d = performance − best other estimate, D the running mean of |d|
    surprise  1 − s + s min(−log₂ q, b), q = P(X ≥ performance), X ~ N(μ, σ²) the learner's own past

so that in each an ordinary win counts 1: one right after the last selection, by the usual margin, or at the learner's
own median. Increments lie between 0 and max(1, b).
"""

from __future__ import annotations

import math
from typing import Annotated

import numpy as np
from pydantic import Field
from pydantic.dataclasses import dataclass

from apel.compiled import njit
from apel.selection import SELECTOR_CONFIG, Row, compiled_observe
from apel.selectors.apel import Apel, forget, is_best

Strength = Annotated[float, Field(ge=0.0, le=1.0)]
Bound = Annotated[float, Field(ge=1.0)]
Memory = Annotated[float, Field(gt=0.0, le=1.0)]

# Parameters: ν | whether ties count | s | b | ρ (not in recency).


@njit
def _increment(parameters: Row, num_learners: int, state: Row, selected: int, performance: float, size: float) -> None:
    """Algorithm 5's update with an increment of ``size``."""
    estimate = state[num_learners : 2 * num_learners]
    concentration = state[2 * num_learners : 3 * num_learners]
    estimate[selected] = performance
    if is_best(parameters, estimate, selected, performance):
        concentration[selected] += size
    forget(parameters, concentration)


@compiled_observe
def _observe_recency(parameters: Row, num_learners: int, state: Row, selected: int, performance: float) -> None:
    """State behind the common blocks: number of the episode, from 1 | that of each learner's last selection, or 0."""
    first = 3 * num_learners
    state[first] += 1.0
    last = state[first + 1 + selected]
    gap = state[first] - last if last > 0.0 else 1.0
    state[first + 1 + selected] = state[first]
    size = min(1.0 + parameters[2] * (gap - 1.0), parameters[3])
    _increment(parameters, num_learners, state, selected, performance, size)


@njit
def _or_infinite(estimate: float) -> float:
    """An estimate; ∞ for a learner not selected yet, from which no margin is finite."""
    return np.inf if math.isnan(estimate) else estimate


@compiled_observe
def _observe_margin(parameters: Row, num_learners: int, state: Row, selected: int, performance: float) -> None:
    """State behind the common blocks: the running mean of |d|, 0 as long as there is none."""
    strength, bound, memory = parameters[2], parameters[3], parameters[4]
    best_other = -np.inf
    for other in range(num_learners):
        if other != selected:
            best_other = max(best_other, _or_infinite(state[num_learners + other]))
    margin, scale, ratio = performance - best_other, state[3 * num_learners], 1.0
    if math.isfinite(margin):
        scale = (1.0 - memory) * scale + memory * abs(margin) if scale > 0.0 else abs(margin)
        state[3 * num_learners] = scale
        ratio = min(margin / scale, bound) if scale > 0.0 else 0.0
    _increment(parameters, num_learners, state, selected, performance, 1.0 - strength + strength * ratio)


@njit
def surprise(count: float, mean: float, variance: float, performance: float, bound: float) -> float:
    """−log₂ P(X ≥ ``performance``), X ~ N(``mean``, ``variance``), at most ``bound``; 1 before there are two."""
    if count < 2.0 or performance == mean:
        return 1.0
    # A model without variance finds anything above it impossible, and anything below it no surprise.
    z = (performance - mean) / math.sqrt(variance)
    tail = 0.5 * math.erfc(z / math.sqrt(2.0))
    return min(max(-math.log(tail) / math.log(2.0), 0.0), bound) if tail > 0.0 else bound


@compiled_observe
def _observe_surprise(parameters: Row, num_learners: int, state: Row, selected: int, performance: float) -> None:
    """State behind the common blocks: each learner's number of performances | their mean μ | variance σ².

    The k-th performance enters with weight max(1/k, ρ): Welford's recursion at first, exponential forgetting then.
    """
    strength, bound, memory = parameters[2], parameters[3], parameters[4]
    count = 3 * num_learners + selected
    mean, variance = count + num_learners, count + 2 * num_learners
    bits = surprise(state[count], state[mean], state[variance], performance, bound)
    _increment(parameters, num_learners, state, selected, performance, 1.0 - strength + strength * bits)
    state[count] += 1.0
    weight = max(1.0 / state[count], memory)
    if state[count] == 1.0:
        state[mean] = performance
    else:
        difference = performance - state[mean]
        state[mean] += weight * difference
        state[variance] = (1.0 - weight) * (state[variance] + weight * difference * difference)


@dataclass(frozen=True, config=SELECTOR_CONFIG)
class ApelRecency(Apel):
    """A win counts the more, the longer ago the learner was last selected: min(1 + s (g − 1), b).

    g = 1 for a learner selected twice in a row, and for one selected for the first time.

    Attributes
    ----------
    strength:
        s ≥ 0; at 0 it is APEL. A choice of ours, as all defaults here.
    bound:
        b ≥ 1, the largest increment.
    """

    strength: Annotated[float, Field(ge=0.0)] = 0.1
    bound: Bound = 10.0

    observe = staticmethod(_observe_recency)

    def parameters(self) -> Row:
        """``float64[4]``: ν, whether ties count, s, b."""
        return np.append(super().parameters(), [self.strength, self.bound])

    def initial_state(self, num_learners: int, num_episodes: int) -> Row:
        """``float64[4 · learners + 1]``."""
        return np.append(super().initial_state(num_learners, num_episodes), np.zeros(1 + num_learners))


@dataclass(frozen=True, config=SELECTOR_CONFIG)
class ApelMargin(Apel):
    """A win counts in proportion to its margin over the best other estimate: 1 − s + s min(d/D, b).

    D is the exponentially weighted mean of |d| over all episodes, the present one included; so selections do not change
    under a positive affine transformation of all performances.

    Attributes
    ----------
    strength:
        s in [0, 1]; at 0 it is APEL, at 1 the increment is proportional to the margin.
    bound:
        b ≥ 1, the largest ratio d/D that counts.
    memory:
        ρ, the weight of the present |d| in D.
    """

    strength: Strength = 1.0
    bound: Bound = 4.0
    memory: Memory = 0.05

    observe = staticmethod(_observe_margin)

    def parameters(self) -> Row:
        """``float64[5]``: ν, whether ties count, s, b, ρ."""
        return np.append(super().parameters(), [self.strength, self.bound, self.memory])

    def initial_state(self, num_learners: int, num_episodes: int) -> Row:
        """``float64[3 · learners + 1]``."""
        return np.append(super().initial_state(num_learners, num_episodes), 0.0)


@dataclass(frozen=True, config=SELECTOR_CONFIG)
class ApelSurprise(Apel):
    """A win counts its surprise in bits: 1 − s + s min(−log₂ P(X ≥ performance), b).

    X is normal with the running mean and variance of that learner's own past performances. Halving the probability of a
    performance adds 1 to the increment.

    Attributes
    ----------
    strength:
        s in [0, 1]; at 0 it is APEL.
    bound:
        b ≥ 1, the most bits that count.
    memory:
        ρ, the least weight of the present performance in the running mean and variance.
    """

    strength: Strength = 1.0
    bound: Bound = 8.0
    memory: Memory = 0.05

    observe = staticmethod(_observe_surprise)

    def parameters(self) -> Row:
        """``float64[5]``: ν, whether ties count, s, b, ρ."""
        return np.append(super().parameters(), [self.strength, self.bound, self.memory])

    def initial_state(self, num_learners: int, num_episodes: int) -> Row:
        """``float64[6 · learners]``."""
        return np.append(super().initial_state(num_learners, num_episodes), np.zeros(3 * num_learners))
