"""Thompson sampling that forgets: discounted (Raj & Kalyani 2017) and dynamic (Gupta, Granmo & Agrawala 2011).

Each learner has a Beta distribution over its mean; one number is drawn from each, and the learner of the largest acts.
Both papers have rewards of 0 or 1; a performance in [0, 1] counts here as that fraction of a success (a Bernoulli
trial with that probability would need randomness where an episode is taken in, and adds variance only).

The recorded probability is 1 for the learner that was drawn and 0 for all others: given the draws nothing is left to
chance, and the probability before them has no closed form.
"""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from pydantic.dataclasses import dataclass

from apel.numerics.compiled import njit
from apel.numerics.streams import Stream, standard_gamma, uniform
from apel.numerics.views import Layout, Row, named_numbers
from apel.run.selection import SELECTOR_CONFIG, compiled_observe, compiled_select, new_state
from apel.selectors.normalising import Bounds, to_unit, unit_mode, unit_range


class ThompsonOptions(NamedTuple):
    """What both rules go by."""

    mode: float
    prior: float
    """a: what successes and failures are counted from at a draw."""
    forgetting: float
    """γ of the discounted rule, C of the dynamic one."""


class ThompsonState(NamedTuple):
    """The common blocks, then the Beta distributions."""

    probability: Row
    performance_estimate: Row
    concentration: Row
    limits: Row
    """``float64[2]``: low and high of the performances."""
    successes: Row
    failures: Row


_LAYOUT = Layout(ThompsonState, limits=2)
_state, _options = _LAYOUT.view, named_numbers(ThompsonOptions)


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
def _select(parameters: Row, num_learners: int, row: Row, stream: NDArray[np.uint64]) -> int:
    """θₖ ~ Beta(a + Sₖ, a + Fₖ); argmax θₖ."""
    prior, state = _options(parameters).prior, _state(row, num_learners)
    selected, largest = 0, -1.0
    for k in range(num_learners):
        theta = beta(stream, prior + state.successes[k], prior + state.failures[k])
        if theta > largest:
            selected, largest = k, theta
    state.probability[:] = 0.0
    state.probability[selected] = 1.0
    return selected


@compiled_observe
def _observe_discounted(parameters: Row, num_learners: int, row: Row, selected: int, performance: float) -> None:
    """S ← γ S, F ← γ F; then S_L ← S_L + r, F_L ← F_L + 1 − r."""
    options, state = _options(parameters), _state(row, num_learners)
    state.performance_estimate[selected] = performance
    reward = to_unit(options.mode, state.limits, performance)
    for k in range(num_learners):
        state.successes[k] *= options.forgetting
        state.failures[k] *= options.forgetting
    state.successes[selected] += reward
    state.failures[selected] += 1.0 - reward


@compiled_observe
def _observe_dynamic(parameters: Row, num_learners: int, row: Row, selected: int, performance: float) -> None:
    """α_L ← α_L + r, β_L ← β_L + 1 − r, both times C/(C + 1) once α_L + β_L has reached C."""
    options, state = _options(parameters), _state(row, num_learners)
    state.performance_estimate[selected] = performance
    reward = to_unit(options.mode, state.limits, performance)
    successes, failures, capacity = state.successes, state.failures, options.forgetting
    factor = 1.0 if successes[selected] + failures[selected] < capacity else capacity / (capacity + 1.0)
    successes[selected] = (successes[selected] + reward) * factor
    failures[selected] = (failures[selected] + 1.0 - reward) * factor


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

    layout: ClassVar[Layout[Any]] = _LAYOUT

    select = staticmethod(_select)
    observe = staticmethod(_observe_discounted)

    def parameters(self) -> Row:
        """``float64[3]``: mode, prior a = 1, γ."""
        return np.array(ThompsonOptions(unit_mode(self.bounds), 1.0, self.discount))

    def initial_state(self, num_learners: int, num_episodes: int) -> Row:
        """``float64[5 · learners + 2]``."""
        return new_state(self.layout, num_learners, limits=unit_range(self.bounds))


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

    layout: ClassVar[Layout[Any]] = _LAYOUT

    select = staticmethod(_select)
    observe = staticmethod(_observe_dynamic)

    def parameters(self) -> Row:
        """``float64[3]``: mode, prior a = 0 (it is in the state), C."""
        return np.array(ThompsonOptions(unit_mode(self.bounds), 0.0, self.capacity))

    def initial_state(self, num_learners: int, num_episodes: int) -> Row:
        """``float64[5 · learners + 2]``."""
        return new_state(self.layout, num_learners, limits=unit_range(self.bounds), successes=1.0, failures=1.0)
