"""Crossover, switch and delay against numbers worked by hand, and what holds of any runs."""

from __future__ import annotations

import math

import numpy as np
import pyarrow as pa
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jobs.analysis.recorded_episodes import Curves, IncompleteError, at_steps, moving_mean
from jobs.analysis.statistics.bootstrap import Floats
from jobs.analysis.switching.delay import crossover_step, first_of_last_stretch, switch_delay, switch_episode
from jobs.analysis.switching.table import crossing_of_means, delay_of_means

# Early: 1 throughout, episodes of 10 steps. Late, episodes of 15 steps: 0, 2, 0, 2, 2 at 15, 30, 45, 60, 75.
EARLY, EARLY_ENDS = np.ones(8), np.arange(10.0, 90.0, 10.0)
LATE, LATE_ENDS = np.array([0.0, 2.0, 0.0, 2.0, 2.0]), np.arange(15.0, 90.0, 15.0)


def test_crossover_is_where_the_late_learner_comes_to_stay_above() -> None:
    """Above from 30 on, not from 45 on, and again from 60 on until 75, where its run ends first."""
    assert crossover_step(EARLY, EARLY_ENDS, LATE, LATE_ENDS) == 60
    # Equal is not above: of an early learner at 2 nothing is left.
    assert math.isnan(crossover_step(2 * EARLY, EARLY_ENDS, LATE, LATE_ENDS))
    # Above whenever both are known: from 15 on, when the late one's first episode has ended.
    assert crossover_step(0 * EARLY - 1, EARLY_ENDS, LATE, LATE_ENDS) == 15


def test_crossover_is_judged_until_the_first_run_ends() -> None:
    """What the early learner does at 80, after the late one's end at 75, is of no account."""
    early = np.where(EARLY_ENDS == 80, 9.0, EARLY)
    assert crossover_step(early, EARLY_ENDS, LATE, LATE_ENDS) == 60
    no_overlap = crossover_step(EARLY[:1], EARLY_ENDS[:1], LATE, LATE_ENDS)  # ends at 10, before the other's first
    assert math.isnan(no_overlap)


@pytest.mark.parametrize("order", [slice(None), slice(None, None, -1)])
def test_rounding_crosses_nothing(order: slice) -> None:
    """Curves that end with the same returns, in whatever order, are not above each other, whatever came before."""
    last = np.array([0.1, 0.7, 0.2, 0.9, 0.3, 0.6])
    early, late = (np.concatenate((np.full(3, first), ends)) for first, ends in ((-4.3, last), (-0.3, last[order])))
    ends = np.arange(1.0, 10.0)
    curves = [moving_mean(returns[None], 6)[0] for returns in (early, late)]
    assert math.isnan(crossover_step(curves[0], ends, curves[1], ends))
    assert crossover_step(curves[0], ends, curves[1] + 1e-6, ends) == 1


def test_equal_windows_have_equal_means() -> None:
    """To the last bit, after anything that came before them."""
    values = np.array([[-4.3] * 3 + [0.7] * 7, [-0.3] * 3 + [0.7] * 7, [1e9] * 3 + [0.7] * 7])
    assert len(set(moving_mean(values, 2)[:, 4:].ravel().tolist())) == 1


@pytest.mark.parametrize(
    ("is_late", "expected"),
    [
        # Shares of the last 4 (fewer at first): 0, 1/2, 1/3, 1/4, 1/4, 1/4, 1/2, 3/4.
        ([0, 1, 0, 0, 0, 1, 1, 1], 6),
        ([0, 0, 0, 1, 1, 0, 0, 1], 5 - 1),  # 0, 0, 0, 1/4, 2/4, 2/4, 2/4, 2/4: the fourth episode is the first of it
        ([1, 1, 1, 1], 0),
        ([1, 1, 1, 0, 0, 0], math.nan),  # 1, 1, 1, 3/4, 2/4, 1/4
    ],
)
def test_switch_is_where_half_of_the_window_is_the_late_learner(is_late: list[int], expected: float) -> None:
    assert switch_episode(np.array(is_late, dtype=np.bool_), 4) == pytest.approx(expected, nan_ok=True)


# Ten episodes of 8 steps: the one from 56 to 64 (index 7) is under way at 60.
ENDS = np.arange(8.0, 88.0, 8.0)


def choices(first_late: int, num_episodes: int = 10) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    """Early before an episode, late from it on."""
    return np.arange(num_episodes) >= first_late


def test_delay() -> None:
    """Late from episode 7 on, window 4: half of it at episode 8, one after that under way; it starts at 64, 4 later."""
    found = switch_delay(60.0, choices(7), ENDS, 4)
    assert (found.episode_at_crossover, found.switch_episode, found.switch_step) == (7, 8, 64)
    assert (found.episodes, found.steps, found.censored) == (1, 4, False)


def test_delay_may_be_negative() -> None:
    """Late from episode 2 on: half at episode 3, which starts at 24; four episodes and 36 steps early."""
    found = switch_delay(60.0, choices(2), ENDS, 4)
    assert (found.episodes, found.steps) == (-4, -36)


def test_a_run_that_never_switches_counts_with_what_was_left() -> None:
    """Ten episodes less seven, and 80 steps less 60: lower bounds. Nothing, where the run was over by then."""
    found = switch_delay(60.0, choices(9), ENDS, 4)
    assert found.censored
    assert (found.episodes, found.steps) == (3, 20)
    over = switch_delay(100.0, choices(9), ENDS, 4)
    assert (over.episodes, over.steps, over.episode_at_crossover) == (0, 0, 10)


def test_without_a_crossover_there_is_no_delay() -> None:
    """Whether the ensemble switched or not; it is not censored either."""
    for first_late in (2, 9):
        found = switch_delay(math.nan, choices(first_late), ENDS, 4)
        assert math.isnan(found.episodes)
        assert math.isnan(found.steps)
        assert not found.censored


def test_last_stretch_of_many_rows() -> None:
    """All true: from the start; false at the end: nowhere, which is the number of places."""
    rows = np.array([[1, 1, 1], [0, 1, 1], [1, 0, 1], [1, 1, 0], [0, 0, 0]], dtype=np.bool_)
    assert first_of_last_stretch(rows).tolist() == [0, 1, 2, 3, 3]


def test_values_at_steps() -> None:
    """Of the last episode that ended at or before; unknown before the first and after a run's last."""
    values, ends = np.array([[1.0, 2.0, 3.0], [5.0, 6.0, np.nan]]), np.array([[10.0, 20.0, 30.0], [15.0, 25.0, np.nan]])
    found = at_steps(values, ends, np.array([5.0, 10.0, 19.0, 25.0, 30.0]))
    np.testing.assert_array_equal(found, [[np.nan, 1, 1, 2, 3], [np.nan, np.nan, 5, 6, np.nan]])


def table(episodes: list[tuple[int, int, int]]) -> pa.Table:
    """Run, episode and length."""
    return pa.table(dict(zip(("run_index", "episode", "length"), zip(*episodes, strict=True), strict=True)))


def test_ends_of_episodes() -> None:
    """Sums of lengths, run by run; refused where an episode is missing, whose length nobody knows."""
    whole = [(3, 0, 4), (3, 1, 5), (7, 0, 2)]
    found = Curves(table(whole))
    np.testing.assert_array_equal(found.ends, [[4, 9], [2, np.nan]])
    assert found.num_steps.tolist() == [9, 2]
    for episodes in ([(0, 0, 4), (0, 2, 5), (1, 0, 1), (1, 1, 1), (1, 2, 1)], [(0, 0, 4), (0, 5, 4)], [(0, 1, 4)]):
        with pytest.raises(
            IncompleteError, match=r"found 1 of . runs with episodes that were not recorded, expected rec"
        ):
            _ = Curves(table(episodes)).ends


@given(
    st.lists(st.tuples(st.integers(0, 20), st.integers(1, 9)), min_size=1, max_size=30),
    st.lists(st.tuples(st.integers(0, 20), st.integers(1, 9)), min_size=1, max_size=30),
    st.integers(1, 6),
    st.integers(-50, 50),
)
def test_only_differences_count(
    early: list[tuple[int, int]], late: list[tuple[int, int]], window: int, by: int
) -> None:
    """The same constant on all returns moves no crossover, which is where the late one's curve rises above."""

    def crossover(constant: int) -> float:
        curves = []
        for run in (early, late):
            returns, lengths = (np.array([numbers], dtype=np.float64) for numbers in zip(*run, strict=True))
            # Means of up to six are whole numbers of 60ths, so that the shift rounds nothing away.
            curves += [np.round(moving_mean(60 * (returns + constant), window)[0]), np.cumsum(lengths)]
        return crossover_step(*curves)

    np.testing.assert_equal(crossover(by), crossover(0))


@given(st.integers(5, 60), st.integers(0, 40), st.integers(1, 12), st.integers(1, 9))
def test_planted_delay_is_found(overtakes: int, delay: int, half: int, length: int) -> None:
    """Returns and selections jump, in episodes of one length: the planted delay less W / 2, since the returns are made
    to need their whole window, and the selections need half of theirs.
    """
    window = 2 * half
    late_returns = np.where(np.arange(200) >= overtakes, 2.0, 0.0)[None]
    ends = np.cumsum(np.full(200, float(length)))
    # The trailing mean of 2s and 0s is above the early learner's 2 - 2 / W with the whole window, W - 1 episodes on.
    early = np.full(200, 2 - 2.0 / window)
    crossover = crossover_step(early, ends, moving_mean(late_returns, window)[0], ends)
    assert crossover == ends[overtakes + window - 1]
    found = switch_delay(crossover, choices(overtakes + delay, 200), ends, window)
    # Half of the window is the late one's after W / 2 episodes, and sooner where there are not yet that many before.
    first = overtakes + delay
    assert found.switch_episode == first + min(half, max(first, 1)) - 1
    assert found.episodes == found.switch_episode - (overtakes + window)
    assert found.steps == (found.switch_episode - overtakes - window) * length


def test_delay_of_mean_curves() -> None:
    """Steps 1 to 6. Mean gap −1, −1, 1, 1, 1, 1: from step 3; mean share 0, 0, ¼, ½, 1, 1: from 4; a delay of 1."""
    steps = np.arange(1.0, 7.0)
    gaps = np.array([[-2.0, -2, 0, 0, 0, 2], [0.0, 0, 2, 2, 2, 0]])
    shares = np.array([[0.0, 0, 0.5, 0.5, 1, 1], [0.0, 0, 0, 0.5, 1, 1]])
    assert crossing_of_means(steps, gaps) == 3
    # What is above by rounding alone, as 0.1 + 0.2 is above 0.3, does not cross.
    rounded = np.where(gaps == 2, 0.1 + 0.2 - 0.3, gaps)
    assert crossing_of_means(steps, rounded) is None
    assert delay_of_means(steps, rounded, shares) is None
    found = delay_of_means(steps, gaps, shares)
    assert found is not None
    assert found.value == 1
    # Of the first run twice: from 6, where alone its gap is above 0, to 3. Of the second twice: from the grid's end, 6,
    # since its gap is 0 there, to 4. Of both, every other resample: 1.
    assert (found.low, found.high) == (-3, 1)
    assert delay_of_means(steps, -np.abs(gaps), shares) is None
    assert delay_of_means(steps, gaps, 0 * shares) is None


def test_no_points_cross_nowhere() -> None:
    empty: Floats = np.empty((3, 0))
    assert crossing_of_means(np.empty(0), empty) is None
