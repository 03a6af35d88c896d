from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from apel.numerics.episode_seeds import EpisodeSeeds, permuted
from tests.apel import splitmix

KEYS = st.integers(0, 2**64 - 1)


@given(KEYS, st.integers(0, 2**30 - 1))
def test_wide_seeds_are_those_of_the_streams(key: int, episode: int) -> None:
    """What takes 63 bits gets what it always got."""
    seeds = EpisodeSeeds(key, is_wide=True)
    assert seeds.of_episode(episode) == splitmix.episode_seed(key, episode)
    assert seeds.of_evaluation(episode) == splitmix.evaluation_seed(key, episode)


@given(KEYS, st.integers(0, 2**30 - 1))
def test_narrow_seeds_fit_signed_integers_of_32_bits(key: int, episode: int) -> None:
    """And NumPy's oldest generator takes them."""
    seeds = EpisodeSeeds(key, is_wide=False)
    for seed in (seeds.of_episode(episode), seeds.of_evaluation(episode)):
        assert 0 <= seed < 2**31
        np.random.RandomState(seed)


@given(KEYS, st.sets(st.integers(0, 2**31 - 1), max_size=200))
def test_permutation_maps_no_two_numbers_to_one(key: int, numbers: set[int]) -> None:
    assert len({permuted(number, key) for number in numbers}) == len(numbers)


@pytest.mark.parametrize("key", [0, 1, 2**31, 2**64 - 1, 0x9E3779B97F4A7C15])
def test_no_two_episodes_of_a_run_have_one_seed(key: int) -> None:
    """100 000 of them, evaluations included; drawn at random, two of them would be alike with probability 0.99."""
    seeds = EpisodeSeeds(key, is_wide=False)
    found = {one for episode in range(50_000) for one in (seeds.of_episode(episode), seeds.of_evaluation(episode))}
    assert len(found) == 100_000


def test_seeds_of_other_runs_are_others() -> None:
    """The first thousand episodes of a hundred runs: of 10⁵ seeds, 10¹⁰ / 2³² ≈ 2.3 pairs are alike by chance."""
    keys = np.random.default_rng(1).integers(2**64, size=100, dtype=np.uint64).tolist()
    found = {EpisodeSeeds(key, is_wide=False).of_episode(episode) for key in keys for episode in range(1_000)}
    assert 10**5 - len(found) < 12


def test_every_bit_of_the_key_counts() -> None:
    """Of the 64 keys that differ in one bit, each gives other seeds, except for the two bits that nothing reads."""
    plain = [EpisodeSeeds(0, is_wide=False).of_episode(episode) for episode in range(50)]
    same = [
        bit
        for bit in range(64)
        if [EpisodeSeeds(1 << bit, is_wide=False).of_episode(episode) for episode in range(50)] == plain
    ]
    assert same == [62, 63]
