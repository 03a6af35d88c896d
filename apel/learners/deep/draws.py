"""What deep learners draw, from the streams of their runs (`apel.streams`)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from apel.batched import Runs
from apel.compiled import njit
from apel.streams import categorical, integer, stream_of_seed, uniform

Streams = NDArray[np.uint64]
"""``uint64[R, 2]``."""
_SAMPLING = 0x5851F42D4C957F2D


def acting_streams(seeds: Sequence[int]) -> Streams:
    """The streams from which actions are drawn."""
    return np.stack([stream_of_seed(seed) for seed in seeds])


def sampling_streams(seeds: Sequence[int]) -> Streams:
    """Other streams of the same seeds, from which minibatches are drawn."""
    return np.stack([stream_of_seed(seed ^ _SAMPLING) for seed in seeds])


class LearnerStreams:
    """Both streams of each run's learner.

    Attributes
    ----------
    acting, sampling:
        See `acting_streams` and `sampling_streams`.
    """

    def __init__(self, seeds: Sequence[int]) -> None:
        self.acting, self.sampling = acting_streams(seeds), sampling_streams(seeds)

    def state(self) -> list[Streams]:
        """Where they are."""
        return [self.acting.copy(), self.sampling.copy()]

    def restore(self, state: Sequence[Streams]) -> None:
        """Go back to what `state` returned."""
        self.acting, self.sampling = (np.array(streams) for streams in state)


@njit
def draw_epsilon_greedy(
    values: NDArray[np.float32], exploration: NDArray[np.float64], runs: Runs, streams: Streams
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """ε-greedy on ``values`` ``[A, actions]``, the first of equally good actions being the greedy one: actions ``[A]``,
    and the probabilities of all, ``[A, actions]``.
    """
    num_runs, num_actions = values.shape
    actions, probability = np.empty(num_runs, dtype=np.int64), np.empty((num_runs, num_actions))
    for i in range(num_runs):
        greedy = np.argmax(values[i])
        probability[i, :] = exploration[i] / num_actions
        probability[i, greedy] += 1.0 - exploration[i]
        actions[i] = greedy
        stream = streams[runs[i]]
        if uniform(stream) < exploration[i]:
            actions[i] = integer(stream, num_actions)
    return actions, probability


@njit
def draw_categorical(probability: NDArray[np.float64], runs: Runs, streams: Streams) -> NDArray[np.int64]:
    """One action ``[A]`` of each row of ``probability`` ``[A, actions]``."""
    actions = np.empty(runs.shape[0], dtype=np.int64)
    for i in range(runs.shape[0]):
        actions[i] = categorical(streams[runs[i]], probability[i])
    return actions


@njit
def draw_indices(size: NDArray[np.int64], runs: Runs, count: int, streams: Streams) -> NDArray[np.int64]:
    """``int64[A, count]``, drawn from {0, …, ``size[run]`` − 1} with replacement."""
    indices = np.empty((runs.shape[0], count), dtype=np.int64)
    for i in range(runs.shape[0]):
        for j in range(count):
            indices[i, j] = integer(streams[runs[i]], size[runs[i]])
    return indices


def softmax(logits: NDArray[np.float32]) -> NDArray[np.float64]:
    """Probabilities of each row ``[A, actions]``, in double precision so that they sum to 1 as the draws need."""
    weights = np.exp(logits.astype(np.float64) - logits.max(axis=1, keepdims=True))
    return weights / weights.sum(axis=1, keepdims=True)
