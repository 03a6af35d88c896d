"""What a coordinator needs of the outside: hosts that play, a place for rows, and one for checkpoints."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from apel.agents.content import AgentContent
from apel.learners.base import Failure, Played, State
from apel.run.state import EpisodeRows
from cluster.shard import Execution, Shard


@dataclass(frozen=True)
class RunRows:
    """One row per finished run of a shard."""

    position: NDArray[np.int64]
    """Which run of the shard."""
    train_time: NDArray[np.int64]
    """Episodes until the criterion held; the number of episodes played where it never did."""
    censored: NDArray[np.bool_]
    """The criterion never held."""
    episodes: NDArray[np.int64]
    steps: NDArray[np.int64]
    steady_state: NDArray[np.float64]
    """Mean return of the last episodes before the cap; NaN where nobody asked for it, or the run ended before."""
    last_tenth_return: NDArray[np.float64]
    """Mean return of the last tenth of the run, see `cluster.last_tenth`; NaN where it ended before its cap."""
    info: tuple[dict[str, float], ...]


_NOTHING = np.zeros(0, dtype=np.int64)
NO_RUN_ROWS = RunRows(_NOTHING, _NOTHING, np.zeros(0, dtype=np.bool_), _NOTHING, _NOTHING, np.zeros(0), np.zeros(0), ())


class Hosts(Protocol):
    """The learner hosts of a shard, wherever they are."""

    def prepare(self, shard: Shard, execution: Execution, states: Sequence[State] | None) -> None:
        """Make host i ready for learner i of the shard."""
        ...

    def play(self, orders: Sequence[Sequence[int]]) -> list[Played]:
        """One round: host i learns from what the others played last, then plays the runs ``orders[i]``."""
        ...

    def catch_up(self) -> list[tuple[Failure, ...]]:
        """All hosts learn from what the others played last; where that failed."""
        ...

    def states(self) -> list[tuple[State, tuple[Failure, ...]]]:
        """The states of all hosts, after they have learned from what the others played last, and where that failed."""
        ...

    def models(self, runs: Sequence[int]) -> list[tuple[list[State], tuple[Failure, ...]]]:
        """The learners of ``runs`` of every host, as `LearnerHost.models` gives them."""
        ...

    def close(self) -> None:
        """Close the environments; what was prepared is over."""
        ...


class ResultSink(Protocol):
    """Where a shard's rows go. Nothing is seen before `commit`."""

    def spill(self, shard: Shard, part: int, rows: Sequence[EpisodeRows]) -> str:
        """Put rows aside, in a place that is overwritten if the part is written again; returns their checksum."""
        ...

    def commit(self, shard: Shard, runs: RunRows, parts: Sequence[str], rows: Sequence[EpisodeRows]) -> None:
        """Store the rows of the finished runs: those put aside, whose checksums are ``parts``, then ``rows``.

        Raises
        ------
        CheckpointError
            If what was put aside is not there any more as it was.
        """
        ...

    def keep(self, shard: Shard, position: int, mark: str, model: AgentContent) -> None:
        """Store what a run has come to at ``mark``, such as its end; it replaces what was stored there.

        Raises
        ------
        CheckpointError
            If a learner's state is nothing that can be stored.
        """
        ...


class CheckpointStore(Protocol):
    """Where a shard's checkpoint lies: at most one, replaced as a whole."""

    def read(self, shard: Shard) -> bytes | None:
        """The last checkpoint, or None."""
        ...

    def write(self, shard: Shard, content: bytes) -> None:
        """Replace it."""
        ...

    def delete(self, shard: Shard) -> None:
        """Forget it."""
        ...
