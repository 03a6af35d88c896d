"""A selector of one's own: a rule in plain Python that reads and writes its state by name."""

from __future__ import annotations

from collections import namedtuple
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from apel.numerics.streams import next_uint64
from apel.numerics.views import PER_LEARNER, Layout, Row
from apel.run.selection import COMMON, Selector, freezes_policies, new_state


@runtime_checkable
class SelectionRule(Protocol):
    """Who plays the coming episode, and what is remembered of the one that ended.

    ``state`` is that of one run, and all that a rule may remember: `CommonBlocks` and the rule's own ``fields``, arrays
    to be written in place.
    """

    @property
    def fields(self) -> Mapping[str, float | Sequence[float]]:
        """What the rule remembers besides, with its first values: one for every learner, or a list of any length."""
        ...

    def select(self, state: Any, rng: np.random.Generator) -> int:
        """The learner of the coming episode; with which probabilities it was drawn goes into ``state.probability``."""
        ...

    def observe(self, state: Any, selected: int, performance: float) -> None:
        """Take in an episode. ``state.performance_estimate`` is still what it was before; it is kept for the rule."""
        ...


@cache
def _layout(names: tuple[str, ...], sizes: tuple[int, ...]) -> Layout[Any]:
    state = namedtuple("state", [*COMMON.names, *names])  # type: ignore[misc]
    return Layout(state, **dict(zip(names, sizes, strict=True)))


@dataclass(frozen=True)
class RuleSelector:
    """The selector of a rule."""

    rule: SelectionRule

    @property
    def layout(self) -> Layout[Any]:
        """That of the rule's state."""
        fields = self.rule.fields
        return _layout(tuple(fields), tuple(np.size(v) if np.ndim(v) else PER_LEARNER for v in fields.values()))

    @property
    def freezes_policies(self) -> bool:
        """As the rule says, if it says so (`apel.run.selection.Epochal`)."""
        return freezes_policies(self.rule)

    def parameters(self) -> Row:
        """``float64[0]``: a rule has its own options."""
        return np.empty(0)

    def initial_state(self, num_learners: int, num_episodes: int) -> Row:
        """The common blocks, then the rule's fields."""
        return new_state(self.layout, num_learners, **self.rule.fields)

    def select(self, parameters: Row, num_learners: int, row: Row, stream: NDArray[np.uint64]) -> int:
        """Let the rule draw, from a generator that the run's stream seeds anew for every episode."""
        return int(self.rule.select(self.layout.view(row, num_learners), np.random.default_rng(next_uint64(stream))))

    def observe(self, parameters: Row, num_learners: int, row: Row, selected: int, performance: float) -> None:
        """Let the rule take in the episode; then r̂_L ← performance."""
        state = self.layout.view(row, num_learners)
        self.rule.observe(state, selected, performance)
        state.performance_estimate[selected] = performance


def as_selector(given: Selector | SelectionRule) -> Selector:
    """A selector as it is, a rule as the selector of it."""
    return given if isinstance(given, Selector) else RuleSelector(given)
