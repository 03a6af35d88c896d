"""SSBAS: sliding stochastic bandit algorithm selection (Laroche & Féraud 2018, arXiv 1701.08810; §5.1).

At meta-time τ (the number of past selections) UCB1 is played over the last ⌊τ/2⌋ selections. The window's counts and
sums are carried along, so that an episode costs O(1) whatever the window's length (`apel.selectors.windows`). With a
window of constant length this is SW-UCB, which shares the two functions.
"""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from pydantic.dataclasses import dataclass

from apel.selection import SELECTOR_CONFIG, Row, compiled_observe, compiled_select, header
from apel.selectors import windows
from apel.selectors.indices import pick_largest, upper_confidence_bounds
from apel.selectors.normalising import FIXED, Bounds, check_bounds, mode_of

NormaliseWindow = Literal["none", "minmax_window", "fixed_bounds"]
"""Raw performances, the range of those in the window, or given bounds (with clipping)."""

HALF = 0.0
"""The window parameter that stands for ⌊τ/2⌋."""


@compiled_select
def select(parameters: Row, num_learners: int, state: Row, stream: NDArray[np.uint64]) -> int:
    """A learner missing from the window first, else argmax x̄ₖ + √(ξ ln n / nₖ); ties uniformly at random."""
    window = state[3 * num_learners :]
    low, high = windows.extremes(window, num_learners)
    if parameters[2] == FIXED:
        low, high = parameters[3], parameters[4]
    total = float(windows.episodes_inside(window))
    count, performance_sum = windows.counts(window, num_learners), windows.sums(window, num_learners)
    index = state[:num_learners]
    upper_confidence_bounds(parameters[0], total, count, performance_sum, low, high, index)
    return pick_largest(index, stream)


@compiled_observe
def observe(parameters: Row, num_learners: int, state: Row, selected: int, performance: float) -> None:
    """Append (learner, performance), advance τ, and drop what has left the window."""
    state[num_learners + selected] = performance
    if parameters[2] == FIXED:
        performance = min(max(performance, parameters[3]), parameters[4])
    window = state[3 * num_learners :]
    windows.append(window, num_learners, selected, performance)
    past = windows.past_episodes(window)
    length = past // 2 if parameters[1] == HALF else min(past, int(parameters[1]))
    windows.drop_before(window, num_learners, past - length)


def window_parameters(
    first: float, window: str | int, normalise: str, bounds: tuple[float, float] | None, *others: float
) -> Row:
    """What `observe` and the selectors that use it read: ``first`` | window | mode | low | high | ``others``."""
    length = HALF if isinstance(window, str) else float(window)
    low, high = bounds or (0.0, 1.0)
    return np.array([first, length, mode_of(normalise), low, high, *others])


def window_state(num_learners: int, num_episodes: int, window: str | int, normalise: str) -> Row:
    """The common blocks and an empty window with room for the longest that can come."""
    longest = num_episodes // 2 + 1 if isinstance(window, str) else min(window, num_episodes)
    block = windows.new_window(num_learners, longest + 1, tracks_extremes=normalise == "minmax_window")
    return np.concatenate([header(num_learners), block])


@dataclass(frozen=True, config=SELECTOR_CONFIG)
class Ssbas:
    """UCB1 over the last half of all selections; performances are used as they are, not normalised, by default.

    Attributes
    ----------
    exploration:
        ξ > 0, the weight of the confidence bonus; 4.921 in the dissertation (§4.3.6).
    window:
        ``half`` for the last ⌊τ/2⌋ selections, or a number of selections.
    normalise:
        ``none``, ``minmax_window`` (means are mapped to [0, 1] by the least and largest performance in the window), or
        ``fixed_bounds``.
    bounds:
        (low, high) for ``fixed_bounds``; performances beyond are clipped.
    """

    exploration: Annotated[float, Field(gt=0.0)] = 4.921
    window: Literal["half"] | Annotated[int, Field(ge=1)] = "half"
    normalise: NormaliseWindow = "none"
    bounds: Bounds | None = None

    select = staticmethod(select)
    observe = staticmethod(observe)

    def __post_init__(self) -> None:
        check_bounds(self.normalise, self.bounds)

    def parameters(self) -> Row:
        """``float64[5]``: ξ, window (0: half), mode, low, high."""
        return window_parameters(self.exploration, self.window, self.normalise, self.bounds)

    def initial_state(self, num_learners: int, num_episodes: int) -> Row:
        """``float64[5 · learners + 8 + 2 · capacity]``, 4 · capacity where extremes are tracked.

        Capacity is ⌊episodes/2⌋ + 2, or min(window, episodes) + 1; the window is what needs memory.
        """
        return window_state(num_learners, num_episodes, self.window, self.normalise)
