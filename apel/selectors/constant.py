"""Selectors that learn nothing: always one learner, or any learner with equal chances."""

from __future__ import annotations

from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from pydantic.dataclasses import dataclass

from apel.numerics.streams import integer
from apel.numerics.views import Row, named_numbers
from apel.run.selection import COMMON, SELECTOR_CONFIG, common_blocks, compiled_observe, compiled_select, new_state


class FixedOptions(NamedTuple):
    """What `Fixed` selects by."""

    learner: float


_fixed_options = named_numbers(FixedOptions)


@compiled_select
def _select_fixed(parameters: Row, num_learners: int, row: Row, stream: NDArray[np.uint64]) -> int:
    return int(_fixed_options(parameters).learner)


@compiled_select
def _select_uniform(parameters: Row, num_learners: int, row: Row, stream: NDArray[np.uint64]) -> int:
    return integer(stream, num_learners)


@compiled_observe
def observe(parameters: Row, num_learners: int, row: Row, selected: int, performance: float) -> None:
    """r̂_L ← performance."""
    common_blocks(row, num_learners).performance_estimate[selected] = performance


@dataclass(frozen=True, config=SELECTOR_CONFIG)
class Fixed:
    """Always selects the same learner.

    Attributes
    ----------
    learner:
        Its position among the arm's learners.
    """

    learner: Annotated[int, Field(ge=0)] = 0

    select = staticmethod(_select_fixed)
    observe = staticmethod(observe)

    def parameters(self) -> Row:
        """``float64[1]``: the learner."""
        return np.array(FixedOptions(float(self.learner)))

    def initial_state(self, num_learners: int, num_episodes: int) -> Row:
        """``float64[3 · learners]``."""
        if self.learner >= num_learners:
            message = f"learner: found {self.learner}, expected a position from 0 to {num_learners - 1}"
            raise ValueError(message)
        return new_state(COMMON, num_learners, probability=np.eye(num_learners)[self.learner])


@dataclass(frozen=True, config=SELECTOR_CONFIG)
class Uniform:
    """Selects every learner with probability 1/n, whatever happens."""

    select = staticmethod(_select_uniform)
    observe = staticmethod(observe)

    def parameters(self) -> Row:
        """``float64[0]``: there are none."""
        return np.empty(0)

    def initial_state(self, num_learners: int, num_episodes: int) -> Row:
        """``float64[3 · learners]``."""
        return new_state(COMMON, num_learners)
