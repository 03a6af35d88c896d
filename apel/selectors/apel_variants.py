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
from typing import Annotated, Any, ClassVar, NamedTuple

import numpy as np
from pydantic import Field
from pydantic.dataclasses import dataclass

from apel.numerics.compiled import njit
from apel.numerics.views import Layout, Row, named_numbers
from apel.run.selection import SELECTOR_CONFIG, compiled_observe
from apel.selectors.apel import Apel, update

Strength = Annotated[float, Field(ge=0.0, le=1.0)]
Bound = Annotated[float, Field(ge=1.0)]
Memory = Annotated[float, Field(gt=0.0, le=1.0)]


class RecencyOptions(NamedTuple):
    """APEL's, then those of increments by recency."""

    decay: float
    counts_ties: float
    strength: float
    bound: float


class VariantOptions(NamedTuple):
    """APEL's, then those of increments by margin or surprise."""

    decay: float
    counts_ties: float
    strength: float
    bound: float
    memory: float


class RecencyState(NamedTuple):
    """APEL's, then when each learner was last selected."""

    probability: Row
    performance_estimate: Row
    concentration: Row
    episode: Row
    """``float64[1]``: number of the episode, from 1."""
    last_selection: Row
    """``float64[learners]``: number of the episode, 0 before any."""


class MarginState(NamedTuple):
    """APEL's, then the usual margin."""

    probability: Row
    performance_estimate: Row
    concentration: Row
    scale: Row
    """``float64[1]``: D, the running mean of |d|, 0 as long as there is none."""


class SurpriseState(NamedTuple):
    """APEL's, then each learner's own past, ``float64[learners]`` each."""

    probability: Row
    performance_estimate: Row
    concentration: Row
    num_selections: Row
    mean: Row
    variance: Row


_RECENCY, _MARGIN, _SURPRISE = Layout(RecencyState, episode=1), Layout(MarginState, scale=1), Layout(SurpriseState)
_recency_state, _margin_state, _surprise_state = _RECENCY.view, _MARGIN.view, _SURPRISE.view
_recency_options, _options = named_numbers(RecencyOptions), named_numbers(VariantOptions)


@compiled_observe
def _observe_recency(parameters: Row, num_learners: int, row: Row, selected: int, performance: float) -> None:
    """Increment min(1 + s (g − 1), b)."""
    options, state = _recency_options(parameters), _recency_state(row, num_learners)
    state.episode[0] += 1.0
    last = state.last_selection[selected]
    gap = state.episode[0] - last if last > 0.0 else 1.0
    state.last_selection[selected] = state.episode[0]
    increment = min(1.0 + options.strength * (gap - 1.0), options.bound)
    update(parameters, num_learners, row, selected, performance, increment)


@njit
def _or_infinite(estimate: float) -> float:
    """An estimate; ∞ for a learner not selected yet, from which no margin is finite."""
    return np.inf if math.isnan(estimate) else estimate


@compiled_observe
def _observe_margin(parameters: Row, num_learners: int, row: Row, selected: int, performance: float) -> None:
    """Increment 1 − s + s min(d/D, b)."""
    options, state = _options(parameters), _margin_state(row, num_learners)
    best_other = -np.inf
    for other in range(num_learners):
        if other != selected:
            best_other = max(best_other, _or_infinite(state.performance_estimate[other]))
    margin, scale, ratio = performance - best_other, state.scale[0], 1.0
    if math.isfinite(margin):
        scale = (1.0 - options.memory) * scale + options.memory * abs(margin) if scale > 0.0 else abs(margin)
        state.scale[0] = scale
        ratio = min(margin / scale, options.bound) if scale > 0.0 else 0.0
    increment = 1.0 - options.strength + options.strength * ratio
    update(parameters, num_learners, row, selected, performance, increment)


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
def _observe_surprise(parameters: Row, num_learners: int, row: Row, selected: int, performance: float) -> None:
    """Increment 1 − s + s min(−log₂ q, b).

    The k-th performance enters μ and σ² with weight max(1/k, ρ): Welford's recursion at first, then exponential
    forgetting.
    """
    options, state = _options(parameters), _surprise_state(row, num_learners)
    count, mean, variance = state.num_selections, state.mean, state.variance
    bits = surprise(count[selected], mean[selected], variance[selected], performance, options.bound)
    increment = 1.0 - options.strength + options.strength * bits
    update(parameters, num_learners, row, selected, performance, increment)
    count[selected] += 1.0
    weight = max(1.0 / count[selected], options.memory)
    if count[selected] == 1.0:
        mean[selected] = performance
    else:
        difference = performance - mean[selected]
        mean[selected] += weight * difference
        variance[selected] = (1.0 - weight) * (variance[selected] + weight * difference * difference)


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

    layout: ClassVar[Layout[Any]] = _RECENCY

    observe = staticmethod(_observe_recency)

    def parameters(self) -> Row:
        """``float64[4]``: ν, whether ties count, s, b."""
        return np.array(RecencyOptions(self.decay, self.tie_increment, self.strength, self.bound))


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

    layout: ClassVar[Layout[Any]] = _MARGIN

    observe = staticmethod(_observe_margin)

    def parameters(self) -> Row:
        """``float64[5]``: ν, whether ties count, s, b, ρ."""
        return np.array(VariantOptions(self.decay, self.tie_increment, self.strength, self.bound, self.memory))


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

    layout: ClassVar[Layout[Any]] = _SURPRISE

    observe = staticmethod(_observe_surprise)

    def parameters(self) -> Row:
        """``float64[5]``: ν, whether ties count, s, b, ρ."""
        return np.array(VariantOptions(self.decay, self.tie_increment, self.strength, self.bound, self.memory))
