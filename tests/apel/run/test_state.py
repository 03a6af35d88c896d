from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from apel.experience.trajectory import Episodes
from apel.numerics.seeding import Role, make_stream
from apel.run import state as apel_book
from apel.run.criterion import Criterion, Threshold, measure_of
from apel.run.impossible import ImpossibleStateError
from apel.run.opening import open_book
from apel.run.selection import Selector, common_blocks
from apel.run.state import FINISHED, NOT_FINITE, POSITION, RUNNING, Book, is_compiled, replay
from apel.selectors import Apel, Fixed, Ssbas, Uniform
from tests.apel.plain_selector import PlainSelector

BELOW_10 = Criterion("length", 3, below=10.0)


def book_of(
    selector: Selector,
    *,
    num_learners: int = 2,
    num_episodes: int = 50,
    criterion: Criterion | None = None,
    num_runs: int = 2,
    **options: Any,
) -> Book:
    return open_book(selector, num_learners, num_episodes, criterion, list(range(num_runs)), [{}] * num_runs, **options)


def episodes_of(rows: Sequence[tuple[int, int, int, float]]) -> Episodes:
    """From (run, episode, length, return); the performance is the return."""
    episodes = Episodes.empty(len(rows))
    for i, (run, episode, length, total) in enumerate(rows):
        for column, value in zip(episodes, (run, episode, length, total, total, float(length), True), strict=True):
            column[i] = value
    return episodes


def advance_run(book: Book, selector: Any, run: int, length: int, total: float, performance: float) -> None:
    """`apel.run.state.advance_run` with the criterion's measure of the episode itself."""
    measure = measure_of(book.criterion_parameters[run], length, total)
    apel_book.advance_run(book, selector, run, length, total, performance, measure)


def assert_same_books(one: Book, other: Book) -> None:
    for name, left, right in zip(Book._fields, one, other, strict=True):
        np.testing.assert_array_equal(left, right, err_msg=name)


def test_opened_book() -> None:
    """Before the first episode nothing was played, every run is under way, and its first learner is selected."""
    book = book_of(Apel(), num_learners=3)
    assert book.episode.tolist() == book.steps.tolist() == [0, 0]
    assert book.status.tolist() == [RUNNING] * 2
    assert book.train_time.tolist() == [-1, -1]
    assert book.selector_state.shape == (2, 9)
    for run in range(2):
        state, stream = Apel().initial_state(3, 50), make_stream(run, Role.SELECTOR)
        assert book.learner[run] == Apel().select(Apel().parameters(), 3, state, stream)
        np.testing.assert_array_equal(book.selector_state[run], state)
        np.testing.assert_array_equal(book.selector_stream[run], stream)


def test_thresholds_are_those_of_each_run() -> None:
    """Each run's threshold follows from what its own environment reports; without a criterion nothing is ever met."""
    criterion = Criterion("length", 3, below=Threshold(1.1, "optimal_length"))
    infos = [{"optimal_length": 34.0}, {"optimal_length": 30.0}]
    assert open_book(Apel(), 2, 9, criterion, [1, 2], infos).threshold.tolist() == [37.4, 33.0]
    assert open_book(Apel(), 2, 9, None, [1, 2], infos).threshold.tolist() == [-math.inf] * 2


@pytest.mark.parametrize(
    "selector", [Apel(decay=0.1), Ssbas(), Uniform(), Fixed()], ids=lambda selector: type(selector).__name__
)
@settings(max_examples=20)
@given(
    played=st.lists(st.tuples(st.integers(0, 1), st.integers(1, 20), st.integers(-5, 5).map(float)), max_size=60),
    recorded=st.lists(st.booleans(), min_size=40, max_size=40),
    stops=st.booleans(),
)
def test_compiled_and_plain_selectors_give_one_book(
    selector: Selector, played: list[tuple[int, int, float]], recorded: list[bool], stops: bool
) -> None:
    """Advancing and replaying, compiled or plain, lead to the same book and the same rows.

    Runs are interleaved at random; episodes of a run that is over are left out.
    """
    plain = PlainSelector(selector)
    assert is_compiled(selector)
    assert not is_compiled(plain)
    options: dict[str, Any] = {"num_episodes": 40, "criterion": BELOW_10, "stops_when_met": stops}
    advanced, rows, headers = book_of(selector, **options), [], []
    for run, length, total in played:
        if advanced.status[run] != RUNNING:
            continue
        if recorded[advanced.episode[run]]:
            rows.append((run, int(advanced.episode[run]), int(advanced.learner[run]), total, length))
            headers.append(np.concatenate(common_blocks(advanced.selector_state[run], 2)))
        advance_run(advanced, selector, run, length, total, total)
    by_hand = book_of(plain, **options)
    episodes = []
    for run, length, total in played:
        if by_hand.status[run] == RUNNING:
            episodes.append((run, int(by_hand.episode[run]), length, total))
            advance_run(by_hand, plain, run, length, total, total)
    assert_same_books(by_hand, advanced)
    for one in (selector, plain):
        book = book_of(one, **options)
        answer = replay(book, one, episodes_of(episodes), np.array(recorded))
        assert_same_books(book, advanced)
        columns = (answer.run, answer.episode, answer.selected, answer.episode_return, answer.length)
        assert list(zip(*(column.tolist() for column in columns), strict=True)) == rows
        np.testing.assert_array_equal(answer.header, np.array(headers).reshape(-1, 6))


def test_rows_hold_the_state_at_selection() -> None:
    """A row says with what probability and on what estimates its learner was chosen, not what the episode changed."""
    book = book_of(Fixed(), num_runs=1)
    rows = replay(book, Fixed(), episodes_of([(0, 0, 5, 1.5), (0, 1, 6, 2.5)]), np.ones(50, dtype=np.bool_))
    nan = math.nan
    expected = [[1.0, 0.0, nan, nan, nan, nan], [1.0, 0.0, 1.5, nan, nan, nan]]
    np.testing.assert_array_equal(rows.header, expected)
    assert book.selector_state[0, 2] == 2.5


@pytest.mark.parametrize("selector", [Apel(), PlainSelector(Apel())], ids=["compiled", "plain"])
@pytest.mark.parametrize(
    ("episodes", "run", "expected", "found", "story"),
    [
        # the first is missing
        ([(0, 1, 5, 0.0)], 0, 0, 1, "of 1 episodes, this run's before it: no episode"),
        # one in the middle is missing
        ([(0, 0, 5, 0.0), (0, 2, 5, 0.0)], 0, 1, 2, "of 2 episodes, this run's before it: episodes 0 to 0 (1)"),
        # one comes twice
        ([(0, 0, 5, 0.0), (0, 0, 5, 0.0)], 0, 1, 0, "of 2 episodes, this run's before it: episodes 0 to 0 (1)"),
        # another run's clock is not this one's
        ([(0, 0, 5, 0.0), (1, 1, 5, 0.0)], 1, 0, 1, "of 2 episodes, this run's before it: no episode"),
    ],
)
@pytest.mark.parametrize("records", [True, False])
def test_replay_detects_a_gap(
    selector: Selector,
    episodes: list[tuple[int, int, int, float]],
    run: int,
    expected: int,
    found: int,
    story: str,
    records: bool,
) -> None:
    """Episodes that do not go on where the book stands are a bug, and are reported as one, with run and episode."""
    with pytest.raises(ImpossibleStateError, match="do not go on where the book") as raised:
        replay(book_of(selector), selector, episodes_of(episodes), np.full(50, records))
    facts = raised.value.facts
    assert (facts[POSITION], facts["expected episode"], facts["found episode"]) == (run, expected, found)
    assert facts["status"] == "running"
    assert raised.value.story == (story,)


def test_replay_of_nothing_changes_nothing() -> None:
    """No episodes, no rows, the same book."""
    book = book_of(Apel())
    rows = replay(book, Apel(), episodes_of([]), np.ones(50, dtype=np.bool_))
    assert len(rows.run) == 0
    assert_same_books(book, book_of(Apel()))


@pytest.mark.parametrize("selector", [Apel(), PlainSelector(Apel())], ids=["compiled", "plain"])
@pytest.mark.parametrize(
    ("episode_return", "performance"),
    [(1.0, math.nan), (1.0, math.inf), (1.0, -math.inf), (math.inf, -5.0), (-math.inf, -5.0)],
)
def test_what_is_no_number_stops_the_run(selector: Selector, episode_return: float, performance: float) -> None:
    """The run is marked, and neither selector nor clocks take anything in; other runs go on."""
    book = book_of(selector)
    expected = book_of(selector)
    advance_run(book, selector, 0, 5, episode_return, performance)
    assert book.status.tolist() == [NOT_FINITE, RUNNING]
    book.status[0] = RUNNING
    assert_same_books(book, expected)


@pytest.mark.parametrize("selector", [Apel(), PlainSelector(Apel())], ids=["compiled", "plain"])
def test_run_stops_when_its_criterion_is_met(selector: Selector) -> None:
    """The train time counts episodes from one, the run is over at once, and only that run."""
    book = book_of(selector, criterion=BELOW_10)
    # Means of three: 12, 10 (not below), 29/3.
    for length in (14, 12, 10, 8, 11):
        advance_run(book, selector, 0, length, 0.0, 0.0)
    assert book.train_time.tolist() == [5, -1]
    assert book.status.tolist() == [FINISHED, RUNNING]
    assert book.episode.tolist() == [5, 0]
    assert book.steps.tolist() == [55, 0]


def test_run_that_does_not_stop_keeps_its_first_train_time() -> None:
    """With ``stops_when_met`` off, the run goes on to its cap, and later windows do not overwrite the train time."""
    book = book_of(Apel(), criterion=BELOW_10, num_episodes=10, stops_when_met=False)
    for length in (9, 9, 9, 99, 99, 99, 9, 9, 9):
        advance_run(book, Apel(), 0, length, 0.0, 0.0)
        assert book.status[0] == RUNNING
    advance_run(book, Apel(), 0, 9, 0.0, 0.0)
    assert (book.status[0], book.train_time[0], book.episode[0]) == (FINISHED, 3, 10)


def test_run_at_its_cap_is_censored() -> None:
    """A run that reaches its cap is over without a train time: censored, not solved at the cap."""
    book = book_of(Apel(), criterion=BELOW_10, num_episodes=4)
    for _ in range(4):
        assert book.status[0] == RUNNING
        advance_run(book, Apel(), 0, 20, 0.0, 0.0)
    assert (book.status[0], book.train_time[0], book.episode[0], book.steps[0]) == (FINISHED, -1, 4, 80)


def test_criterion_met_in_the_last_episode_counts() -> None:
    """Meeting the criterion exactly at the cap is a train time, not a censored run."""
    book = book_of(Apel(), criterion=BELOW_10, num_episodes=3)
    for _ in range(3):
        advance_run(book, Apel(), 0, 9, 0.0, 0.0)
    assert (book.status[0], book.train_time[0]) == (FINISHED, 3)


def test_nobody_is_selected_after_the_end() -> None:
    """The selector's stream stands still once a run is over, so that resuming or not changes no draw."""
    book = book_of(Apel(), num_episodes=2)
    advance_run(book, Apel(), 0, 1, 0.0, 0.0)
    stream = book.selector_stream[0].copy()
    advance_run(book, Apel(), 0, 1, 0.0, 0.0)
    np.testing.assert_array_equal(book.selector_stream[0], stream)


def test_books_do_not_share_memory() -> None:
    """Two runs of one book, and two books, have states of their own."""
    book, other = book_of(Apel(decay=0.0)), book_of(Apel(decay=0.0))
    for length in range(1, 30):
        advance_run(book, Apel(decay=0.0), 0, length, float(length), float(length))
    assert_same_books(other, book_of(Apel(decay=0.0)))
    np.testing.assert_array_equal(book.selector_state[1], other.selector_state[1])


def test_prior_of_the_wrong_length_is_refused_when_the_book_is_opened() -> None:
    """A selector that does not fit the number of learners is refused before the first episode."""
    with pytest.raises(ValueError, match="prior: found 2 concentrations, expected one per learner, 3"):
        book_of(Apel(prior=(1.0, 2.0)), num_learners=3)


def test_criterion_that_cannot_be_met_is_refused() -> None:
    """A window that does not fit between the switch and the cap is refused when the book is opened; one that fits can
    be met in the last episode.
    """
    with pytest.raises(ValueError, match="found 50 episodes, expected at least 51: a window of 3 after episode 48"):
        book_of(Fixed(), num_learners=1, criterion=Criterion("length", 3, below=10.0, after=48))
    book = book_of(Fixed(), num_learners=1, criterion=Criterion("length", 3, below=10.0, after=47))
    for _ in range(50):
        advance_run(book, Fixed(), 0, 1, 0.0, 0.0)
    assert (book.train_time[0], book.status[0]) == (50, FINISHED)


def test_steady_state_sums_the_last_returns() -> None:
    """Of the 50 episodes the last 4 count, in the order of play: 46 … 49."""
    book = book_of(Fixed(), num_learners=1, steady_state_episodes=4)
    for episode in range(50):
        advance_run(book, Fixed(), 0, 1, 0.1 * episode, 0.0)
    assert book.late_return[0] == ((0.1 * 46 + 0.1 * 47) + 0.1 * 48) + 0.1 * 49
    assert book.late_return[1] == 0.0
