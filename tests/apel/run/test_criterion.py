from __future__ import annotations

import math
from collections.abc import Sequence
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from apel.run.criterion import Criterion, Threshold, criterion_met, measure_of
from apel.run.opening import open_book
from apel.run.state import RUNNING, advance_run
from apel.selectors import Fixed


def when_met(criterion: Criterion, threshold: float, episodes: Sequence[tuple[int, float]]) -> list[bool]:
    """Feed (length, return) pairs to the running criterion: whether it holds after each."""
    recent, parameters = np.zeros(criterion.window), criterion.parameters()
    return [
        bool(criterion_met(parameters, threshold, recent, e, measure_of(parameters, length, episode_return)))
        for e, (length, episode_return) in enumerate(episodes)
    ]


def test_threshold_is_rounded_once() -> None:
    """1.1 × 34 is the float 37.4, not the product of the floats, which is 37.400000000000006."""
    criterion = Criterion("length", 50, below=Threshold(1.1, "optimal_length"))
    assert criterion.threshold({"optimal_length": 34}) == 37.4
    assert 1.1 * 34 != 37.4


@given(tenths=st.integers(1, 50), length=st.integers(1, 200))
def test_threshold_is_the_float_nearest_to_the_exact_product(tenths: int, length: int) -> None:
    """Factor × number is worked out exactly and rounded once."""
    criterion = Criterion("length", 1, below=Threshold(tenths / 10, "optimal_length"))
    assert criterion.threshold({"optimal_length": length}) == float(Fraction(tenths * length, 10))


def test_threshold_may_count_cells() -> None:
    """A path of 34 moves has 35 cells: 1.1 × (34 + 1) is 38.5 exactly, a mean of which is not below it."""
    criterion = Criterion("length", 2, below=Threshold(1.1, "optimal_length", plus=1))
    assert criterion.threshold({"optimal_length": 34}) == 38.5
    assert when_met(criterion, 38.5, [(38, 0.0), (39, 0.0), (37, 0.0)]) == [False, False, True]
    assert Threshold(1.1, "optimal_length") == Threshold(1.1, "optimal_length", plus=0.0)


@given(tenths=st.integers(1, 50), length=st.integers(1, 200), plus=st.integers(-100, 100))
def test_sum_and_product_are_rounded_once(tenths: int, length: int, plus: int) -> None:
    """Number plus a tenth of ``plus``, times factor, is worked out exactly and rounded once."""
    criterion = Criterion("length", 1, below=Threshold(tenths / 10, "optimal_length", plus=plus / 10))
    assert criterion.threshold({"optimal_length": length}) == float(Fraction(tenths * (10 * length + plus), 100))


def test_window_is_counted_from_the_switch() -> None:
    """With ``after`` 7 and a window of 3 the episodes 7, 8, 9 are the first that can meet it: a train time of 10."""
    criterion = Criterion("length", 3, below=5.0, after=7)
    assert when_met(criterion, 5.0, [(1, 0.0)] * 12).index(True) + 1 == 7 + 3
    # The good episodes before the switch do not make up for a bad one after it: (20 + 1 + 1) / 3 > 5.
    lengths = [1] * 7 + [20, 1, 1, 1]
    assert when_met(criterion, 5.0, [(length, 0.0) for length in lengths]) == [False] * 10 + [True]


def test_mean_on_the_threshold_is_not_below_it() -> None:
    """Of lengths 37 and 38, three to two, the mean is exactly 37.4, which is not below 1.1 × 34; one move less is."""
    criterion = Criterion("length", 5, below=Threshold(1.1, "optimal_length"))
    threshold = criterion.threshold({"optimal_length": 34})
    # (3 · 37 + 2 · 38) / 5 = 187 / 5 = 37.4; with another 37 for a 38: 186 / 5 = 37.2.
    lengths = [37, 38, 37, 38, 37, 37, 37]
    assert when_met(criterion, threshold, [(n, 0.0) for n in lengths]) == [False] * 5 + [False, True]


def test_mean_on_the_threshold_is_at_least_it() -> None:
    """A mean return of exactly 195 solves CartPole (§4.1.2)."""
    criterion = Criterion("return", 4, at_least=195.0)
    returns = [194.0, 196.0, 194.0, 195.9, 194.1, 196.0]
    # Means of four: 194.975, 195.0, 195.0.
    assert when_met(criterion, criterion.threshold({}), [(1, r) for r in returns]) == [False] * 4 + [True, True]


def test_at_least_takes_a_threshold_from_the_environment() -> None:
    """Both bounds may be a multiple of a reported number."""
    assert Criterion("return", 1, at_least=Threshold(0.5, "best")).threshold({"best": 3.0}) == 1.5


def test_window_must_be_full() -> None:
    """The criterion never holds before ``window`` episodes were played, however good they are."""
    criterion = Criterion("length", 50, below=37.4)
    assert when_met(criterion, 37.4, [(1, 0.0)] * 51) == [False] * 49 + [True, True]


def test_measure_is_the_named_one() -> None:
    """'length' looks at lengths only, 'return' at returns only."""
    episodes = [(10, 1.0), (1, 10.0)]
    assert when_met(Criterion("length", 1, below=5.0), 5.0, episodes) == [False, True]
    assert when_met(Criterion("return", 1, below=5.0), 5.0, episodes) == [True, False]


@given(
    measure=st.sampled_from(["length", "return"]),
    direction=st.sampled_from(["below", "at_least"]),
    window=st.integers(1, 8),
    after=st.integers(0, 12),
    bound=st.integers(0, 12),
    episodes=st.lists(st.tuples(st.integers(1, 12), st.integers(0, 12).map(float)), max_size=40),
)
def test_criterion_agrees_with_the_mean_of_the_whole_history(
    measure: str, direction: str, window: int, after: int, bound: int, episodes: list[tuple[int, float]]
) -> None:
    """The running criterion is the plain one: the mean of the last ``window`` measures against the bound, of
    the episodes from ``after`` on.

    Whole numbers, so that the sum is exact; bounds at which ties happen.
    """
    options: dict[str, Any] = {direction: float(bound)}
    criterion = Criterion(measure, window, after=after, **options)  # type: ignore[arg-type]
    expected = []
    for played in range(1, len(episodes) + 1):
        last = [Fraction(int(pair[measure == "return"])) for pair in episodes[after:played]][-window:]
        mean = sum(last) / window
        expected.append(len(last) == window and (mean < bound if direction == "below" else mean >= bound))
    assert when_met(criterion, criterion.threshold({}), episodes) == expected


def test_missing_info_is_named() -> None:
    """A threshold on a number that the environment does not report says which it does report."""
    criterion = Criterion("length", 50, below=Threshold(1.1, "optimal_length"))
    with pytest.raises(ValueError, match=r"info: found 'optimal_length', .* reports: \['height', 'width'\]"):
        criterion.threshold({"width": 3.0, "height": 4.0})


@pytest.mark.parametrize("bounds", [{}, {"below": 1.0, "at_least": 1.0}])
def test_exactly_one_bound(bounds: dict[str, float]) -> None:
    """A criterion has one bound: neither none nor two."""
    with pytest.raises(ValueError, match="expected exactly one"):
        Criterion("length", 50, **bounds)


@pytest.mark.parametrize(
    ("field", "options"),
    [
        ("window", {"measure": "length", "window": 0, "below": 1.0}),
        ("measure", {"measure": "speed", "window": 1, "below": 1.0}),
        ("below", {"measure": "length", "window": 1, "below": math.nan}),
        ("above", {"measure": "length", "window": 1, "above": 1.0}),
    ],
)
def test_criterion_refuses_what_makes_no_sense(field: str, options: dict[str, Any]) -> None:
    """An empty window, an unknown measure, a bound that is no number, an unknown option: refused by name."""
    with pytest.raises(ValueError, match=field):
        Criterion(**options)


def test_threshold_factor_is_positive() -> None:
    """A factor of zero or less would make a bound that nothing meets."""
    with pytest.raises(ValueError, match="factor"):
        Threshold(factor=0.0, info="optimal_length")


def test_what_is_drawn_for_a_run_says_from_when_it_counts() -> None:
    """``$switch`` is the run's own number; a name that is not drawn, and a value that is none, are refused."""
    criterion = Criterion("length", 3, below=5.0, after="$switch")
    assert criterion.of_run({"switch": 7}) == Criterion("length", 3, below=5.0, after=7)
    assert Criterion("length", 3, below=5.0, after=2).of_run({"switch": 7}).after == 2
    with pytest.raises(ValueError, match=r"after: found '\$switch', expected one of the variables \['swich'\]"):
        criterion.of_run({"swich": 7})
    for value in (-1, 1.5, "soon", True):
        with pytest.raises(ValueError, match=f"after: found {value!r}, drawn for '.switch', expected a number"):
            criterion.of_run({"switch": value})
    with pytest.raises(ValueError, match="after"):
        criterion.parameters()


def test_runs_of_a_shard_count_from_episodes_of_their_own() -> None:
    """Of two runs that both play well, one counts from episode 2 on, the other from 5: with a window of 3 they meet the
    criterion after 5 and 8 episodes, and where one needs more episodes than there are the book is not opened.
    """
    criterion, drawn = Criterion("length", 3, below=5.0, after="$switch"), [{"switch": 2}, {"switch": 5}]
    book = open_book(Fixed(), 1, 20, criterion, [1, 2], [{}, {}], run_variables=drawn)
    for run in (0, 1):
        while book.status[run] == RUNNING:
            advance_run(book, Fixed(), run, 4, -4.0, -4.0, 4.0)
    assert book.train_time.tolist() == [5, 8]
    with pytest.raises(ValueError, match="found 7 episodes, expected at least 8: a window of 3 after episode 5"):
        open_book(Fixed(), 1, 7, criterion, [1, 2], [{}, {}], run_variables=drawn)
