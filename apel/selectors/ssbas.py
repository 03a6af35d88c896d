"""SSBAS: sliding stochastic bandit algorithm selection (Laroche & Féraud 2018, arXiv 1701.08810; §5.1).

At meta-time τ (the number of past selections) UCB1 is played over the last ⌊τ/2⌋ selections. The window's counts and
sums are carried along, so that an episode costs O(1) whatever the window's length (`apel.selectors.windows`). With a
window of constant length this is SW-UCB, which shares the two functions.
"""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from pydantic.dataclasses import dataclass

from apel.numerics.compiled import njit
from apel.numerics.views import REST, Layout, Row, named_numbers
from apel.run.selection import SELECTOR_CONFIG, compiled_observe, compiled_select, new_state
from apel.selectors import windows
from apel.selectors.indices import pick_largest, upper_confidence_bounds
from apel.selectors.normalising import FIXED, Bounds, check_bounds, mode_of
from apel.selectors.windows import Window, new_window, view_window

NormaliseWindow = Literal["none", "minmax_window", "fixed_bounds"]
"""Raw performances, the range of those in the window, or given bounds (with clipping)."""

HALF = 0.0
"""The window parameter that stands for ⌊τ/2⌋."""


class WindowOptions(NamedTuple):
    """What rules over a window go by."""

    exploration: float
    length: float
    """In episodes, or `HALF`."""
    mode: float
    low: float
    high: float


class WindowState(NamedTuple):
    """The common blocks, then a window."""

    probability: Row
    performance_estimate: Row
    concentration: Row
    window: Row
    """See `apel.selectors.windows`."""


LAYOUT = Layout(WindowState, window=REST)
view_state, view_options = LAYOUT.view, named_numbers(WindowOptions)


@njit
def scale(options: WindowOptions, window: Window) -> tuple[float, float]:
    """Low and high of the performances: given, or those of the window."""
    return (options.low, options.high) if options.mode == FIXED else windows.extremes(window)


@compiled_select
def select(parameters: Row, num_learners: int, row: Row, stream: NDArray[np.uint64]) -> int:
    """A learner missing from the window first, else argmax x̄ₖ + √(ξ ln n / nₖ); ties uniformly at random."""
    options, state = view_options(parameters), view_state(row, num_learners)
    index, window = state.probability, view_window(state.window, num_learners)
    low, high = scale(options, window)
    total = float(windows.episodes_inside(window))
    upper_confidence_bounds(options.exploration, total, window.num_selections, window.performance_sum, low, high, index)
    return pick_largest(index, stream)


@compiled_observe
def observe(parameters: Row, num_learners: int, row: Row, selected: int, performance: float) -> None:
    """Append (learner, performance), advance τ, and drop what has left the window."""
    options, state = view_options(parameters), view_state(row, num_learners)
    window = view_window(state.window, num_learners)
    state.performance_estimate[selected] = performance
    if options.mode == FIXED:
        performance = min(max(performance, options.low), options.high)
    windows.append(window, selected, performance)
    past = windows.past_episodes(window)
    length = past // 2 if options.length == HALF else min(past, int(options.length))
    windows.drop_before(window, past - length)


def window_options(
    exploration: float, window: str | int, normalise: str, bounds: tuple[float, float] | None
) -> WindowOptions:
    """What `observe` and the selectors that use it read."""
    length = HALF if isinstance(window, str) else float(window)
    low, high = bounds or (0.0, 1.0)
    return WindowOptions(exploration, length, mode_of(normalise), low, high)


def window_state(num_learners: int, num_episodes: int, window: str | int, normalise: str) -> Row:
    """The common blocks and an empty window with room for the longest that can come."""
    longest = num_episodes // 2 + 1 if isinstance(window, str) else min(window, num_episodes)
    window_block = new_window(num_learners, longest + 1, tracks_extremes=normalise == "minmax_window")
    return new_state(LAYOUT, num_learners, window=window_block)


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

    layout: ClassVar[Layout[Any]] = LAYOUT

    select = staticmethod(select)
    observe = staticmethod(observe)

    def __post_init__(self) -> None:
        check_bounds(self.normalise, self.bounds)

    def parameters(self) -> Row:
        """``float64[5]``: ξ, window (0: half), mode, low, high."""
        return np.array(window_options(self.exploration, self.window, self.normalise, self.bounds))

    def initial_state(self, num_learners: int, num_episodes: int) -> Row:
        """``float64[5 · learners + 8 + 2 · capacity]``, 4 · capacity where extremes are tracked.

        Capacity is ⌊episodes/2⌋ + 2, or min(window, episodes) + 1; the window is what needs memory.
        """
        return window_state(num_learners, num_episodes, self.window, self.normalise)
