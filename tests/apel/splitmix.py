"""SplitMix64 in Python's own unbounded integers, written from the algorithm (Steele, Lea & Flood 2014): an oracle."""

from __future__ import annotations

MASK64 = 2**64 - 1
GOLDEN_GAMMA = 0x9E3779B97F4A7C15


def mix64(z: int) -> int:
    """The finaliser."""
    z = ((z ^ (z >> 30)) * 0xBF58476D1CE4E5B9) & MASK64
    z = ((z ^ (z >> 27)) * 0x94D049BB133111EB) & MASK64
    return z ^ (z >> 31)


def mix_gamma(z: int) -> int:
    """An odd increment in which at least 24 neighbouring bits differ."""
    z = ((z ^ (z >> 33)) * 0xFF51AFD7ED558CCD) & MASK64
    z = ((z ^ (z >> 33)) * 0xC4CEB9FE1A85EC53) & MASK64
    z = (z ^ (z >> 33)) | 1
    changes = bin(z ^ (z >> 1)).count("1")
    return z ^ 0xAAAAAAAAAAAAAAAA if changes < 24 else z


def episode_seed(key: int, episode: int) -> int:
    """Seed of one episode: the counter-th output of a generator that starts at ``key``, without its top bit."""
    return mix64((key + (episode + 1) * GOLDEN_GAMMA) & MASK64) & (2**63 - 1)


def evaluation_seed(key: int, episode: int) -> int:
    """Seed of the greedy evaluation after an episode: the same with a key that is mixed once more."""
    return episode_seed(mix64(key ^ GOLDEN_GAMMA), episode)


class SplitMix64:
    """A generator: ``state`` grows by ``gamma``, and every output is the finalised state."""

    def __init__(self, state: int, gamma: int) -> None:
        self.state, self.gamma = state, gamma

    @classmethod
    def of_seed(cls, seed: int) -> SplitMix64:
        """The generator of a 64-bit seed."""
        return cls(mix64(seed), mix_gamma((seed + GOLDEN_GAMMA) & MASK64))

    def next_uint64(self) -> int:
        """64 random bits."""
        self.state = (self.state + self.gamma) & MASK64
        return mix64(self.state)

    def uniform(self) -> float:
        """53 random bits behind the binary point."""
        return (self.next_uint64() >> 11) / 2**53

    def integer(self, upper: int) -> int:
        """The high 32 bits, scaled to {0, …, upper − 1}."""
        return ((self.next_uint64() >> 32) * upper) >> 32
