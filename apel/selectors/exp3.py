"""EXP3 and EXP3.S: exponential weights for adversarial rewards (Auer, Cesa-Bianchi, Freund & Schapire 2002, §3, §8).

    pₖ = (1 − γ) wₖ / W + γ/K,   x̂_L = r / p_L for the selected learner, 0 for the others
    EXP3:    wₖ ← wₖ exp(γ x̂ₖ / K)
    EXP3.S:  wₖ ← wₖ exp(γ x̂ₖ / K) + (e α / K) W,   W = Σ w before the update

Weights are kept as logarithms, the largest of which is 0 after every episode: they neither overflow nor, in EXP3, come
to a weight of 0 from which there is no return. (SMPyBandits gives the share e α W / K to the selected arm alone; the
paper, and this, to all.)
"""

from __future__ import annotations

import math
from typing import Annotated, Any, ClassVar, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from pydantic.dataclasses import dataclass

from apel.numerics.streams import categorical
from apel.numerics.views import Layout, Row
from apel.run.selection import SELECTOR_CONFIG, compiled_observe, compiled_select, new_state
from apel.selectors.normalising import Bounds, UnitOptions, to_unit, unit_mode, unit_options, unit_range


class Exp3State(NamedTuple):
    """The common blocks, then the weights and how they move."""

    probability: Row
    performance_estimate: Row
    concentration: Row
    limits: Row
    """``float64[2]``: low and high of the performances."""
    mixing: Row
    """``float64[1]``: γ."""
    share: Row
    """``float64[1]``: e α / K."""
    log_weight: Row


_LAYOUT = Layout(Exp3State, limits=2, mixing=1, share=1)
_state = _LAYOUT.view


@compiled_select
def _select(parameters: Row, num_learners: int, row: Row, stream: NDArray[np.uint64]) -> int:
    """Draw from (1 − γ) w / W + γ/K."""
    state = _state(row, num_learners)
    probability, mixing = state.probability, state.mixing[0]
    total = 0.0
    for k in range(num_learners):
        probability[k] = math.exp(state.log_weight[k])
        total += probability[k]
    for k in range(num_learners):
        probability[k] = (1.0 - mixing) * probability[k] / total + mixing / num_learners
    return categorical(stream, probability)


@compiled_observe
def _observe(parameters: Row, num_learners: int, row: Row, selected: int, performance: float) -> None:
    """Multiply the selected learner's weight, give each its share of all, divide by the largest."""
    state = _state(row, num_learners)
    weight, mixing, share = state.log_weight, state.mixing[0], state.share[0]
    state.performance_estimate[selected] = performance
    reward = to_unit(unit_options(parameters).mode, state.limits, performance)
    gain = mixing * reward / (num_learners * state.probability[selected])
    if share > 0.0:
        total = 0.0
        for k in range(num_learners):
            total += math.exp(weight[k])
        for k in range(num_learners):
            grown = weight[k] + gain if k == selected else weight[k]
            weight[k] = math.log(math.exp(grown) + share * total)
    else:
        weight[selected] += gain
    largest = weight.max()
    for k in range(num_learners):
        weight[k] -= largest


Share = Literal["horizon"] | Annotated[float, Field(gt=0.0, le=1.0)]
"""A number in (0, 1], or the one that the paper derives from the number of episodes."""


def _or_derived(value: str | float, derived: float) -> float:
    return derived if isinstance(value, str) else value


def _new_state(num_learners: int, bounds: tuple[float, float] | None, mixing: float, share: float) -> Row:
    return new_state(_LAYOUT, num_learners, limits=unit_range(bounds), mixing=mixing, share=share)


@dataclass(frozen=True, config=SELECTOR_CONFIG)
class Exp3:
    """Exponential weights on importance-weighted rewards, mixed with uniform exploration.

    Attributes
    ----------
    mixing:
        γ in (0, 1], or ``horizon`` for min(1, √(K ln K / ((e − 1) T))) (Corollary 3.2 with g = T).
    bounds:
        (low, high) of performances, which are clipped to it; without it, the range seen so far.
    """

    mixing: Share = "horizon"
    bounds: Bounds | None = None

    layout: ClassVar[Layout[Any]] = _LAYOUT

    select = staticmethod(_select)
    observe = staticmethod(_observe)

    def parameters(self) -> Row:
        """``float64[1]``: mode."""
        return np.array(UnitOptions(unit_mode(self.bounds)))

    def initial_state(self, num_learners: int, num_episodes: int) -> Row:
        """``float64[4 · learners + 4]``."""
        k = num_learners
        derived = min(1.0, math.sqrt(k * math.log(k) / ((math.e - 1.0) * num_episodes)))
        return _new_state(k, self.bounds, _or_derived(self.mixing, derived), 0.0)


@dataclass(frozen=True, config=SELECTOR_CONFIG)
class Exp3S:
    """EXP3 whose weights share a part of their sum, so that a learner that turns good is soon found again.

    Attributes
    ----------
    mixing:
        γ in (0, 1], or ``horizon`` for min(1, √(K (S ln(K T) + e) / ((e − 1) T))) (Corollary 8.3).
    share:
        α in (0, 1], or ``horizon`` for 1/T.
    hardness:
        S ≥ 1, the number of times that another learner becomes best, plus one; used with ``horizon`` only.
    bounds:
        (low, high) of performances, which are clipped to it; without it, the range seen so far.
    """

    mixing: Share = "horizon"
    share: Share = "horizon"
    hardness: Annotated[int, Field(ge=1)] = 1
    bounds: Bounds | None = None

    layout: ClassVar[Layout[Any]] = _LAYOUT

    select = staticmethod(_select)
    observe = staticmethod(_observe)

    def parameters(self) -> Row:
        """``float64[1]``: mode."""
        return np.array(UnitOptions(unit_mode(self.bounds)))

    def initial_state(self, num_learners: int, num_episodes: int) -> Row:
        """``float64[4 · learners + 4]``."""
        k, t = num_learners, num_episodes
        derived = min(1.0, math.sqrt(k * (self.hardness * math.log(k * t) + math.e) / ((math.e - 1.0) * t)))
        share = _or_derived(self.share, 1.0 / t)
        return _new_state(k, self.bounds, _or_derived(self.mixing, derived), math.e * share / k)
