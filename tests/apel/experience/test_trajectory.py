from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from apel.experience.trajectory import Episodes, Trajectory, TrajectoryBatch, batch_of

rewards = st.floats(allow_nan=False, allow_infinity=False)


@st.composite
def trajectories(draw: st.DrawFn) -> list[Trajectory]:
    """Episodes of unequal lengths with vectors or numbers as observations, with probabilities or without."""
    width = draw(st.sampled_from([None, 1, 3]))
    known = draw(st.booleans())
    generator = np.random.default_rng(draw(st.integers(0, 2**32)))
    made = []
    for length in draw(st.lists(st.integers(1, 6), min_size=1, max_size=6)):
        shape = (length + 1,) if width is None else (length + 1, width)
        reward = np.array(draw(st.lists(rewards, min_size=length, max_size=length)))
        probability = generator.random((length, 2)) if known else None
        made.append(
            Trajectory(
                generator.integers(0, 99, shape),
                generator.integers(0, 2, length),
                reward,
                draw(st.booleans()),
                probability,
            )
        )
    return made


def episodes_of(made: list[Trajectory]) -> Episodes:
    """A row for each trajectory: run i % 3, episode 10 + i."""
    episodes = Episodes.empty(len(made))
    for i, trajectory in enumerate(made):
        total = trajectory.undiscounted_return
        row = (i % 3, 10 + i, len(trajectory), total, total, total, trajectory.terminated)
        for column, value in zip(episodes, row, strict=True):
            column[i] = value
    return episodes


@given(made=trajectories())
def test_batch_gives_back_its_trajectories(made: list[Trajectory]) -> None:
    """Packing ragged episodes into columns and unpacking them changes no value, rewards included."""
    batch = batch_of(episodes_of(made), made)
    unpacked = list(batch.trajectories())
    assert [(run, episode) for run, episode, _ in unpacked] == [(i % 3, 10 + i) for i in range(len(made))]
    for before, (_, _, after) in zip(made, unpacked, strict=True):
        np.testing.assert_array_equal(after.observation, before.observation)
        np.testing.assert_array_equal(after.action, before.action)
        np.testing.assert_array_equal(after.reward, before.reward)
        assert after.terminated == before.terminated
        assert len(after) == len(before)
        if before.probability is None:
            assert after.probability is None
        else:
            np.testing.assert_array_equal(after.probability, before.probability)


@pytest.mark.parametrize(("num_values", "bytes_per_code"), [(1, 1), (255, 1), (256, 2), (300, 2), (70_000, 4)])
def test_reward_codes_have_room_for_every_value(num_values: int, bytes_per_code: int) -> None:
    """Codes are as narrow as the number of different rewards allows, and lose none of them."""
    reward = np.sin(np.arange(num_values, dtype=np.float64))
    made = Trajectory(np.zeros(num_values + 1, dtype=np.int8), np.zeros(num_values, dtype=np.int8), reward, True)
    batch = batch_of(episodes_of([made]), [made])
    assert batch.reward_code.dtype.itemsize == bytes_per_code
    np.testing.assert_array_equal(next(batch.trajectories())[2].reward, reward)


def test_probabilities_travel_with_their_own_episodes() -> None:
    """One episode without μ takes it from no other: other runs may be in the batch. Without any there is no column."""
    with_mu, without = (
        Trajectory(np.zeros(2), np.zeros(1, dtype=np.int64), np.zeros(1), True, probability)
        for probability in (np.array([[0.25, 0.75]]), None)
    )
    mixed = batch_of(episodes_of([without, with_mu]), [without, with_mu])
    np.testing.assert_array_equal(mixed.probability, [[np.nan, np.nan], [0.25, 0.75]])
    first, second = (trajectory.probability for _, _, trajectory in mixed.trajectories())
    assert first is None
    np.testing.assert_array_equal(second, [[0.25, 0.75]])
    assert batch_of(episodes_of([without, without]), [without, without]).probability is None


def test_nbytes_counts_every_column() -> None:
    """The size of a batch is the sum of its columns' bytes."""
    batch = TrajectoryBatch(
        episodes=Episodes.empty(2),  # 6 columns of 8 bytes and one of 1: 2 · 49 = 98
        observation=np.zeros(7, dtype=np.uint16),  # 14
        action=np.zeros(5, dtype=np.uint8),  # 5
        reward_code=np.zeros(5, dtype=np.uint8),  # 5
        reward_value=np.zeros(2),  # 16
        probability=np.zeros((5, 4)),  # 160
    )
    assert batch.nbytes == 98 + 14 + 5 + 5 + 16 + 160


def test_first_episodes_are_views() -> None:
    """The first rows of the columns share their memory."""
    episodes = Episodes.empty(5)
    first = episodes.first(2)
    first.run[1] = 77
    assert [len(column) for column in first] == [2] * 7
    assert episodes.run[1] == 77


@given(values=st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=40))
def test_return_is_added_in_order(values: list[float]) -> None:
    """The undiscounted return is the plain running sum, as compiled code adds it, in every version of Python.

    Python's own ``sum`` of floats has compensated for rounding since 3.12, and would differ.
    """
    total = 0.0
    for value in values:
        total += value
    trajectory = Trajectory(np.zeros(len(values) + 1), np.zeros(len(values), dtype=np.int64), np.array(values), True)
    assert trajectory.undiscounted_return == total


def test_return_of_the_optimal_walk() -> None:
    """33 steps at −0.1 and the last at +1 return −2.3, up to the rounding of 34 additions in order."""
    reward = np.array([-0.1] * 33 + [1.0])
    trajectory = Trajectory(np.zeros(35), np.zeros(34, dtype=np.int64), reward, True)
    # In exact arithmetic −2.3; added one after the other in double precision:
    assert trajectory.undiscounted_return == -2.3000000000000016


@given(made=trajectories())
def test_batches_cannot_be_written_to(made: list[Trajectory]) -> None:
    """A batch is read-only in the process that made it, as it is where it arrives; its source stays writable."""
    episodes = episodes_of(made)
    batch = batch_of(episodes, made)
    columns = [*batch.episodes, batch.observation, batch.action, batch.reward_code, batch.reward_value]
    assert not any(column.flags.writeable for column in columns)
    assert all(column.flags.writeable for column in episodes)
