from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from apel.building import make_selector, registry
from apel.configs import SelectorConfig
from apel.run.floor import ActingFloor
from apel.run.opening import open_book
from apel.run.selection import Selector, common_blocks
from apel.run.state import RUNNING, Book, advance_run
from apel.selectors import Apel, Fixed
from tests.apel.plain_selector import PlainSelector

EPISODES = 1000


def opened(selector: Selector, num_learners: int, floor: float, seed: int = 1) -> Book:
    """The book of one run."""
    acting_floor = ActingFloor(floor) if floor else None
    return open_book(selector, num_learners, EPISODES, None, [seed], [{}], acting_floor=acting_floor)


def played(book: Book, selector: Selector, lengths: np.ndarray, seed: int = 0) -> np.ndarray:
    """Steps of each learner, whose episodes have mean lengths ``[episodes, learners]``, after all episodes."""
    rng, steps = np.random.default_rng(seed), np.zeros(book.num_learners, dtype=np.int64)
    while book.status[0] == RUNNING:
        learner = int(book.learner[0])
        length = 1 + int(rng.poisson(lengths[book.episode[0], learner]))
        steps[learner] += length
        advance_run(book, selector, 0, length, -float(length), -float(length), 0.0)
    np.testing.assert_array_equal(book.acting_steps[0], steps)
    return steps


@given(
    num_learners=st.integers(2, 6),
    part=st.floats(0.1, 0.9),
    lengths=st.lists(st.floats(1.0, 300.0), min_size=6, max_size=6),
    growth=st.sampled_from([0.1, 1.0, 10.0]),
    seed=st.integers(0, 2**31),
)
@settings(max_examples=12)
def test_everybody_has_the_share(
    num_learners: int, part: float, lengths: list[float], growth: float, seed: int
) -> None:
    """Of a thousand episodes, whatever their lengths and while these grow or fall tenfold, every learner has its share
    of the steps, though the selector always wants the first; where they do not change, not much more.
    """
    selector, floor = Fixed(), part / num_learners
    trend = growth ** np.linspace(0.0, 1.0, EPISODES)[:, None]
    means = np.array(lengths[:num_learners]) * trend
    steps = played(opened(selector, num_learners, floor, seed), selector, means, seed)
    shares = steps / steps.sum()
    # One episode more or less of the longest kind than is due, ten times over.
    slack = 10.0 * means[-1].max() / steps.sum()
    assert shares.min() >= floor - max(slack, 0.01)
    if growth == 1.0:
        assert shares[1:].max() <= floor + max(2 * slack, 0.05)


def test_equal_lengths_give_the_rule() -> None:
    """With episodes of one length p becomes (1 − nρ) p + ρ, and this is what is recorded."""
    selector = Fixed()
    book = opened(selector, 4, 0.1)
    for _ in range(300):
        probability, _, _ = common_blocks(book.selector_state[0], 4)
        lacking = np.maximum(0.0, 0.1 * book.acting_steps[0].sum() - book.acting_steps[0]) / 20.0 / 7.0
        np.testing.assert_allclose(probability, [1.0 - 0.3 - lacking[1:].sum(), *(0.1 + lacking[1:])], atol=1e-12)
        advance_run(book, selector, 0, 7, 1.0, 1.0, 0.0)


@pytest.mark.parametrize("name", sorted(registry.SELECTORS))
def test_every_selector_takes_it(name: str) -> None:
    """Probabilities stay probabilities, and nobody is left out."""
    selector = make_selector(SelectorConfig(name))
    book = opened(selector, 3, 0.2)
    steps = np.zeros(3)
    while book.status[0] == RUNNING:
        probability, _, _ = common_blocks(book.selector_state[0], 3)
        assert probability.min() >= 0.0
        assert probability.sum() == pytest.approx(1.0)
        learner = int(book.learner[0])
        steps[learner] += 10
        advance_run(book, selector, 0, 10, float(learner), float(learner), 0.0)
    assert steps.min() >= 0.19 * steps.sum()


def test_compiled_and_plain_agree() -> None:
    """A selector that is not compiled gets the same floor, to the last bit."""
    lengths = np.array([5.0, 40.0, 9.0]) * np.ones((EPISODES, 1))
    books = []
    for selector in (Apel(), PlainSelector(Apel())):
        books.append(opened(selector, 3, 0.1))
        played(books[-1], selector, lengths)
    for one, other in zip(*books, strict=True):
        np.testing.assert_array_equal(one, other)


def test_without_a_floor_nothing_is_counted() -> None:
    """A floor of none changes nothing, nor does one for a single learner."""
    alone, none = opened(Fixed(), 1, 0.5), opened(Apel(), 2, 0.0)
    assert (alone.floor, none.floor) == (0.0, 0.0)
    for _ in range(50):
        advance_run(none, Apel(), 0, 7, 1.0, 1.0, 0.0)
    assert none.acting_steps.sum() == 0


def test_more_than_there_is() -> None:
    """Three learners cannot have half of the steps each."""
    with pytest.raises(
        ValueError, match=r"acting_floor: found 0.5 of the steps for each of 3 learners, expected at most 0.333"
    ):
        opened(Fixed(), 3, 0.5)


@pytest.mark.parametrize("make", [Apel, lambda: PlainSelector(Apel())])
def test_begins_after_so_many_steps(make: Callable[[], Selector]) -> None:
    """Until the run has ``after`` steps everything is as without a floor; from then on it is one of the rest of the
    run, which asks nobody to make up for what was before.
    """
    floors = None, ActingFloor(0.25, after=3000)
    free, late = (open_book(make(), 2, EPISODES, None, [1], [{}], acting_floor=floor) for floor in floors)
    books = {"free": free, "late": late}
    for _ in range(300):
        assert late.learner[0] == free.learner[0]
        np.testing.assert_array_equal(late.selector_state, free.selector_state)
        for book in books.values():
            advance_run(book, make(), 0, 10, 1.0, float(book.learner[0] == 0), 0.0)
    assert late.acting_steps.sum() == 0
    probability, _, _ = common_blocks(late.selector_state[0], 2)
    assert probability[1] >= 0.25 - 1e-12
    while late.status[0] == RUNNING:
        advance_run(late, make(), 0, 10, 1.0, float(late.learner[0] == 0), 0.0)
    assert late.acting_steps.sum() == 7000
    assert 0.24 <= late.acting_steps[0, 1] / 7000 <= 0.30


def test_begins_after_the_end() -> None:
    """A floor that never comes is a mistake."""
    with pytest.raises(ValueError, match="acting_floor: after: found 500, expected less than the 500 steps of a run"):
        open_book(Fixed(), 2, EPISODES, None, [1], [{}], num_steps=500, acting_floor=ActingFloor(0.1, after=500))
