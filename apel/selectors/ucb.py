"""UCB1 (Auer, Cesa-Bianchi & Fischer 2002; Algorithm 1) and its discounted form D-UCB (Garivier & Moulines 2011).

Both keep a count Nₖ and a sum Xₖ per learner, multiplied by γ after every episode (γ = 1: UCB1), and select

    argmax Xₖ/Nₖ + √(ξ ln n / Nₖ),   n = Σ Nₖ.
"""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from pydantic.dataclasses import dataclass

from apel.numerics.compiled import njit
from apel.numerics.views import Layout, Row, named_numbers
from apel.run.selection import SELECTOR_CONFIG, compiled_observe, compiled_select, new_state
from apel.selectors.indices import pick_largest, upper_confidence_bounds
from apel.selectors.normalising import Bounds, Normalise, check_bounds, mode_of, range_of, take_in


class UcbOptions(NamedTuple):
    """What the rule goes by."""

    exploration: float
    mode: float
    discount: float


class UcbState(NamedTuple):
    """The common blocks, then N and X."""

    probability: Row
    performance_estimate: Row
    concentration: Row
    limits: Row
    """``float64[2]``: low and high of the performances."""
    num_selections: Row
    performance_sum: Row


_LAYOUT = Layout(UcbState, limits=2)
_state, _options = _LAYOUT.view, named_numbers(UcbOptions)


@compiled_select
def select(parameters: Row, num_learners: int, row: Row, stream: NDArray[np.uint64]) -> int:
    """A learner that was never tried first, else argmax x̄ₖ + √(ξ ln n / Nₖ); ties uniformly at random."""
    state = _state(row, num_learners)
    exploration, total = _options(parameters).exploration, state.num_selections.sum()
    low, high = state.limits[0], state.limits[1]
    upper_confidence_bounds(
        exploration, total, state.num_selections, state.performance_sum, low, high, state.probability
    )
    return pick_largest(state.probability, stream)


@njit
def count_episode(parameters: Row, num_learners: int, row: Row, selected: int, performance: float) -> None:
    """N ← γ N, X ← γ X; then N_L ← N_L + 1, X_L ← X_L + performance."""
    options, state = _options(parameters), _state(row, num_learners)
    state.performance_estimate[selected] = performance
    kept = take_in(options.mode, state.limits, performance)
    for k in range(num_learners):
        state.num_selections[k] *= options.discount
        state.performance_sum[k] *= options.discount
    state.num_selections[selected] += 1.0
    state.performance_sum[selected] += kept


@compiled_observe
def _observe(parameters: Row, num_learners: int, row: Row, selected: int, performance: float) -> None:
    count_episode(parameters, num_learners, row, selected, performance)


@dataclass(frozen=True, config=SELECTOR_CONFIG)
class Ucb1:
    """Each learner once, then argmax x̄ₖ + √(ξ ln n / nₖ) over all episodes.

    Attributes
    ----------
    exploration:
        ξ > 0; 2 in Auer et al. and in Eq. 2.3.
    normalise:
        ``minmax`` (means are mapped to [0, 1] by the range of all performances so far), ``fixed_bounds`` or ``none``.
    bounds:
        (low, high) for ``fixed_bounds``; performances beyond are clipped.
    """

    exploration: Annotated[float, Field(gt=0.0)] = 2.0
    normalise: Normalise = "minmax"
    bounds: Bounds | None = None

    layout: ClassVar[Layout[Any]] = _LAYOUT

    select = staticmethod(select)
    observe = staticmethod(_observe)

    def __post_init__(self) -> None:
        check_bounds(self.normalise, self.bounds)

    def parameters(self) -> Row:
        """``float64[3]``: ξ, mode, γ = 1."""
        return np.array(UcbOptions(self.exploration, mode_of(self.normalise), 1.0))

    def initial_state(self, num_learners: int, num_episodes: int) -> Row:
        """``float64[5 · learners + 2]``."""
        return new_state(self.layout, num_learners, limits=range_of(self.normalise, self.bounds))


@dataclass(frozen=True, config=SELECTOR_CONFIG)
class DUcb(Ucb1):
    """UCB over counts and sums that are discounted by γ per episode (D-UCB; arXiv 0805.3415).

    The paper writes the bonus as 2 B √(ξ' ln n / Nₖ), B = 1 for rewards in [0, 1]; here it is √(ξ ln n / Nₖ), with
    ξ = 4 ξ'. With γ = 1 it is UCB1 of the same ξ, bit for bit.

    Attributes
    ----------
    discount:
        γ, 0 < γ ≤ 1. 0.99 as in SMPyBandits; the paper takes γ = 1 − √(Υ/T)/4 for Υ known breakpoints.
    exploration:
        ξ > 0; 2 is ξ' = 1/2, above which the paper's bound holds.
    normalise:
        ``minmax`` (over all episodes, undiscounted), ``fixed_bounds`` or ``none``, as in `Ucb1`.
    bounds:
        (low, high) for ``fixed_bounds``; performances beyond are clipped.
    """

    discount: Annotated[float, Field(gt=0.0, le=1.0)] = 0.99

    def parameters(self) -> Row:
        """``float64[3]``: ξ, mode, γ."""
        return np.array(UcbOptions(self.exploration, mode_of(self.normalise), self.discount))
