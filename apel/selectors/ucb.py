"""UCB1 (Auer, Cesa-Bianchi & Fischer 2002; Algorithm 1) and its discounted form D-UCB (Garivier & Moulines 2011).

Both keep a count Nₖ and a sum Xₖ per learner, multiplied by γ after every episode (γ = 1: UCB1), and select

    argmax Xₖ/Nₖ + √(ξ ln n / Nₖ),   n = Σ Nₖ.
"""

from __future__ import annotations

from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from pydantic.dataclasses import dataclass

from apel.compiled import njit
from apel.selection import SELECTOR_CONFIG, Row, compiled_observe, compiled_select, header
from apel.selectors.indices import pick_largest, upper_confidence_bounds
from apel.selectors.normalising import Bounds, Normalise, check_bounds, mode_of, range_of, take_in

# The state behind the common blocks: low, high | N[n] | X[n].


@compiled_select
def select(parameters: Row, num_learners: int, state: Row, stream: NDArray[np.uint64]) -> int:
    """A learner that was never tried first, else argmax x̄ₖ + √(ξ ln n / Nₖ); ties uniformly at random."""
    first = 3 * num_learners + 2
    count, performance_sum = state[first : first + num_learners], state[first + num_learners : first + 2 * num_learners]
    index = state[:num_learners]
    low, high = state[first - 2], state[first - 1]
    upper_confidence_bounds(parameters[0], count.sum(), count, performance_sum, low, high, index)
    return pick_largest(index, stream)


@njit
def count_episode(parameters: Row, num_learners: int, state: Row, selected: int, performance: float) -> None:
    """N ← γ N, X ← γ X; then N_L ← N_L + 1, X_L ← X_L + performance."""
    mode, discount = parameters[1], parameters[2]
    first = 3 * num_learners + 2
    state[num_learners + selected] = performance
    kept = take_in(mode, state[first - 2 : first], performance)
    for i in range(first, first + 2 * num_learners):
        state[i] *= discount
    state[first + selected] += 1.0
    state[first + num_learners + selected] += kept


@compiled_observe
def _observe(parameters: Row, num_learners: int, state: Row, selected: int, performance: float) -> None:
    count_episode(parameters, num_learners, state, selected, performance)


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

    select = staticmethod(select)
    observe = staticmethod(_observe)

    def __post_init__(self) -> None:
        check_bounds(self.normalise, self.bounds)

    def parameters(self) -> Row:
        """``float64[3]``: ξ, mode, γ = 1."""
        return np.array([self.exploration, mode_of(self.normalise), 1.0])

    def initial_state(self, num_learners: int, num_episodes: int) -> Row:
        """``float64[5 · learners + 2]``."""
        return np.concatenate([header(num_learners), range_of(self.normalise, self.bounds), np.zeros(2 * num_learners)])


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
        return np.array([self.exploration, mode_of(self.normalise), self.discount])
