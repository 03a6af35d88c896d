"""What deep learners draw, from the streams of their runs (`apel.numerics.streams`)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from apel.learners.base import State
from apel.numerics.compiled import njit
from apel.numerics.streams import Stream, integer, stream_of_seed, uniform

_SAMPLING = 0x5851F42D4C957F2D


class Streams(NamedTuple):
    """Both streams of each run's learner, ``uint64[R, 2]`` each: of its actions, and of what it draws from memory."""

    acting: NDArray[np.uint64]
    sampling: NDArray[np.uint64]

    @classmethod
    def of_seeds(cls, seeds: Sequence[int]) -> Streams:
        """Those that follow from a 64-bit seed per run."""
        pairs = ([stream_of_seed(seed) for seed in seeds], [stream_of_seed(seed ^ _SAMPLING) for seed in seeds])
        return cls(*(np.stack(streams) for streams in pairs))

    def state(self) -> State:
        """Where they are."""
        return {"acting": self.acting.copy(), "sampling": self.sampling.copy()}

    def restore(self, state: State) -> None:
        """Go back to what `state` returned."""
        self.acting[:], self.sampling[:] = state["acting"], state["sampling"]


@njit
def draw_epsilon_greedy(values: Any, exploration: float, stream: Stream, probability: NDArray[np.float64]) -> int:
    """ε-greedy on ``values`` ``[actions]``, the first of equally good actions being the greedy one: the action; the
    probabilities of all are written.
    """
    num_actions = probability.shape[0]
    greedy = int(np.argmax(values[:num_actions]))
    probability[:] = exploration / num_actions
    probability[greedy] += 1.0 - exploration
    if uniform(stream) < exploration:
        return integer(stream, num_actions)
    return greedy
