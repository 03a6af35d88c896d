"""APEL: adaptive probabilistic ensemble learning (Algorithm 5, §3.1–3.4)."""

from __future__ import annotations

from dataclasses import field
from typing import Annotated, Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from pydantic.dataclasses import dataclass

from apel.numerics.compiled import njit
from apel.numerics.streams import categorical, dirichlet
from apel.numerics.views import Layout, Row, named_numbers
from apel.run.selection import COMMON, SELECTOR_CONFIG, common_blocks, compiled_observe, compiled_select, new_state


class ApelOptions(NamedTuple):
    """What Algorithm 5 goes by."""

    decay: float
    """ν."""
    counts_ties: float
    """0 or 1."""


_options = named_numbers(ApelOptions)


@compiled_select
def _select(parameters: Row, num_learners: int, row: Row, stream: NDArray[np.uint64]) -> int:
    """P ~ Dirichlet(c), L ~ Categorical(p) (Eq. 3.2, 3.3)."""
    state = common_blocks(row, num_learners)
    dirichlet(stream, state.concentration, state.probability)
    return categorical(stream, state.probability)


@njit
def _is_best(estimate: Row, selected: int, performance: float, counts_ties: bool) -> bool:
    """Whether ``performance`` is above all other learners' estimates, ``float64[learners]``, or, with ties, at them."""
    for other in range(estimate.shape[0]):
        # Written so that a comparison with NaN (not selected yet) counts as "not best": nothing is
        # incremented before every learner has been selected once.
        above = performance > estimate[other] or (counts_ties and performance == estimate[other])
        if other != selected and not above:
            return False
    return True


@njit
def update(parameters: Row, num_learners: int, row: Row, selected: int, performance: float, increment: float) -> None:
    """r̂_L ← performance; c_L ← c_L + ``increment`` if L is best; c ← max(c (1 − ν), 1) (Eq. 3.4, 3.5)."""
    options, state = _options(parameters), common_blocks(row, num_learners)
    state.performance_estimate[selected] = performance
    if _is_best(state.performance_estimate, selected, performance, options.counts_ties != 0.0):
        state.concentration[selected] += increment
    for k in range(num_learners):
        state.concentration[k] = max(state.concentration[k] * (1.0 - options.decay), 1.0)


@compiled_observe
def _observe(parameters: Row, num_learners: int, row: Row, selected: int, performance: float) -> None:
    """Increments of 1, for a learner that is strictly best unless ties count."""
    update(parameters, num_learners, row, selected, performance, 1.0)


@dataclass(frozen=True, config=SELECTOR_CONFIG)
class Apel:
    """Selects by a Dirichlet distribution whose concentrations follow the latest performances (Algorithm 5).

    Attributes
    ----------
    decay:
        ν, 0 ≤ ν < 1: the share of each concentration that is forgotten after every episode.
    prior:
        Initial concentrations, one per learner, each at least 1; all 1 where empty (§3.1.2).
    tie_increment:
        Whether a tie with the best other estimate counts as a win of the selected learner. Eq. 3.4 is strict; but where
        performances reach a ceiling nobody is strictly best, and all concentrations decay to 1.
    """

    decay: Annotated[float, Field(ge=0.0, lt=1.0)] = 0.01
    prior: tuple[Annotated[float, Field(ge=1.0)], ...] = field(default=())
    tie_increment: bool = False

    layout: ClassVar[Layout[Any]] = COMMON

    select = staticmethod(_select)
    observe = staticmethod(_observe)

    def parameters(self) -> Row:
        """``float64[2]``: ν, whether ties count."""
        return np.array(ApelOptions(self.decay, self.tie_increment))

    def initial_state(self, num_learners: int, num_episodes: int) -> Row:
        """``float64[3 · learners]``: nothing beyond the common blocks."""
        if self.prior and len(self.prior) != num_learners:
            message = f"prior: found {len(self.prior)} concentrations, expected one per learner, {num_learners}"
            raise ValueError(message)
        return new_state(self.layout, num_learners, concentration=self.prior or 1.0)
