"""A selector as a user writes one: plain Python functions, nothing compiled."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from apel.numerics.views import Row
from apel.run.selection import Observe, Select, Selector


@dataclass(frozen=True)
class PlainSelector:
    """The same decisions as ``shipped``, behind plain functions."""

    shipped: Selector

    def parameters(self) -> Row:
        """Those of the shipped one."""
        return self.shipped.parameters()

    def initial_state(self, num_learners: int, num_episodes: int) -> Row:
        """That of the shipped one."""
        return self.shipped.initial_state(num_learners, num_episodes)

    @property
    def select(self) -> Select:
        """A function that numba has never seen."""

        def select(parameters: Row, num_learners: int, state: Row, stream: NDArray[np.uint64]) -> int:
            return self.shipped.select(parameters, num_learners, state, stream)

        return select

    @property
    def observe(self) -> Observe:
        """A function that numba has never seen."""

        def observe(parameters: Row, num_learners: int, state: Row, selected: int, performance: float) -> None:
            self.shipped.observe(parameters, num_learners, state, selected, performance)

        return observe
