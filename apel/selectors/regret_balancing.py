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
from typing import Annotated, ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from pydantic.dataclasses import dataclass

from apel.compiled import njit
from apel.selection import SELECTOR_CONFIG, Row, compiled_observe, compiled_select, header
from apel.selectors.indices import pick_largest
from apel.selectors.normalising import Bounds, take_in, unit_mode, unit_range

# The state behind the common blocks: low, high | n[M] | sums[M] | d[M] | φ[M].


@compiled_select
def _select(parameters: Row, num_learners: int, state: Row, stream: NDArray[np.uint64]) -> int:
    """Argmin φ; ties uniformly at random."""
    first = 6 * num_learners + 2
    for k in range(num_learners):
        state[k] = -state[first + k]
    return pick_largest(state[:num_learners], stream)


@njit
def _bonus(parameters: Row, num_learners: int, count: float) -> float:
    """b(n) = c √(ln(M max(ln n, 1) / δ) / n)."""
    return parameters[2] * math.sqrt(math.log(num_learners * max(math.log(count), 1.0) / parameters[3]) / count)


@njit
def _shortfall(parameters: Row, num_learners: int, state: Row, selected: int) -> float:
    """maxⱼ (ûⱼ − b(nⱼ)) over the learners that were selected so far, minus ûᵢ + b(nᵢ) of the one selected now."""
    first = 3 * num_learners + 2
    low, high = state[first - 2], state[first - 1]
    span = high - low if high > low else 1.0
    highest, upper = -np.inf, 0.0
    for k in range(num_learners):
        count = state[first + k]
        if count > 0.0:
            mean = (state[first + num_learners + k] / count - low) / span
            bonus = _bonus(parameters, num_learners, count)
            highest = max(highest, mean - bonus)
            if k == selected:
                upper = mean + bonus
    return highest - upper


@compiled_observe
def _observe(parameters: Row, num_learners: int, state: Row, selected: int, performance: float) -> None:
    """Count the episode, then the coefficient and the potential of the selected learner."""
    minimum, estimates = parameters[1], parameters[4] != 0.0
    first = 3 * num_learners + 2
    state[num_learners + selected] = performance
    kept = take_in(parameters[0], state[first - 2 : first], performance)
    state[first + selected] += 1.0
    state[first + num_learners + selected] += kept
    shortfall = _shortfall(parameters, num_learners, state, selected)
    root = math.sqrt(state[first + selected])
    coefficient, potential = first + 2 * num_learners + selected, first + 3 * num_learners + selected
    if estimates:
        state[coefficient] = max(minimum, root * shortfall)
        before = state[potential]
        state[potential] = min(max(state[coefficient] * root, before), 2.0 * before)
    else:
        if shortfall > state[coefficient] / root:
            state[coefficient] *= 2.0
        state[potential] = state[coefficient] * root


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

    select = staticmethod(_select)
    observe = staticmethod(_observe)

    def parameters(self) -> Row:
        """``float64[5]``: mode, d_min, c, δ, whether coefficients are estimated."""
        mode, estimates = unit_mode(self.bounds), float(self.estimates)
        return np.array([mode, self.min_coefficient, self.confidence, self.failure_probability, estimates])

    def initial_state(self, num_learners: int, num_episodes: int) -> Row:
        """``float64[7 · learners + 2]``."""
        counts, coefficients = np.zeros(2 * num_learners), np.full(2 * num_learners, self.min_coefficient)
        return np.concatenate([header(num_learners), unit_range(self.bounds), counts, coefficients])


@dataclass(frozen=True, config=SELECTOR_CONFIG)
class Ed2rb(D3rb):
    """As `D3rb`, with coefficients estimated from the lower bound on the best mean, and potentials that at most double.

    Its options are the same.
    """

    estimates: ClassVar[bool] = True
