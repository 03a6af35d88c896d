"""APEL: adaptive probabilistic ensemble learning (Algorithm 5, §3.1–3.4)."""

from __future__ import annotations

from dataclasses import field
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from pydantic.dataclasses import dataclass

from apel.selection import SELECTOR_CONFIG, Row, compiled_observe, compiled_select, header
from apel.streams import categorical, dirichlet


@compiled_select
def _select(parameters: Row, num_learners: int, state: Row, stream: NDArray[np.uint64]) -> int:
    """P ~ Dirichlet(c), L ~ Categorical(p) (Eq. 3.2, 3.3)."""
    probability = state[:num_learners]
    dirichlet(stream, state[2 * num_learners : 3 * num_learners], probability)
    return categorical(stream, probability)


@compiled_observe
def _observe(parameters: Row, num_learners: int, state: Row, selected: int, performance: float) -> None:
    """r̂_L ← performance; c_L ← c_L + 1 if L is strictly best; c ← max(c (1 − ν), 1) (Eq. 3.4, 3.5)."""
    decay = parameters[0]
    estimate = state[num_learners : 2 * num_learners]
    concentration = state[2 * num_learners : 3 * num_learners]
    estimate[selected] = performance
    best = True
    for other in range(num_learners):
        # Written so that a comparison with NaN (not selected yet) counts as "not best": nothing is
        # incremented before every learner has been selected once.
        if other != selected and not performance > estimate[other]:
            best = False
    if best:
        concentration[selected] += 1.0
    for i in range(num_learners):
        concentration[i] = max(concentration[i] * (1.0 - decay), 1.0)


@dataclass(frozen=True, config=SELECTOR_CONFIG)
class Apel:
    """Selects by a Dirichlet distribution whose concentrations follow the latest performances (Algorithm 5).

    Attributes
    ----------
    decay:
        ν, 0 ≤ ν < 1: the share of each concentration that is forgotten after every episode.
    prior:
        Initial concentrations, one per learner, each at least 1; all 1 where empty (§3.1.2).
    """

    decay: Annotated[float, Field(ge=0.0, lt=1.0)] = 0.01
    prior: tuple[Annotated[float, Field(ge=1.0)], ...] = field(default=())

    select = staticmethod(_select)
    observe = staticmethod(_observe)

    def parameters(self) -> Row:
        """``float64[1]``: ν."""
        return np.array([self.decay])

    def initial_state(self, num_learners: int, num_episodes: int) -> Row:
        """``float64[3 · learners]``: nothing beyond the common blocks."""
        state = header(num_learners, concentration=1.0)
        if self.prior:
            if len(self.prior) != num_learners:
                message = f"prior: found {len(self.prior)} concentrations, expected one per learner, {num_learners}"
                raise ValueError(message)
            state[2 * num_learners :] = self.prior
        return state
