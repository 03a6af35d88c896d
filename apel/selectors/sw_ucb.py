"""SW-UCB: UCB over a window of constant length (Garivier & Moulines 2011, arXiv 0805.3415).

The rule is that of `apel.selectors.ssbas` with the last τ selections in place of the last half; so are its functions.
"""

from __future__ import annotations

from typing import Annotated, Any, ClassVar

import numpy as np
from pydantic import Field
from pydantic.dataclasses import dataclass

from apel.numerics.views import Layout, Row
from apel.run.selection import SELECTOR_CONFIG
from apel.selectors.normalising import Bounds, check_bounds
from apel.selectors.ssbas import LAYOUT, NormaliseWindow, observe, select, window_options, window_state


@dataclass(frozen=True, config=SELECTOR_CONFIG)
class SwUcb:
    """argmax x̄ₖ + √(ξ ln min(t, τ) / nₖ) over the last τ selections; a learner missing from them first.

    Attributes
    ----------
    window:
        τ, in episodes. 1000 as in SMPyBandits; the paper takes τ = 2 √(T ln T / Υ) for Υ known breakpoints.
    exploration:
        ξ > 0. 1 as in SMPyBandits; the paper's bound needs ξ > 1/2.
    normalise:
        ``minmax_window``, ``fixed_bounds`` or ``none``, as in `Ssbas`; the paper's rewards lie in [0, 1].
    bounds:
        (low, high) for ``fixed_bounds``; performances beyond are clipped.
    """

    window: Annotated[int, Field(ge=1)] = 1000
    exploration: Annotated[float, Field(gt=0.0)] = 1.0
    normalise: NormaliseWindow = "minmax_window"
    bounds: Bounds | None = None

    layout: ClassVar[Layout[Any]] = LAYOUT

    select = staticmethod(select)
    observe = staticmethod(observe)

    def __post_init__(self) -> None:
        check_bounds(self.normalise, self.bounds)

    def parameters(self) -> Row:
        """``float64[5]``: ξ, τ, mode, low, high."""
        return np.array(window_options(self.exploration, self.window, self.normalise, self.bounds))

    def initial_state(self, num_learners: int, num_episodes: int) -> Row:
        """``float64[5 · learners + 8 + 4 · (min(τ, episodes) + 1)]``; 2 in place of 4 without ``minmax_window``."""
        return window_state(num_learners, num_episodes, self.window, self.normalise)
