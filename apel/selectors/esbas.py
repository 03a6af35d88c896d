"""ESBAS: epochal stochastic bandit algorithm selection (Laroche & Féraud 2018, arXiv 1701.08810; Algorithm 6).

Epoch β has 2^β episodes, the 0-based episodes 2^β − 1 … 2^(β+1) − 2, and a UCB1 of its own that knows nothing of the
epochs before. Within an epoch the learners' policies do not change: a selector cannot see to that, but says so
(`Esbas.freezes_policies`). Algorithm 6 prints 𝒟_{2^(β−1)}, the set a policy is learnt on; it should be 𝒟_{2^β − 1}, all
episodes before the epoch.
"""

from __future__ import annotations

from typing import Annotated, ClassVar

import numpy as np
from pydantic import Field
from pydantic.dataclasses import dataclass

from apel.selection import SELECTOR_CONFIG, Row, compiled_observe
from apel.selectors.normalising import Normalise
from apel.selectors.ucb import Ucb1, count_episode

# The state is UCB1's, then: episodes played in this epoch | its length.


@compiled_observe
def _observe(parameters: Row, num_learners: int, state: Row, selected: int, performance: float) -> None:
    """UCB1's update; after the last episode of an epoch all counts and sums are 0, and the next is twice as long."""
    count_episode(parameters, num_learners, state, selected, performance)
    epoch = 5 * num_learners + 2
    state[epoch] += 1.0
    if state[epoch] >= state[epoch + 1]:
        state[epoch - 2 * num_learners : epoch + 1] = 0.0
        state[epoch + 1] *= 2.0


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

    observe = staticmethod(_observe)

    def initial_state(self, num_learners: int, num_episodes: int) -> Row:
        """``float64[5 · learners + 4]``."""
        return np.concatenate([super().initial_state(num_learners, num_episodes), [0.0, 1.0]])
