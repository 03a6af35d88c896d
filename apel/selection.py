"""What a selector is: two pure functions over one run's state.

A selector is a state machine with no I/O, no clock and no global random state. Its whole state for one run is a row of
numbers, ``float64[…]``, that opens with three blocks of one number per learner which every selector keeps, and that the
result files show:

    probability            with which each learner was to be selected for the coming episode
    performance_estimate   r̂, each learner's latest performance (NaN: not selected yet)
    concentration          the Dirichlet's parameters (NaN for selectors that have none)

``select`` draws the learner of the coming episode; ``observe`` takes in how that episode went. The two shipped
functions of a selector are compiled (`KernelFunction`), so that a learner's host can go on selecting inside a
compiled streak; a user's own may be plain Python functions of the same arguments, at the price of leaving the
compiled loop every episode.
"""

from __future__ import annotations

from collections.abc import Callable
from types import FunctionType
from typing import ClassVar, Protocol, cast, runtime_checkable

import numpy as np
from numba import float64, int64, uint64, void
from numpy.typing import NDArray
from pydantic import ConfigDict

from apel.compiled import KernelFunction, njit

Row = NDArray[np.float64]

SELECTOR_CONFIG = ConfigDict(extra="forbid", allow_inf_nan=False)
"""Options of a selector are checked when it is made, and unknown ones refused."""

SELECT_SIGNATURE = int64(float64[::1], int64, float64[::1], uint64[::1])
OBSERVE_SIGNATURE = void(float64[::1], int64, float64[::1], int64, float64)

# select(parameters, num_learners, state, stream) -> learner
Select = Callable[[Row, int, Row, NDArray[np.uint64]], int]
# observe(parameters, num_learners, state, selected, performance)
Observe = Callable[[Row, int, Row, int, float], None]


@runtime_checkable
class Selector(Protocol):
    """Picks one learner per episode (§3.2–3.4; spec of the state above)."""

    def parameters(self) -> Row:
        """The numbers that both functions receive, ``float64[parameters]``."""
        ...

    def initial_state(self, num_learners: int, num_episodes: int) -> Row:
        """State of a run before its first episode; ``num_episodes`` bounds any memory of the past."""
        ...

    @property
    def select(self) -> Select:
        """``(parameters, num_learners, state, stream) → learner``; writes ``probability`` into the state."""
        ...

    @property
    def observe(self) -> Observe:
        """``(parameters, num_learners, state, selected, performance) → None``; updates the state in place."""
        ...


@runtime_checkable
class Epochal(Protocol):
    """A selector that may want its learners' policies frozen within each epoch of 2^β episodes (ESBAS, Algorithm 6).

    The learners go on learning from every episode; what they learned they act on from the next epoch on.
    """

    freezes_policies: ClassVar[bool]


def freezes_policies(selector: Selector) -> bool:
    """Whether learners act with the policies that they had at the beginning of the epoch."""
    return isinstance(selector, Epochal) and selector.freezes_policies


@njit(inline="always")
def starts_epoch(episode: int) -> bool:
    """Whether an epoch of 2^β episodes begins: at the episodes 0, 1, 3, 7, … (Algorithm 6)."""
    return ((episode + 1) & episode) == 0


def header(num_learners: int, concentration: float = np.nan) -> Row:
    """The three blocks that open every state: uniform probabilities, no estimates, equal concentrations."""
    blocks = (np.full(num_learners, value) for value in (1.0 / num_learners, np.nan, concentration))
    return np.concatenate(list(blocks))


def compiled_select(function: Select) -> KernelFunction:
    """Compile a ``select`` function."""
    return KernelFunction(cast("FunctionType", function), SELECT_SIGNATURE)


def compiled_observe(function: Observe) -> KernelFunction:
    """Compile an ``observe`` function."""
    return KernelFunction(cast("FunctionType", function), OBSERVE_SIGNATURE)
