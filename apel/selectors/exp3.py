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
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from pydantic.dataclasses import dataclass

from apel.selection import SELECTOR_CONFIG, Row, compiled_observe, compiled_select, header
from apel.selectors.normalising import Bounds, to_unit, unit_mode, unit_range
from apel.streams import categorical

# The state behind the common blocks: low, high | γ | e α / K | ln w[n].


@compiled_select
def _select(parameters: Row, num_learners: int, state: Row, stream: NDArray[np.uint64]) -> int:
    """Draw from (1 − γ) w / W + γ/K."""
    first = 3 * num_learners + 4
    mixing = state[first - 2]
    probability = state[:num_learners]
    total = 0.0
    for k in range(num_learners):
        probability[k] = math.exp(state[first + k])
        total += probability[k]
    for k in range(num_learners):
        probability[k] = (1.0 - mixing) * probability[k] / total + mixing / num_learners
    return categorical(stream, probability)


@compiled_observe
def _observe(parameters: Row, num_learners: int, state: Row, selected: int, performance: float) -> None:
    """Multiply the selected learner's weight, give each its share of all, divide by the largest."""
    first = 3 * num_learners + 4
    mixing, share = state[first - 2], state[first - 1]
    state[num_learners + selected] = performance
    reward = to_unit(parameters[0], state[first - 4 : first - 2], performance)
    weight = state[first : first + num_learners]
    gain = mixing * reward / (num_learners * state[selected])
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


def _state(num_learners: int, bounds: tuple[float, float] | None, mixing: float, share: float) -> Row:
    blocks = header(num_learners), unit_range(bounds), [mixing, share], np.zeros(num_learners)
    return np.concatenate(blocks)


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

    select = staticmethod(_select)
    observe = staticmethod(_observe)

    def parameters(self) -> Row:
        """``float64[1]``: mode."""
        return np.array([unit_mode(self.bounds)])

    def initial_state(self, num_learners: int, num_episodes: int) -> Row:
        """``float64[4 · learners + 4]``."""
        k = num_learners
        derived = min(1.0, math.sqrt(k * math.log(k) / ((math.e - 1.0) * num_episodes)))
        return _state(k, self.bounds, _or_derived(self.mixing, derived), 0.0)


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

    select = staticmethod(_select)
    observe = staticmethod(_observe)

    def parameters(self) -> Row:
        """``float64[1]``: mode."""
        return np.array([unit_mode(self.bounds)])

    def initial_state(self, num_learners: int, num_episodes: int) -> Row:
        """``float64[4 · learners + 4]``."""
        k, t = num_learners, num_episodes
        derived = min(1.0, math.sqrt(k * (self.hardness * math.log(k * t) + math.e) / ((math.e - 1.0) * t)))
        share = _or_derived(self.share, 1.0 / t)
        return _state(k, self.bounds, _or_derived(self.mixing, derived), math.e * share / k)
