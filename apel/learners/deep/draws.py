"""What deep learners draw, from the streams of their runs (`apel.streams`)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from apel.batched import Runs
from apel.compiled import njit
from apel.streams import categorical, integer, stream_of_seed, uniform

Streams = NDArray[np.uint64]
"""``uint64[R, 2]``."""
_SAMPLING = 0x5851F42D4C957F2D


def acting_streams(seeds: list[int]) -> Streams:
    """The streams from which actions are drawn."""
    return np.stack([stream_of_seed(seed) for seed in seeds])


def sampling_streams(seeds: list[int]) -> Streams:
    """Other streams of the same seeds, from which minibatches are drawn."""
    return np.stack([stream_of_seed(seed ^ _SAMPLING) for seed in seeds])


@njit
def draw_epsilon_greedy(
    values: NDArray[np.float32],
    exploration: NDArray[np.float64],
    runs: Runs,
    streams: Streams,
    actions: NDArray[np.int64],
    probability: NDArray[np.float64],
) -> None:
    """ε-greedy on ``values`` ``[A, actions]``, the first of equally good actions being the greedy one."""
    num_actions = values.shape[1]
    for i in range(runs.shape[0]):
        greedy = np.argmax(values[i])
        probability[i, :] = exploration[i] / num_actions
        probability[i, greedy] += 1.0 - exploration[i]
        actions[i] = greedy
        stream = streams[runs[i]]
        if uniform(stream) < exploration[i]:
            actions[i] = integer(stream, num_actions)


@njit
def draw_categorical(
    probability: NDArray[np.float64], runs: Runs, streams: Streams, actions: NDArray[np.int64]
) -> None:
    """One action of each row of ``probability`` ``[A, actions]``."""
    for i in range(runs.shape[0]):
        actions[i] = categorical(streams[runs[i]], probability[i])


@njit
def draw_indices(size: NDArray[np.int64], runs: Runs, streams: Streams, indices: NDArray[np.int64]) -> None:
    """Fill ``indices`` ``[A, B]`` with draws from {0, …, ``size[run]`` − 1}, with replacement."""
    for i in range(runs.shape[0]):
        for j in range(indices.shape[1]):
            indices[i, j] = integer(streams[runs[i]], size[runs[i]])


def softmax(logits: NDArray[np.float32]) -> NDArray[np.float64]:
    """Probabilities of each row ``[A, actions]``, in double precision so that they sum to 1 as the draws need."""
    weights = np.exp(logits.astype(np.float64) - logits.max(axis=1, keepdims=True))
    return weights / weights.sum(axis=1, keepdims=True)
