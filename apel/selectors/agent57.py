"""Agent57's meta-controller: a sliding-window UCB without the logarithm, and ε-greedy (Badia et al. 2020).

Source: arXiv 2003.13350, after ``deep_rl_zoo/bandit.py`` (michaelnny/deep_rl_zoo), whose reward is the undiscounted
return of the episode as it is. Unlike there, ties are broken uniformly at random instead of by position.
"""

from __future__ import annotations

import math
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from pydantic.dataclasses import dataclass

from apel.selection import SELECTOR_CONFIG, Row, compiled_select
from apel.selectors import windows
from apel.selectors.indices import pick_largest_or_any
from apel.selectors.normalising import FIXED, Bounds, check_bounds
from apel.selectors.ssbas import NormaliseWindow, observe, window_parameters, window_state


@compiled_select
def _select(parameters: Row, num_learners: int, state: Row, stream: NDArray[np.uint64]) -> int:
    """Learner k in episode k < n; then with probability ε any, else argmax x̄ₖ + β √(1 / nₖ) over the window."""
    window, index = state[3 * num_learners :], state[:num_learners]
    past = windows.past_episodes(window)
    if past < num_learners:
        for k in range(num_learners):
            index[k] = 1.0 if k == past else 0.0
        return past
    low, high = windows.extremes(window, num_learners)
    if parameters[2] == FIXED:
        low, high = parameters[3], parameters[4]
    span = high - low if high > low else 1.0
    count, performance_sum = windows.counts(window, num_learners), windows.sums(window, num_learners)
    for k in range(num_learners):
        index[k] = np.inf  # has left the window: 1/0 in the source, too
        if count[k] > 0.0:
            index[k] = (performance_sum[k] / count[k] - low) / span + parameters[0] * math.sqrt(1.0 / count[k])
    return pick_largest_or_any(parameters[5], index, stream)


@dataclass(frozen=True, config=SELECTOR_CONFIG)
class Agent57:
    """With probability ε any learner, else argmax x̄ₖ + β √(1/nₖ) over the last τ selections; each once at first.

    Attributes
    ----------
    window:
        τ, in episodes.
    exploration:
        β ≥ 0, the weight of the bonus.
    epsilon:
        ε, the share of uniform selections; never decayed. These three as in deep_rl_zoo's Agent57.
    normalise:
        ``none``, ``minmax_window`` or ``fixed_bounds``, as in `Ssbas`.
    bounds:
        (low, high) for ``fixed_bounds``; performances beyond are clipped.
    """

    window: Annotated[int, Field(ge=1)] = 90
    exploration: Annotated[float, Field(ge=0.0)] = 1.0
    epsilon: Annotated[float, Field(ge=0.0, le=1.0)] = 0.5
    normalise: NormaliseWindow = "none"
    bounds: Bounds | None = None

    select = staticmethod(_select)
    observe = staticmethod(observe)

    def __post_init__(self) -> None:
        check_bounds(self.normalise, self.bounds)

    def parameters(self) -> Row:
        """``float64[6]``: β, τ, mode, low, high, ε."""
        return window_parameters(self.exploration, self.window, self.normalise, self.bounds, self.epsilon)

    def initial_state(self, num_learners: int, num_episodes: int) -> Row:
        """``float64[5 · learners + 8 + 2 · (min(τ, episodes) + 1)]``; 4 in place of 2 with ``minmax_window``."""
        return window_state(num_learners, num_episodes, self.window, self.normalise)
