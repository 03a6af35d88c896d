"""The one way to make a random stream.

Every stream of a run is ``SeedSequence(run_seed, spawn_key=(role, index))``: a stream depends on what it is *for*,
never on how many others there are, so that adding a learner or moving a run to another worker changes no draw.
"""

from __future__ import annotations

import random
from enum import IntEnum

import numpy as np

from apel.numerics.streams import Stream, mix_gamma


class Role(IntEnum):
    """What a stream is for. The numbers are part of every result: never renumber, only append."""

    VARIABLES = 0
    """Choices drawn once per run, such as which feature a learner does not see."""
    MAZE = 1
    """The environment's own shape, drawn once per run."""
    ENVIRONMENT = 2
    """The dynamics, reseeded for every episode."""
    SELECTOR = 3
    LEARNER = 4
    EVALUATION = 5
    """Episodes in which a trained agent is evaluated."""
    FLOOR = 6
    """Whether a learner acts that the selector did not choose."""


def run_seeds(seed: int, num_runs: int) -> list[int]:
    """The seeds of runs 0 … ``num_runs`` − 1: Python's ``randint(0, 2³¹ − 1)`` after seeding with ``seed`` (§4.1.4).

    The first seeds do not depend on ``num_runs``.

    >>> run_seeds(1234, 3)
    [1892932127, 501869158, 32175636]
    """
    generator = random.Random(seed)
    return [generator.randint(0, 2**31 - 1) for _ in range(num_runs)]


def seed_sequence(run_seed: int, role: Role, index: int = 0, *members: int) -> np.random.SeedSequence:
    """The seed sequence of one role of one run; ``index`` tells apart several of a kind (learner 0, learner 1, …), and
    ``members`` the parts of one that holds others.
    """
    return np.random.SeedSequence(run_seed, spawn_key=(int(role), index, *members))


def make_stream(run_seed: int, role: Role, index: int = 0) -> Stream:
    """The stream (``uint64[2]``) of one role of one run."""
    state, gamma = seed_sequence(run_seed, role, index).generate_state(2, np.uint64)
    return np.array([state, mix_gamma(gamma)], dtype=np.uint64)


def make_key(run_seed: int, role: Role, index: int = 0, *members: int) -> int:
    """A 64-bit key for counter-based seeds (see `apel.numerics.streams.episode_seed`)."""
    return int(seed_sequence(run_seed, role, index, *members).generate_state(1, np.uint64)[0])
