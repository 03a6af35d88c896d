"""Environments of several runs in lockstep: what drives them and what plays them agree on this module alone.

Every call concerns several runs at once, named by their positions in the shard, and leaves the others alone.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

Runs = NDArray[np.int64]
"""``int64[A]``: positions in the shard, each at most once, in rising order."""

ENVIRONMENTS = "environments"
"""Of a state: what its environments carry over from one episode to the next."""


class Stepped(NamedTuple):
    """What one step of A environments gave."""

    entry: NDArray[Any]
    """``[A, …]``: as observations stand in trajectories."""
    reward: NDArray[np.float64]
    terminated: NDArray[np.bool_]
    truncated: NDArray[np.bool_]
    errors: Mapping[int, BaseException] = {}
    """By position in the call: what a user's environment raised. The other fields are zero there."""

    def at(self, positions: NDArray[np.int64]) -> Stepped:
        """The outcome at some positions, at which nothing was raised."""
        return Stepped(
            self.entry[positions], self.reward[positions], self.terminated[positions], self.truncated[positions]
        )


class BatchedEnvironment(Protocol):
    """The environments of R runs, of which any few can be stepped at once."""

    def reset(self, runs: Runs, seeds: Sequence[int]) -> Stepped:
        """Start an episode of each run with its seed; rewards are zero."""
        ...

    def step(self, runs: Runs, actions: NDArray[np.int64]) -> Stepped:
        """Play one action, counted from 0, in each run."""
        ...

    def decode(self, entries: NDArray[Any]) -> NDArray[Any]:
        """The raw observations ``[…, features]`` of entries of trajectories."""
        ...


@runtime_checkable
class CarriesState(Protocol):
    """Environments that may carry something over from one episode to the next; others start afresh with each."""

    def state(self) -> dict[str, Any]:
        """All of it, between two episodes, as a checkpoint holds it: one entry, `ENVIRONMENTS`."""
        ...

    def restore(self, state: dict[str, Any]) -> None:
        """Go back to what `state` returned."""
        ...
