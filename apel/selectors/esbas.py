"""ESBAS: epochal stochastic bandit algorithm selection (Laroche & Féraud 2018, arXiv 1701.08810; Algorithm 6).

Epoch β has 2^β episodes, the 0-based episodes 2^β − 1 … 2^(β+1) − 2, and a UCB1 of its own that knows nothing of the
epochs before. Within an epoch the learners' policies do not change: a selector cannot see to that, but says so
(`Esbas.freezes_policies`). Algorithm 6 prints 𝒟_{2^(β−1)}, the set a policy is learnt on; it should be 𝒟_{2^β − 1}, all
episodes before the epoch.
"""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, NamedTuple

from pydantic import Field
from pydantic.dataclasses import dataclass

from apel.numerics.views import Layout, Row
from apel.run.selection import SELECTOR_CONFIG, compiled_observe, new_state
from apel.selectors.normalising import Normalise, range_of
from apel.selectors.ucb import Ucb1, count_episode


class EsbasState(NamedTuple):
    """UCB1's, then the epoch."""

    probability: Row
    performance_estimate: Row
    concentration: Row
    limits: Row
    num_selections: Row
    performance_sum: Row
    played: Row
    """``float64[1]``: episodes played in this epoch."""
    length: Row
    """``float64[1]``: that of this epoch, in episodes."""


_LAYOUT = Layout(EsbasState, limits=2, played=1, length=1)
_state = _LAYOUT.view


@compiled_observe
def _observe(parameters: Row, num_learners: int, row: Row, selected: int, performance: float) -> None:
    """UCB1's update; after the last episode of an epoch all counts and sums are 0, and the next is twice as long."""
    count_episode(parameters, num_learners, row, selected, performance)
    state = _state(row, num_learners)
    state.played[0] += 1.0
    if state.played[0] >= state.length[0]:
        state.num_selections[:] = state.performance_sum[:] = state.played[:] = 0.0
        state.length[0] *= 2.0


@dataclass(frozen=True, config=SELECTOR_CONFIG)
class Esbas(Ucb1):
    """UCB1 anew in every epoch, epochs of 1, 2, 4, 8, … episodes (Algorithm 6).

    Attributes
    ----------
    exploration:
        ξ > 0; 1/4 in the paper's experiments.
    normalise:
        ``none`` as in Algorithm 6, ``minmax`` (the range of all epochs so far) or ``fixed_bounds``.
    bounds:
        (low, high) for ``fixed_bounds``; performances beyond are clipped.
    """

    freezes_policies: ClassVar[bool] = True
    """Learners act, within an epoch, by the policies they had at its start."""

    exploration: Annotated[float, Field(gt=0.0)] = 0.25
    normalise: Normalise = "none"

    layout: ClassVar[Layout[Any]] = _LAYOUT

    observe = staticmethod(_observe)

    def initial_state(self, num_learners: int, num_episodes: int) -> Row:
        """``float64[5 · learners + 4]``."""
        return new_state(self.layout, num_learners, limits=range_of(self.normalise, self.bounds), length=1.0)
