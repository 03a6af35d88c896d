"""Agent57's meta-controller: a sliding-window UCB without the logarithm, and ε-greedy (Badia et al. 2020).

Source: arXiv 2003.13350, after ``deep_rl_zoo/bandit.py`` (michaelnny/deep_rl_zoo), whose reward is the undiscounted
return of the episode as it is. Unlike there, ties are broken uniformly at random instead of by position.
"""

from __future__ import annotations

import math
from typing import Annotated, Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from pydantic.dataclasses import dataclass

from apel.numerics.views import Layout, Row, named_numbers
from apel.run.selection import SELECTOR_CONFIG, compiled_select
from apel.selectors import windows
from apel.selectors.indices import pick_largest_or_any
from apel.selectors.normalising import Bounds, check_bounds
from apel.selectors.ssbas import (
    LAYOUT,
    NormaliseWindow,
    observe,
    scale,
    view_options,
    view_state,
    window_options,
    window_state,
)
from apel.selectors.windows import view_window


class Agent57Options(NamedTuple):
    """Those of `WindowOptions`, then ε."""

    exploration: float
    length: float
    mode: float
    low: float
    high: float
    epsilon: float


_options = named_numbers(Agent57Options)


@compiled_select
def _select(parameters: Row, num_learners: int, row: Row, stream: NDArray[np.uint64]) -> int:
    """Learner k in episode k < n; then with probability ε any, else argmax x̄ₖ + β √(1 / nₖ) over the window."""
    options, state = _options(parameters), view_state(row, num_learners)
    index, window = state.probability, view_window(state.window, num_learners)
    past = windows.past_episodes(window)
    if past < num_learners:
        for k in range(num_learners):
            index[k] = 1.0 if k == past else 0.0
        return past
    low, high = scale(view_options(parameters), window)
    span = high - low if high > low else 1.0
    for k in range(num_learners):
        index[k] = np.inf  # has left the window: 1/0 in the source, too
        if window.num_selections[k] > 0.0:
            mean = (window.performance_sum[k] / window.num_selections[k] - low) / span
            index[k] = mean + options.exploration * math.sqrt(1.0 / window.num_selections[k])
    return pick_largest_or_any(options.epsilon, index, stream)


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

    layout: ClassVar[Layout[Any]] = LAYOUT

    select = staticmethod(_select)
    observe = staticmethod(observe)

    def __post_init__(self) -> None:
        check_bounds(self.normalise, self.bounds)

    def parameters(self) -> Row:
        """``float64[6]``: β, τ, mode, low, high, ε."""
        options = window_options(self.exploration, self.window, self.normalise, self.bounds)
        return np.array(Agent57Options(*options, self.epsilon))

    def initial_state(self, num_learners: int, num_episodes: int) -> Row:
        """``float64[5 · learners + 8 + 2 · (min(τ, episodes) + 1)]``; 4 in place of 2 with ``minmax_window``."""
        return window_state(num_learners, num_episodes, self.window, self.normalise)
