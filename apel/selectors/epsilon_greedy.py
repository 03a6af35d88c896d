"""ε-greedy on the latest performances: what APEL is without its Dirichlet distribution (§2.2)."""

from __future__ import annotations

import math
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from pydantic.dataclasses import dataclass

from apel.numerics.views import Row, named_numbers
from apel.run.selection import COMMON, SELECTOR_CONFIG, common_blocks, compiled_select, new_state
from apel.selectors.constant import observe
from apel.selectors.indices import pick_largest_or_any


class EpsilonGreedyOptions(NamedTuple):
    """What the rule goes by."""

    epsilon: float


_options = named_numbers(EpsilonGreedyOptions)


@compiled_select
def _select(parameters: Row, num_learners: int, row: Row, stream: NDArray[np.uint64]) -> int:
    """With probability ε any learner, else one without an estimate, else argmax r̂; ties uniformly at random."""
    state = common_blocks(row, num_learners)
    index = state.probability
    for k in range(num_learners):
        estimate = state.performance_estimate[k]
        index[k] = np.inf if math.isnan(estimate) else estimate
    return pick_largest_or_any(_options(parameters).epsilon, index, stream)


@dataclass(frozen=True, config=SELECTOR_CONFIG)
class EpsilonGreedy:
    """With probability ε any learner, else the one whose latest performance is best; those not yet selected first.

    Attributes
    ----------
    epsilon:
        ε, the share of uniform selections; never decayed.
    """

    epsilon: Annotated[float, Field(ge=0.0, le=1.0)] = 0.1

    select = staticmethod(_select)
    observe = staticmethod(observe)

    def parameters(self) -> Row:
        """``float64[1]``: ε."""
        return np.array(EpsilonGreedyOptions(self.epsilon))

    def initial_state(self, num_learners: int, num_episodes: int) -> Row:
        """``float64[3 · learners]``."""
        return new_state(COMMON, num_learners)
