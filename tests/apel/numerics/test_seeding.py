from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from apel.numerics.seeding import Role, make_key, make_stream, run_seeds, seed_sequence
from tests.apel import splitmix


def test_run_seeds_are_those_of_the_dissertation() -> None:
    """The seeds of a hundred runs start with Python's randint(0, 2³¹ − 1) after seeding with 1234 (§4.1.4)."""
    # Worked out with plain Python: random.seed(1234), then random.randint(0, 2**31 - 1) five times.
    assert run_seeds(1234, 5) == [1892932127, 501869158, 32175636, 389311301, 150006740]


@given(seed=st.integers(0, 2**32), shorter=st.integers(0, 20), longer=st.integers(20, 40))
def test_first_run_seeds_do_not_depend_on_the_number_of_runs(seed: int, shorter: int, longer: int) -> None:
    """Asking for more runs keeps the seeds of the first ones."""
    assert run_seeds(seed, longer)[:shorter] == run_seeds(seed, shorter)


@given(seed=st.integers(0, 2**32))
def test_run_seeds_fit_every_library(seed: int) -> None:
    """A run seed lies in [0, 2³¹), which NumPy, Torch and Gymnasium all take."""
    assert all(0 <= one < 2**31 for one in run_seeds(seed, 50))


def test_role_numbers_are_frozen() -> None:
    """The number of a role is part of every result: none may be renumbered."""
    expected = {"VARIABLES": 0, "MAZE": 1, "ENVIRONMENT": 2, "SELECTOR": 3, "LEARNER": 4}
    expected |= {"EVALUATION": 5, "FLOOR": 6}
    assert {role.name: int(role) for role in Role} == expected


def test_streams_of_all_roles_and_indices_differ() -> None:
    """No two roles, indices or runs share a stream or a key."""
    places = list(itertools.product((0, 1, 1892932127), Role, range(5)))
    streams = {tuple(make_stream(*place).tolist()) for place in places}
    keys = {make_key(*place) for place in places}
    assert len(streams) == len(keys) == len(places)


def test_index_and_role_do_not_collide() -> None:
    """Index 0 is not the same as no index, and (role 3, index 4) is not (role 4, index 3)."""
    words = [tuple(seed_sequence(7, Role(r), i).generate_state(4).tolist()) for r, i in ((3, 4), (4, 3), (3, 0))]
    words.append(tuple(np.random.SeedSequence(7, spawn_key=(3,)).generate_state(4).tolist()))
    assert len(set(words)) == 4


@pytest.mark.parametrize("role", list(Role))
def test_stream_comes_from_numpy_seed_sequence(role: Role) -> None:
    """A stream is SeedSequence(run seed, spawn_key=(role, index)): its first word the state, its second the gamma."""
    state, gamma = np.random.SeedSequence(42, spawn_key=(int(role), 3)).generate_state(2, np.uint64).tolist()
    assert make_stream(42, role, 3).tolist() == [state, splitmix.mix_gamma(gamma)]
    assert make_key(42, role, 3) == state


@given(seed=st.integers(0, 2**31 - 1), index=st.integers(0, 50))
def test_increment_of_a_stream_is_odd(seed: int, index: int) -> None:
    """The increment is odd, so that the generator visits all 2⁶⁴ states."""
    assert int(make_stream(seed, Role.LEARNER, index)[1]) % 2 == 1


def test_making_a_stream_twice_gives_equal_but_separate_streams() -> None:
    """Drawing from one stream does not advance another of the same place."""
    first, second = make_stream(1, Role.SELECTOR), make_stream(1, Role.SELECTOR)
    first[0] += np.uint64(1)
    assert second.tolist() == make_stream(1, Role.SELECTOR).tolist()
