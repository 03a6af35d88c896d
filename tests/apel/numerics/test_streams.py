from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from apel.numerics.streams import (
    categorical,
    dirichlet,
    episode_seed,
    integer,
    mix64,
    mix_gamma,
    next_uint64,
    normal,
    poisson,
    standard_gamma,
    stream_of_seed,
    uniform,
)
from tests.apel import splitmix

words = st.integers(0, splitmix.MASK64)

NUM_DRAWS = 40_000


def assert_mean(values: np.ndarray, mean: float, variance: float) -> None:
    """The sample mean lies within 5 standard errors of ``mean``, for draws of that ``variance``."""
    assert abs(float(np.mean(values)) - mean) <= 5.0 * math.sqrt(variance / len(values))


def test_outputs_are_the_published_ones() -> None:
    """With state 1234567 and the golden gamma, the outputs are those that every SplitMix64 gives."""
    stream = np.array([1234567, splitmix.GOLDEN_GAMMA], dtype=np.uint64)
    # Reference outputs of Vigna's splitmix64.c for the seed 1234567 (as listed by Rosetta Code).
    expected = [6457827717110365317, 3203168211198807973, 9817491932198370423, 4593380528125082431]
    assert [next_uint64(stream) for _ in expected] == expected


@given(state=words, gamma=words)
def test_next_uint64_agrees_with_unbounded_integers(state: int, gamma: int) -> None:
    """The 64-bit generator is the algorithm modulo 2⁶⁴, state and output."""
    stream, oracle = np.array([state, gamma], dtype=np.uint64), splitmix.SplitMix64(state, gamma)
    assert [next_uint64(stream) for _ in range(5)] == [oracle.next_uint64() for _ in range(5)]
    assert stream.tolist() == [oracle.state, gamma]


@given(word=words)
def test_mixers_agree_with_unbounded_integers(word: int) -> None:
    """Both finalisers are the published formulas modulo 2⁶⁴."""
    assert mix64(np.uint64(word)) == splitmix.mix64(word)
    assert mix_gamma(np.uint64(word)) == splitmix.mix_gamma(word)


def test_mix_gamma_repairs_increments_with_long_runs() -> None:
    """An increment with fewer than 24 changes between neighbouring bits is xored with 0xAAAA…, and stays odd."""
    repaired = 0
    for word in range(20_000):
        z = ((word ^ (word >> 33)) * 0xFF51AFD7ED558CCD) & splitmix.MASK64
        z = ((z ^ (z >> 33)) * 0xC4CEB9FE1A85EC53) & splitmix.MASK64
        plain = (z ^ (z >> 33)) | 1
        gamma = mix_gamma(np.uint64(word))
        assert gamma % 2 == 1
        assert gamma in (plain, plain ^ 0xAAAAAAAAAAAAAAAA)
        repaired += gamma != plain
    # 63 neighbours that differ with probability 1/2: P(fewer than 24) is about 2 %, so 20 000 words show both cases.
    assert 0 < repaired < 2_000


@given(seed=words)
def test_uniform_agrees_with_unbounded_integers(seed: int) -> None:
    """A uniform draw is the top 53 bits over 2⁵³, in [0, 1)."""
    stream, oracle = stream_of_seed(seed), splitmix.SplitMix64.of_seed(seed)
    draws = [uniform(stream) for _ in range(5)]
    assert draws == [oracle.uniform() for _ in range(5)]
    assert all(0.0 <= draw < 1.0 for draw in draws)


@given(seed=words, upper=st.integers(1, 2**32))
def test_integer_agrees_with_unbounded_integers(seed: int, upper: int) -> None:
    """An integer draw is the top 32 bits scaled to {0, …, upper − 1}, one word per draw."""
    stream, oracle = stream_of_seed(seed), splitmix.SplitMix64.of_seed(seed)
    draws = [integer(stream, upper) for _ in range(5)]
    assert draws == [oracle.integer(upper) for _ in range(5)]
    assert all(0 <= draw < upper for draw in draws)


@pytest.mark.parametrize("upper", [1, 2, 3, 10])
def test_integers_are_equally_frequent(upper: int) -> None:
    """Each of ``upper`` values comes up with frequency 1/upper, within 5 standard errors."""
    stream = stream_of_seed(11)
    draws = np.array([integer(stream, upper) for _ in range(NUM_DRAWS)])
    for value in range(upper):
        assert_mean(draws == value, 1 / upper, (1 / upper) * (1 - 1 / upper))


def test_uniform_moments() -> None:
    """The uniform distribution on [0, 1) has mean 1/2 and second moment 1/3."""
    stream = stream_of_seed(12)
    draws = np.array([uniform(stream) for _ in range(NUM_DRAWS)])
    assert_mean(draws, 1 / 2, 1 / 12)
    assert_mean(draws**2, 1 / 3, 4 / 45)  # E u⁴ − (E u²)² = 1/5 − 1/9


def test_normal_moments() -> None:
    """The standard normal distribution has the moments 0, 1, 0, 3."""
    stream = stream_of_seed(13)
    draws = np.array([normal(stream) for _ in range(NUM_DRAWS)])
    assert_mean(draws, 0.0, 1.0)
    assert_mean(draws**2, 1.0, 2.0)  # E x⁴ − 1
    assert_mean(draws**3, 0.0, 15.0)  # E x⁶
    assert_mean(draws**4, 3.0, 96.0)  # E x⁸ − 9 = 105 − 9


@pytest.mark.parametrize("shape", [1.0, 2.5, 50.0])
def test_gamma_moments(shape: float) -> None:
    """Gamma(k, 1) has mean k, variance k, and E 1/x = 1/(k − 1) for k > 2; all draws are positive."""
    stream = stream_of_seed(14)
    draws = np.array([standard_gamma(stream, shape) for _ in range(NUM_DRAWS)])
    assert draws.min() > 0.0
    assert_mean(draws, shape, shape)
    # The fourth central moment is 3k² + 6k, so (x − k)² has variance 2k² + 6k.
    assert_mean((draws - shape) ** 2, shape, 2 * shape**2 + 6 * shape)
    if shape > 2.0:
        # E 1/x² = 1/((k − 1)(k − 2)).
        assert_mean(1 / draws, 1 / (shape - 1), 1 / ((shape - 1) * (shape - 2)) - 1 / (shape - 1) ** 2)


def test_gamma_of_shape_one_is_exponential() -> None:
    """Gamma(1, 1) exceeds t with probability exp(−t)."""
    stream = stream_of_seed(15)
    draws = np.array([standard_gamma(stream, 1.0) for _ in range(NUM_DRAWS)])
    for t in (0.1, 1.0, 3.0):
        tail = math.exp(-t)
        assert_mean(draws > t, tail, tail * (1 - tail))


@pytest.mark.parametrize("concentration", [[1.0], [1.0, 1.0], [1.0, 3.0, 6.0], [99.0, 1.0]])
def test_dirichlet_moments(concentration: list[float]) -> None:
    """E pᵢ = cᵢ / Σc and Var pᵢ = mᵢ (1 − mᵢ) / (Σc + 1) (Eq. 3.2); every draw sums to 1."""
    stream, c = stream_of_seed(16), np.array(concentration)
    draws = np.empty((NUM_DRAWS, len(c)))
    for draw in draws:
        dirichlet(stream, c, draw)
    assert draws.min() >= 0.0
    assert draws.sum(axis=1) == pytest.approx(1.0, abs=1e-12)
    for mean, column in zip(c / c.sum(), draws.T, strict=True):
        variance = mean * (1 - mean) / (c.sum() + 1)
        assert_mean(column, mean, variance + 1e-30)
        if variance > 0.0:
            assert float(np.var(column)) == pytest.approx(variance, rel=0.05)


def test_categorical_frequencies() -> None:
    """Each index is drawn with its probability, one of probability zero never (Eq. 3.3)."""
    stream, probability = stream_of_seed(17), np.array([0.05, 0.0, 0.25, 0.7])
    draws = np.array([categorical(stream, probability) for _ in range(NUM_DRAWS)])
    for index, p in enumerate(probability.tolist()):
        assert_mean(draws == index, p, p * (1 - p))


@given(seed=words, weights=st.lists(st.floats(0.01, 1.0), min_size=1, max_size=6))
def test_categorical_is_the_inverse_of_the_cumulative_sum(seed: int, weights: list[float]) -> None:
    """The index is the first whose cumulative probability exceeds one uniform draw; rounding never leaves the range."""
    probability = np.array(weights) / np.sum(weights)
    u = splitmix.SplitMix64.of_seed(seed).uniform()
    cumulative, expected = 0.0, len(weights) - 1
    for index, p in enumerate(probability.tolist()[:-1]):
        cumulative += p
        if u < cumulative:
            expected = index
            break
    assert categorical(stream_of_seed(seed), probability) == expected


@given(key=words, episode=st.integers(0, 2**40))
def test_episode_seed_agrees_with_unbounded_integers(key: int, episode: int) -> None:
    """An episode's seed is a function of key and index alone, in [0, 2⁶³) as Gymnasium wants it."""
    seed = episode_seed(np.uint64(key), episode)
    assert seed == splitmix.episode_seed(key, episode)
    assert 0 <= seed < 2**63


def test_episode_seeds_are_distinct() -> None:
    """No two episodes of a run, nor the same episode of runs with neighbouring keys, share a seed."""
    seeds = {episode_seed(np.uint64(key), episode) for key in range(5) for episode in range(5_000)}
    assert len(seeds) == 25_000


@given(seed=words)
def test_stream_of_seed_agrees_with_unbounded_integers(seed: int) -> None:
    """State and increment of a seed's stream are the two mixers' values, the increment odd."""
    oracle = splitmix.SplitMix64.of_seed(seed)
    assert stream_of_seed(seed).tolist() == [oracle.state, oracle.gamma]
    assert oracle.gamma % 2 == 1


@pytest.mark.parametrize("mean", [0.0, 0.5, 4.0, 100.0])
def test_poisson(mean: float) -> None:
    """Draws are scipy's quantiles of the same uniform numbers, so that nothing is left to chance."""
    stream, same = stream_of_seed(6), stream_of_seed(6)
    expected = [stats.poisson(mean).ppf(uniform(same)) for _ in range(2000)]
    assert [poisson(stream, mean) for _ in range(2000)] == expected
