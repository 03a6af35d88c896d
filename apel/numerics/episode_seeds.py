"""What the episodes of one run are seeded with."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from apel.numerics.streams import episode_seed, evaluation_seed

NARROW_BITS = 31
"""Seeds of so many bits are taken by everything that is seeded: ``RandomState`` and C's unsigned integers take 32,
signed ones 31.
"""
_MASK = 2**NARROW_BITS - 1


@dataclass(frozen=True)
class EpisodeSeeds:
    """The seeds of a run's episodes, and of its greedy evaluations.

    Wide ones are `apel.numerics.streams.episode_seed`, of 63 bits. Narrow ones come from a permutation of all numbers
    of 31 bits that the key chooses: even numbers are the run's episodes, odd ones its evaluations. So no two of the
    first 2³⁰ episodes of a run, evaluations included, have the same seed. Two given episodes of different runs have the
    same one with probability 2⁻³¹.

    Attributes
    ----------
    key:
        The run's 64-bit environment key.
    is_wide:
        Whether the environment takes 63 bits.
    """

    key: int
    is_wide: bool

    def of_episode(self, episode: int) -> int:
        """Of an episode that is played."""
        if self.is_wide:
            return int(episode_seed(np.uint64(self.key), episode))
        return permuted(2 * episode, self.key)

    def of_evaluation(self, episode: int) -> int:
        """Of the greedy evaluation after an episode."""
        if self.is_wide:
            return int(evaluation_seed(np.uint64(self.key), episode))
        return permuted(2 * episode + 1, self.key)


def permuted(number: int, key: int) -> int:
    """The place of a number of 31 bits in a permutation of all of them that a 64-bit ``key`` chooses."""
    word = _mixed((number ^ key) & _MASK)
    return _mixed((word + (key >> NARROW_BITS)) & _MASK)


def _mixed(word: int) -> int:
    """A bijection of 31-bit words: shifts that fold a word into itself, and products with odd numbers.

    The multipliers are those of Wellons 2018, *Prospecting for hash functions* (https://nullprogram.com/blog/2018/07/31),
    where they were found for 32 bits.
    """
    word ^= word >> 16
    word = word * 0x21F0AAAD & _MASK
    word ^= word >> 15
    word = word * 0x735A2D97 & _MASK
    return word ^ word >> 15
