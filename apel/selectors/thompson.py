"""Thompson sampling that forgets: discounted (Raj & Kalyani 2017) and dynamic (Gupta, Granmo & Agrawala 2011).

Each learner has a Beta distribution over its mean; one number is drawn from each, and the learner of the largest acts.
Both papers have rewards of 0 or 1; a performance in [0, 1] counts here as that fraction of a success (a Bernoulli
trial with that probability would need randomness where an episode is taken in, and adds variance only).

The recorded probability is 1 for the learner that was drawn and 0 for all others: given the draws nothing is left to
chance, and the probability before them has no closed form.
"""

from __future__ import annotations

from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from pydantic.dataclasses import dataclass

from apel.compiled import njit
from apel.selection import SELECTOR_CONFIG, Row, compiled_observe, compiled_select, header
from apel.selectors.normalising import Bounds, to_unit, unit_mode, unit_range
from apel.streams import Stream, standard_gamma, uniform

# The state behind the common blocks: low, high | successes[n] | failures[n].


@njit
def _gamma(stream: Stream, shape: float) -> float:
    """One draw from Gamma(``shape``, 1), also below shape 1, by Gamma(a) = Gamma(a + 1) U^(1/a)."""
    if shape >= 1.0:
        return standard_gamma(stream, shape)
    if shape <= 0.0:
        return 0.0
    return standard_gamma(stream, shape + 1.0) * (1.0 - uniform(stream)) ** (1.0 / shape)


@njit
def beta(stream: Stream, successes: float, failures: float) -> float:
    """One draw from Beta(``successes``, ``failures``), not both 0."""
    x, y = _gamma(stream, successes), _gamma(stream, failures)
    return x / (x + y) if x + y > 0.0 else successes / (successes + failures)


@compiled_select
def _select(parameters: Row, num_learners: int, state: Row, stream: NDArray[np.uint64]) -> int:
    """θₖ ~ Beta(a + Sₖ, a + Fₖ); argmax θₖ."""
    prior = parameters[1]
    first = 3 * num_learners + 2
    selected, largest = 0, -1.0
    for k in range(num_learners):
        theta = beta(stream, prior + state[first + k], prior + state[first + num_learners + k])
        if theta > largest:
            selected, largest = k, theta
    state[:num_learners] = 0.0
    state[selected] = 1.0
    return selected


@compiled_observe
def _observe_discounted(parameters: Row, num_learners: int, state: Row, selected: int, performance: float) -> None:
    """S ← γ S, F ← γ F; then S_L ← S_L + r, F_L ← F_L + 1 − r."""
    first = 3 * num_learners + 2
    state[num_learners + selected] = performance
    reward = to_unit(parameters[0], state[first - 2 : first], performance)
    for i in range(first, first + 2 * num_learners):
        state[i] *= parameters[2]
    state[first + selected] += reward
    state[first + num_learners + selected] += 1.0 - reward


@compiled_observe
def _observe_dynamic(parameters: Row, num_learners: int, state: Row, selected: int, performance: float) -> None:
    """α_L ← α_L + r, β_L ← β_L + 1 − r, both times C/(C + 1) once α_L + β_L has reached C."""
    first = 3 * num_learners + 2
    capacity = parameters[2]
    state[num_learners + selected] = performance
    reward = to_unit(parameters[0], state[first - 2 : first], performance)
    success, failure = first + selected, first + num_learners + selected
    factor = 1.0 if state[success] + state[failure] < capacity else capacity / (capacity + 1.0)
    state[success] = (state[success] + reward) * factor
    state[failure] = (state[failure] + 1.0 - reward) * factor


@dataclass(frozen=True, config=SELECTOR_CONFIG)
class DiscountedTs:
    """Beta(1 + S, 1 + F) with all successes and failures discounted by γ per episode (dTS; arXiv 1707.09727).

    Attributes
    ----------
    discount:
        γ, 0 < γ ≤ 1; 0.95 as in SMPyBandits.
    bounds:
        (low, high) of performances, which are clipped to it; without it, the range seen so far.
    """

    discount: Annotated[float, Field(gt=0.0, le=1.0)] = 0.95
    bounds: Bounds | None = None

    select = staticmethod(_select)
    observe = staticmethod(_observe_discounted)

    def parameters(self) -> Row:
        """``float64[3]``: mode, prior a = 1, γ."""
        return np.array([unit_mode(self.bounds), 1.0, self.discount])

    def initial_state(self, num_learners: int, num_episodes: int) -> Row:
        """``float64[5 · learners + 2]``."""
        return np.concatenate([header(num_learners), unit_range(self.bounds), np.zeros(2 * num_learners)])


@dataclass(frozen=True, config=SELECTOR_CONFIG)
class DynamicTs:
    """Beta(α, β) of each learner, α + β never much above C: a moving average over about its last C episodes.

    Source: Gupta, Granmo & Agrawala 2011, *Thompson sampling for dynamic multi-armed bandits* (ICMLA), whose text was
    not at hand: the rule is the well-known one, the prior Beta(1, 1).

    Attributes
    ----------
    capacity:
        C > 2, the number of own episodes that a learner remembers; a choice of ours.
    bounds:
        (low, high) of performances, which are clipped to it; without it, the range seen so far.
    """

    capacity: Annotated[float, Field(gt=2.0)] = 100.0
    bounds: Bounds | None = None

    select = staticmethod(_select)
    observe = staticmethod(_observe_dynamic)

    def parameters(self) -> Row:
        """``float64[3]``: mode, prior a = 0 (it is in the state), C."""
        return np.array([unit_mode(self.bounds), 0.0, self.capacity])

    def initial_state(self, num_learners: int, num_episodes: int) -> Row:
        """``float64[5 · learners + 2]``."""
        return np.concatenate([header(num_learners), unit_range(self.bounds), np.ones(2 * num_learners)])
