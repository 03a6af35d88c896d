"""CORRAL: log-barrier mirror descent with increasing learning rates (Agarwal, Luo, Neyshabur & Schapire 2017).

With the importance-weighted loss ℓ (ℓ_L = (1 − r) / p̄_L for the selected learner, 0 for the others):

    1/pₖ ← 1/pₖ + ηₖ (ℓₖ − λ), with λ in [min ℓ, max ℓ] such that Σ p = 1
    p̄ₖ = (1 − γ) pₖ + γ/M, the probability of selection
    if 1/p̄ₖ > ρₖ: ρₖ ← 2/p̄ₖ and ηₖ ← β ηₖ

from pₖ = 1/M, ρₖ = 2 M, β = e^(1/ln T). Source: arXiv 1612.06246, Algorithms 1 and 2, after the implementations in
SMPyBandits and in coba. The learners here are not fed importance-weighted rewards, as the paper's are, and are not
smoothed, as in Pacchiano et al. 2020: they learn from every episode.
"""

from __future__ import annotations

import math
from typing import Annotated, Any, ClassVar, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from pydantic.dataclasses import dataclass

from apel.numerics.compiled import njit
from apel.numerics.streams import categorical
from apel.numerics.views import Layout, Row
from apel.run.selection import SELECTOR_CONFIG, compiled_observe, compiled_select, new_state
from apel.selectors.normalising import Bounds, UnitOptions, to_unit, unit_mode, unit_options, unit_range


class CorralState(NamedTuple):
    """The common blocks, then what mirror descent moves."""

    probability: Row
    performance_estimate: Row
    concentration: Row
    limits: Row
    """``float64[2]``: low and high of the performances."""
    mixing: Row
    """``float64[1]``: γ."""
    growth: Row
    """``float64[1]``: β."""
    p: Row
    rate: Row
    """η."""
    threshold: Row
    """ρ."""


_LAYOUT = Layout(CorralState, limits=2, mixing=1, growth=1)
_state = _LAYOUT.view

_MOST_STEPS = 100


@njit
def multiplier(p: Row, rate: Row, selected: int, loss: float) -> float:
    """λ in [0, ``loss``] at which f(λ) = Σ 1 / (1/pₖ + ηₖ (ℓₖ − λ)) is 1, ℓ being ``loss`` at ``selected``, else 0.

    1/f is concave and falls, and is a line where there is one term: Newton's method on it converges from the right
    within a few steps. A step that leaves the bracket (there are poles) is replaced by bisection.
    """
    low, high = 0.0, loss
    for k in range(p.shape[0]):
        pole = 1.0 / (rate[k] * p[k]) + (loss if k == selected else 0.0)
        high = min(high, pole)
    at = low
    for _ in range(_MOST_STEPS):
        value, slope = 0.0, 0.0
        for k in range(p.shape[0]):
            term = 1.0 / (1.0 / p[k] + rate[k] * ((loss if k == selected else 0.0) - at))
            value += term
            slope += rate[k] * term * term
        if value > 1.0:
            high = at
        else:
            low = at
        following = at + value * (1.0 - value) / slope
        if not low < following < high:
            following = 0.5 * (low + high)
        if abs(value - 1.0) < 1e-14 or following == at:
            break
        at = following
    return at


@njit
def descend(p: Row, rate: Row, selected: int, loss: float) -> None:
    """One step of mirror descent on ``p``, ``float64[learners]``, in place (Algorithm 2)."""
    if loss <= 0.0 or p.shape[0] == 1:
        return
    at = multiplier(p, rate, selected, loss)
    total = 0.0
    for k in range(p.shape[0]):
        p[k] = 1.0 / (1.0 / p[k] + rate[k] * ((loss if k == selected else 0.0) - at))
        total += p[k]
    for k in range(p.shape[0]):
        p[k] /= total


@compiled_select
def _select(parameters: Row, num_learners: int, row: Row, stream: NDArray[np.uint64]) -> int:
    """Draw from p̄ = (1 − γ) p + γ/M."""
    state = _state(row, num_learners)
    mixing = state.mixing[0]
    for k in range(num_learners):
        state.probability[k] = (1.0 - mixing) * state.p[k] + mixing / num_learners
    return categorical(stream, state.probability)


@compiled_observe
def _observe(parameters: Row, num_learners: int, row: Row, selected: int, performance: float) -> None:
    """A step of mirror descent, then a higher learning rate where a probability has become small."""
    state = _state(row, num_learners)
    p, rate, threshold, mixing = state.p, state.rate, state.threshold, state.mixing[0]
    state.performance_estimate[selected] = performance
    loss = 1.0 - to_unit(unit_options(parameters).mode, state.limits, performance)
    descend(p, rate, selected, loss / state.probability[selected])
    for k in range(num_learners):
        inverse = 1.0 / ((1.0 - mixing) * p[k] + mixing / num_learners)
        if inverse > threshold[k]:
            threshold[k] = 2.0 * inverse
            rate[k] *= state.growth[0]


@dataclass(frozen=True, config=SELECTOR_CONFIG)
class Corral:
    """Selects by probabilities that log-barrier mirror descent moves against importance-weighted losses.

    Attributes
    ----------
    learning_rate:
        η > 0 before any increase, or ``horizon`` for √(M/T), as in SMPyBandits.
    mixing:
        γ in [0, 1], the share of uniform selections, or ``horizon`` for the paper's 1/T.
    bounds:
        (low, high) of performances, which are clipped to it; without it, the range seen so far.
    """

    learning_rate: Literal["horizon"] | Annotated[float, Field(gt=0.0)] = "horizon"
    mixing: Literal["horizon"] | Annotated[float, Field(ge=0.0, le=1.0)] = "horizon"
    bounds: Bounds | None = None

    layout: ClassVar[Layout[Any]] = _LAYOUT

    select = staticmethod(_select)
    observe = staticmethod(_observe)

    def parameters(self) -> Row:
        """``float64[1]``: mode."""
        return np.array(UnitOptions(unit_mode(self.bounds)))

    def initial_state(self, num_learners: int, num_episodes: int) -> Row:
        """``float64[6 · learners + 4]``."""
        m, t = num_learners, num_episodes
        rate = math.sqrt(m / t) if isinstance(self.learning_rate, str) else self.learning_rate
        mixing = 1.0 / t if isinstance(self.mixing, str) else self.mixing
        growth = math.exp(1.0 / math.log(max(t, 2)))
        return new_state(
            self.layout,
            m,
            limits=unit_range(self.bounds),
            mixing=mixing,
            growth=growth,
            p=1.0 / m,
            rate=rate,
            threshold=2.0 * m,
        )
