"""APEL: adaptive probabilistic ensemble learning (Algorithm 5, §3.1–3.4)."""

from __future__ import annotations

from dataclasses import field
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from pydantic.dataclasses import dataclass

from apel.compiled import njit
from apel.selection import SELECTOR_CONFIG, Row, compiled_observe, compiled_select, header
from apel.streams import categorical, dirichlet


@compiled_select
def _select(parameters: Row, num_learners: int, state: Row, stream: NDArray[np.uint64]) -> int:
    """P ~ Dirichlet(c), L ~ Categorical(p) (Eq. 3.2, 3.3)."""
    probability = state[:num_learners]
    dirichlet(stream, state[2 * num_learners : 3 * num_learners], probability)
    return categorical(stream, probability)


@njit
def is_best(parameters: Row, estimate: Row, selected: int, performance: float) -> bool:
    """Whether ``performance`` is above all other learners' estimates, ``float64[learners]``, or, with ties, at them."""
    counts_ties = parameters[1] != 0.0
    for other in range(estimate.shape[0]):
        # Written so that a comparison with NaN (not selected yet) counts as "not best": nothing is
        # incremented before every learner has been selected once.
        above = performance > estimate[other] or (counts_ties and performance == estimate[other])
        if other != selected and not above:
            return False
    return True


@njit
def forget(parameters: Row, concentration: Row) -> None:
    """C ← max(c (1 − ν), 1), ``float64[learners]``, in place (Eq. 3.5)."""
    for i in range(concentration.shape[0]):
        concentration[i] = max(concentration[i] * (1.0 - parameters[0]), 1.0)


@compiled_observe
def _observe(parameters: Row, num_learners: int, state: Row, selected: int, performance: float) -> None:
    """r̂_L ← performance; c_L ← c_L + 1 if L is strictly best; c ← max(c (1 − ν), 1) (Eq. 3.4, 3.5)."""
    estimate = state[num_learners : 2 * num_learners]
    concentration = state[2 * num_learners : 3 * num_learners]
    estimate[selected] = performance
    if is_best(parameters, estimate, selected, performance):
        concentration[selected] += 1.0
    forget(parameters, concentration)


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

    select = staticmethod(_select)
    observe = staticmethod(_observe)

    def parameters(self) -> Row:
        """``float64[2]``: ν, whether ties count."""
        return np.array([self.decay, self.tie_increment])

    def initial_state(self, num_learners: int, num_episodes: int) -> Row:
        """``float64[3 · learners]``: nothing beyond the common blocks."""
        state = header(num_learners, concentration=1.0)
        if self.prior:
            if len(self.prior) != num_learners:
                message = f"prior: found {len(self.prior)} concentrations, expected one per learner, {num_learners}"
                raise ValueError(message)
            state[2 * num_learners :] = self.prior
        return state
