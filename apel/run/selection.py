"""What a selector is: two pure functions over one run's state.

A selector is a state machine with no I/O, no clock and no global random state. Its whole state for one run is a row of
numbers, ``float64[…]``, that opens with the `CommonBlocks`, which every selector keeps and the result files show. What
a row holds is declared once (`apel.numerics.views.Layout`), and read and written by name everywhere.

``select`` draws the learner of the coming episode; ``observe`` takes in how that episode went. The two shipped
functions of a selector are compiled (`KernelFunction`), so that a learner's host can go on selecting inside a
compiled streak. A user's own rule is plain Python (`apel.run.rule`), at the price of leaving the compiled loop every
episode.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from types import FunctionType
from typing import Any, ClassVar, NamedTuple, Protocol, cast, runtime_checkable

import numpy as np
from numba import float64, int64, uint64, void
from numpy.typing import NDArray
from pydantic import ConfigDict

from apel.numerics.compiled import KernelFunction, njit
from apel.numerics.views import Layout, Row

SELECTOR_CONFIG = ConfigDict(extra="forbid", allow_inf_nan=False)
"""Options of a selector are checked when it is made, and unknown ones refused."""

SELECT_SIGNATURE = int64(float64[::1], int64, float64[::1], uint64[::1])
OBSERVE_SIGNATURE = void(float64[::1], int64, float64[::1], int64, float64)

# select(parameters, num_learners, row, stream) -> learner
Select = Callable[[Row, int, Row, NDArray[np.uint64]], int]
# observe(parameters, num_learners, row, selected, performance)
Observe = Callable[[Row, int, Row, int, float], None]


class CommonBlocks(NamedTuple):
    """What every state opens with, ``float64[learners]`` each."""

    probability: Row
    """With which each learner was to be selected for the coming episode."""
    performance_estimate: Row
    """r̂, each learner's latest performance (NaN: not selected yet)."""
    concentration: Row
    """The Dirichlet's parameters (NaN for selectors that have none)."""


COMMON = Layout(CommonBlocks)
"""The layout of a state that holds nothing else."""
common_blocks = COMMON.view


def new_state(layout: Layout[Any], num_learners: int, **values: float | Sequence[float] | Row) -> Row:
    """The row of a state: uniform probabilities, no estimates, no concentrations, else 0 where no value is given."""
    common = {"probability": 1.0 / num_learners, "performance_estimate": np.nan, "concentration": np.nan}
    return layout.row(num_learners, **{**common, **values})


@runtime_checkable
class Selector(Protocol):
    """Picks one learner per episode (§3.2–3.4)."""

    def parameters(self) -> Row:
        """The numbers that both functions receive, ``float64[parameters]``."""
        ...

    def initial_state(self, num_learners: int, num_episodes: int) -> Row:
        """State of a run before its first episode; ``num_episodes`` bounds any memory of the past."""
        ...

    @property
    def select(self) -> Select:
        """``(parameters, num_learners, row, stream) → learner``; writes ``probability`` into the state."""
        ...

    @property
    def observe(self) -> Observe:
        """``(parameters, num_learners, row, selected, performance) → None``; updates the state in place."""
        ...


@runtime_checkable
class Epochal(Protocol):
    """A selector that may want its learners' policies frozen within each epoch of 2^β episodes (ESBAS, Algorithm 6).

    The learners go on learning from every episode; what they learned they act on from the next epoch on.
    """

    freezes_policies: ClassVar[bool]


def freezes_policies(selector: object) -> bool:
    """Whether learners act with the policies that they had at the beginning of the epoch."""
    return isinstance(selector, Epochal) and selector.freezes_policies


@njit(inline="always")
def starts_epoch(episode: int) -> bool:
    """Whether an epoch of 2^β episodes begins: at the episodes 0, 1, 3, 7, … (Algorithm 6)."""
    return ((episode + 1) & episode) == 0


def compiled_select(function: Select) -> KernelFunction:
    """Compile a ``select`` function."""
    return KernelFunction(cast("FunctionType", function), SELECT_SIGNATURE)


def compiled_observe(function: Observe) -> KernelFunction:
    """Compile an ``observe`` function."""
    return KernelFunction(cast("FunctionType", function), OBSERVE_SIGNATURE)
