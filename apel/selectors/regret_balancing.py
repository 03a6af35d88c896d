"""D³RB and ED²RB: data-driven regret balancing (Pacchiano, Dann & Gentile 2023, arXiv 2306.02869, Algorithms 1 and 2).

Every learner i has a regret coefficient dᵢ (its regret is taken to be dᵢ √nᵢ) and a balancing potential φᵢ; the learner
of the smallest potential acts. With its count n and mean reward û, and the bonus b(n) = c √(ln(M ln n / δ) / n):

    D³RB:   if ûᵢ + dᵢ/√nᵢ + b(nᵢ) < maxⱼ (ûⱼ − b(nⱼ)): dᵢ ← 2 dᵢ;   φᵢ ← dᵢ √nᵢ
    ED²RB:  dᵢ ← max(d_min, √nᵢ (maxⱼ (ûⱼ − b(nⱼ)) − ûᵢ − b(nᵢ)));   φᵢ ← clip(dᵢ √nᵢ; φᵢ, 2 φᵢ)

from dᵢ = φᵢ = d_min. Afshar & Pacchiano 2025 (arXiv 2512.02214) use both to select among reinforcement learners, with
the episode's return as the reward.

Sources: of both papers only the opening pages could be consulted, not the boxes of the algorithms. The rules above are
those of 2306.02869 as they are commonly stated; structure and defaults (d_min = 1, c = 1, δ = 0.01) were checked
against the authors' class ``BalancingHyperparamDoublingDataDriven`` (github.com/pacchiano/modelselection). That class
differs: its bonus has ln((n + 1)/δ), and it divides sums by √n where the rules have averages. One more difference is
ours: ln n is replaced by max(ln n, 1), since the bonus has no value at n = 1. Means are normalised when they are read.
"""

from __future__ import annotations

import math
from typing import Annotated, Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from pydantic.dataclasses import dataclass

from apel.numerics.compiled import njit
from apel.numerics.views import Layout, Row, named_numbers
from apel.run.selection import SELECTOR_CONFIG, compiled_observe, compiled_select, new_state
from apel.selectors.indices import pick_largest
from apel.selectors.normalising import Bounds, take_in, unit_mode, unit_range


class RegretOptions(NamedTuple):
    """What both rules go by."""

    mode: float
    min_coefficient: float
    confidence: float
    failure_probability: float
    estimates: float
    """Whether coefficients are estimated, 0 or 1."""


class RegretState(NamedTuple):
    """The common blocks, then what is known of each learner."""

    probability: Row
    performance_estimate: Row
    concentration: Row
    limits: Row
    """``float64[2]``: low and high of the performances."""
    num_selections: Row
    performance_sum: Row
    coefficient: Row
    """d."""
    potential: Row
    """φ."""


_LAYOUT = Layout(RegretState, limits=2)
_state, _options = _LAYOUT.view, named_numbers(RegretOptions)


@compiled_select
def _select(parameters: Row, num_learners: int, row: Row, stream: NDArray[np.uint64]) -> int:
    """Argmin φ; ties uniformly at random."""
    state = _state(row, num_learners)
    index = state.probability
    for k in range(num_learners):
        index[k] = -state.potential[k]
    return pick_largest(index, stream)


@njit
def _bonus(options: RegretOptions, num_learners: int, count: float) -> float:
    """b(n) = c √(ln(M max(ln n, 1) / δ) / n)."""
    logarithm = math.log(num_learners * max(math.log(count), 1.0) / options.failure_probability)
    return options.confidence * math.sqrt(logarithm / count)


@njit
def _shortfall(options: RegretOptions, num_learners: int, state: RegretState, selected: int) -> float:
    """maxⱼ (ûⱼ − b(nⱼ)) over the learners that were selected so far, minus ûᵢ + b(nᵢ) of the one selected now."""
    low, high = state.limits[0], state.limits[1]
    span = high - low if high > low else 1.0
    highest, upper = -np.inf, 0.0
    for k in range(num_learners):
        count = state.num_selections[k]
        if count > 0.0:
            mean = (state.performance_sum[k] / count - low) / span
            bonus = _bonus(options, num_learners, count)
            highest = max(highest, mean - bonus)
            if k == selected:
                upper = mean + bonus
    return highest - upper


@compiled_observe
def _observe(parameters: Row, num_learners: int, row: Row, selected: int, performance: float) -> None:
    """Count the episode, then the coefficient and the potential of the selected learner."""
    options, state = _options(parameters), _state(row, num_learners)
    coefficient, potential = state.coefficient, state.potential
    state.performance_estimate[selected] = performance
    state.num_selections[selected] += 1.0
    state.performance_sum[selected] += take_in(options.mode, state.limits, performance)
    shortfall = _shortfall(options, num_learners, state, selected)
    root = math.sqrt(state.num_selections[selected])
    if options.estimates != 0.0:
        coefficient[selected] = max(options.min_coefficient, root * shortfall)
        before = potential[selected]
        potential[selected] = min(max(coefficient[selected] * root, before), 2.0 * before)
    else:
        if shortfall > coefficient[selected] / root:
            coefficient[selected] *= 2.0
        potential[selected] = coefficient[selected] * root


@dataclass(frozen=True, config=SELECTOR_CONFIG)
class D3rb:
    """The learner of the smallest regret potential acts; a coefficient found too small is doubled.

    Attributes
    ----------
    min_coefficient:
        d_min > 0, in units of normalised performance.
    confidence:
        c ≥ 0, the scale of the confidence bonus.
    failure_probability:
        δ, 0 < δ < 1.
    bounds:
        (low, high) of performances, which are clipped to it; without it, the range seen so far.
    """

    estimates: ClassVar[bool] = False
    """Whether coefficients are estimated, not doubled."""

    min_coefficient: Annotated[float, Field(gt=0.0)] = 1.0
    confidence: Annotated[float, Field(ge=0.0)] = 1.0
    failure_probability: Annotated[float, Field(gt=0.0, lt=1.0)] = 0.01
    bounds: Bounds | None = None

    layout: ClassVar[Layout[Any]] = _LAYOUT

    select = staticmethod(_select)
    observe = staticmethod(_observe)

    def parameters(self) -> Row:
        """``float64[5]``: mode, d_min, c, δ, whether coefficients are estimated."""
        mode, estimates = unit_mode(self.bounds), float(self.estimates)
        return np.array(RegretOptions(mode, self.min_coefficient, self.confidence, self.failure_probability, estimates))

    def initial_state(self, num_learners: int, num_episodes: int) -> Row:
        """``float64[7 · learners + 2]``."""
        least = self.min_coefficient
        return new_state(self.layout, num_learners, limits=unit_range(self.bounds), coefficient=least, potential=least)


@dataclass(frozen=True, config=SELECTOR_CONFIG)
class Ed2rb(D3rb):
    """As `D3rb`, with coefficients estimated from the lower bound on the best mean, and potentials that at most double.

    Its options are the same.
    """

    estimates: ClassVar[bool] = True
