"""Random streams as plain arrays, for compiled and for plain code alike.

A stream is ``uint64[2]``: the state and the odd increment ("gamma") of a SplitMix64 generator (Steele, Lea & Flood
2014, *Fast splittable pseudorandom number generators*, OOPSLA). Two words per stream are cheap to carry by the
thousand, and passing as many ``numpy.random.Generator`` objects into compiled code would cost more than the episodes
they serve. `apel.numerics.seeding` makes streams; the functions here draw from them in place.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from apel.numerics.compiled import njit

Stream = NDArray[np.uint64]
"""``uint64[2]``: state and increment."""

_GOLDEN_GAMMA = np.uint64(0x9E3779B97F4A7C15)
_MASK63 = np.uint64(0x7FFFFFFFFFFFFFFF)


@njit(inline="always")
def mix64(z: Any) -> Any:
    """Finaliser of SplitMix64: a bijection of 64-bit words in which every input bit moves every output bit."""
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return z ^ (z >> np.uint64(31))


@njit(inline="always")
def mix_gamma(z: Any) -> Any:
    """An odd increment with no long runs of equal bits (Steele, Lea & Flood 2014, §4)."""
    z = (z ^ (z >> np.uint64(33))) * np.uint64(0xFF51AFD7ED558CCD)
    z = (z ^ (z >> np.uint64(33))) * np.uint64(0xC4CEB9FE1A85EC53)
    z = (z ^ (z >> np.uint64(33))) | np.uint64(1)
    changes = z ^ (z >> np.uint64(1))
    count = np.uint64(0)
    while changes != np.uint64(0):
        changes &= changes - np.uint64(1)
        count += np.uint64(1)
    return z ^ np.uint64(0xAAAAAAAAAAAAAAAA) if count < np.uint64(24) else z


@njit(inline="always")
def next_uint64(stream: Stream) -> Any:
    """The next 64 random bits of ``stream`` (advanced in place)."""
    state = stream[0] + stream[1]
    stream[0] = state
    return mix64(state)


@njit(inline="always")
def uniform(stream: Stream) -> float:
    """One draw from the uniform distribution on [0, 1), with 53 random bits."""
    return (next_uint64(stream) >> np.uint64(11)) * (1.0 / 9007199254740992.0)


@njit(inline="always")
def integer(stream: Stream, upper: int) -> Any:
    """One draw from {0, …, upper − 1}; ``upper`` at most 2³². The bias is below ``upper`` / 2³²."""
    high = next_uint64(stream) >> np.uint64(32)
    return np.int64((high * np.uint64(upper)) >> np.uint64(32))


@njit
def normal(stream: Stream) -> float:
    """One draw from the standard normal distribution (Box & Muller 1958)."""
    radius = math.sqrt(-2.0 * math.log(1.0 - uniform(stream)))
    return radius * math.cos(2.0 * math.pi * uniform(stream))


@njit
def standard_gamma(stream: Stream, shape: float) -> float:
    """One draw from Gamma(``shape``, 1) for ``shape`` ≥ 1 (Marsaglia & Tsang 2000, *A simple method for generating
    gamma variables*).
    """
    d = shape - 1.0 / 3.0
    c = 1.0 / math.sqrt(9.0 * d)
    while True:
        x = normal(stream)
        v = 1.0 + c * x
        if v <= 0.0:
            continue
        v = v * v * v
        if math.log(1.0 - uniform(stream)) < 0.5 * x * x + d - d * v + d * math.log(v):
            return d * v


@njit
def dirichlet(stream: Stream, concentration: NDArray[np.float64], probability: NDArray[np.float64]) -> None:
    """Draw ``probability`` ~ Dirichlet(``concentration``), both ``float64[learners]``, concentrations ≥ 1 (Eq. 3.2)."""
    total = 0.0
    for i in range(concentration.shape[0]):
        probability[i] = standard_gamma(stream, concentration[i])
        total += probability[i]
    for i in range(concentration.shape[0]):
        probability[i] /= total


@njit
def categorical(stream: Stream, probability: NDArray[np.float64]) -> int:
    """One index drawn with the given probabilities, ``float64[n]`` (Eq. 3.3)."""
    u = uniform(stream)
    cumulative = 0.0
    last = probability.shape[0] - 1
    for i in range(last):
        cumulative += probability[i]
        if u < cumulative:
            return i
    return last


@njit
def poisson(stream: Stream, mean: float) -> int:
    """One draw from the Poisson distribution with a mean of at most some hundreds, by its cumulative sum."""
    u = uniform(stream)
    share = cumulative = math.exp(-mean)
    count = 0
    while u >= cumulative and share > 0.0:
        count += 1
        share *= mean / count
        cumulative += share
    return count


@njit
def start_stream(seed: int, stream: Stream) -> None:
    """Set ``stream`` in place to the stream of a 64-bit ``seed``."""
    word = np.uint64(seed)
    stream[0] = mix64(word)
    stream[1] = mix_gamma(word + _GOLDEN_GAMMA)


@njit
def episode_seed(key: Any, episode: int) -> Any:
    """Seed of one episode of an environment, in [0, 2⁶³), from the run's 64-bit environment ``key``.

    Counter-based, so that any episode can be replayed without those before it.
    """
    return np.int64(mix64(np.uint64(key) + np.uint64(episode + 1) * _GOLDEN_GAMMA) & _MASK63)


@njit
def evaluation_seed(key: Any, episode: int) -> Any:
    """Seed of the greedy evaluation after an episode: as `episode_seed`, of another sequence."""
    return episode_seed(mix64(np.uint64(key) ^ _GOLDEN_GAMMA), episode)


def stream_of_seed(seed: int) -> Stream:
    """A new stream for a 64-bit ``seed``."""
    stream = np.empty(2, dtype=np.uint64)
    start_stream(np.uint64(seed), stream)
    return stream
