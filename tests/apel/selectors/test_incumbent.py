"""The rule of incumbent, rehearsals and duels, held against what its docstring derives."""

from __future__ import annotations

import math
import random
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from apel.selectors import Incumbent
from apel.selectors.comparing import are_tied, deviations_behind, score
from apel.selectors.incumbent import LAYOUT, IncumbentState
from tests.apel.selectors.clock import Clock


def seen(clock: Clock) -> IncumbentState:
    """The state by name."""
    view: IncumbentState = LAYOUT.view(clock.state, clock.num_learners)
    return view


def begun(selector: Incumbent, *performances: float, seed: int = 0) -> Clock:
    """After each learner's first episode, in their order."""
    clock = Clock(selector, len(performances), seed=seed)
    for learner, performance in enumerate(performances):
        clock.observe(learner, performance)
    return clock


def play(clock: Clock, episodes: int, performance: Callable[[int], float]) -> list[int]:
    """Who played."""
    selected = []
    for _ in range(episodes):
        selected.append(clock.select())
        clock.observe(selected[-1], performance(selected[-1]))
    return selected


def test_golden_trace() -> None:
    """By hand, ρ = 1/4 and δ = 1/4: B = 1/ρ = 4, b = 1/δ − 1 = 3, m = ⌈16/3⌉ = 6."""
    clock = begun(Incumbent(rehearsal_share=0.25, takeover_error=0.25), 5.0, 3.0)
    assert seen(clock).incumbent[0] == 0  # 5 > 3

    # Learner 1 has played the 2nd episode: it is due again after min(4, 2) more, and loses: S = −1.
    assert play(clock, 3, lambda learner: (5.0, 3.0)[learner]) == [0, 0, 1]
    assert (seen(clock).lead[0], seen(clock).challenger[0]) == (-1.0, -1.0)

    # It is 2 behind, without any deviation, in an incumbency that began after 1 episode: z is at most 1 + u/4. So it is
    # due w episodes after these 5 where w ≥ 4 √z, or 5, times a factor that is drawn after the burst.
    assert play(clock, 1, lambda learner: (5.0, 6.0)[learner]) == [0]
    pace = seen(clock).pace[0]
    due = next(w for w in range(1, 20) if w >= pace * min(4.0 * math.sqrt(1.0 + (5 + w - 1) / 4), 5.0))
    assert play(clock, due, lambda learner: (5.0, 6.0)[learner]) == [0] * (due - 1) + [1]
    assert (seen(clock).lead[0], seen(clock).challenger[0]) == (1.0, 1.0)

    # The duel: a tie adds nothing, a defeat takes one away, and of three wins in all the third one takes over.
    for performance, lead, incumbent in ((5.0, 1.0, 0), (6.0, 2.0, 0), (4.0, 1.0, 0), (7.0, 2.0, 0), (7.0, 3.0, 1)):
        assert clock.select() == 1
        clock.observe(1, performance)
        assert (seen(clock).lead[0], seen(clock).incumbent[0]) == (lead, incumbent)
    assert seen(clock).num_compared[1] == 6  # what it played in the duel stands for it, not what came before


def test_stated_quantities_give_the_constants() -> None:
    """δ = .05: a lead of 19, a memory of ⌈1/(3 · .0025)⌉ = 134; δ = .1: 9 and 34; never fewer than five."""
    assert [(round(s.bound, 9), s.memory) for s in (Incumbent(), Incumbent(takeover_error=0.1))] == [(19, 134), (9, 34)]
    assert Incumbent(takeover_error=0.5).memory == 5


def test_score_is_a_difference_of_probabilities() -> None:
    """Of 1, 2, 2, 5: 2 beats one, ties with two, loses against one; 3 beats three of four."""
    reference = np.array([1.0, 2.0, 2.0, 5.0])
    assert [score(r, reference) for r in (0.0, 2.0, 3.0, 9.0)] == [-1.0, 0.0, 0.5, 1.0]


def test_deviations_behind() -> None:
    """The median of 1, 9, 4, 8 is 6; 2 and 4 have a mean of 3 and a deviation of √2: 3/√2 behind, cut to 1 and most."""
    reference = np.array([1.0, 9.0, 4.0, 8.0])
    cases = (([2.0, 4.0], 9.0, 3 / math.sqrt(2)), ([2.0, 4.0], 2.0, 2.0), ([5.0, 7.0], 9.0, 1.0), ([2.0], 9.0, 1.0))
    for few, most, expected in (*cases, ([2.0, 2.0], 9.0, 9.0), ([1e300, -1e300], 9.0, 1.0)):
        assert deviations_behind(np.array(few), reference, most) == pytest.approx(expected)


@given(
    scale=st.sampled_from([2.0**k for k in (-20, -1, 3, 30)]),
    shift=st.sampled_from([0.0, -8.0, 1024.0]),
    seed=st.integers(0, 2**32),
    num_learners=st.integers(2, 4),
)
@settings(max_examples=20)
def test_free_of_unit_and_origin(scale: float, shift: float, seed: int, num_learners: int) -> None:
    """Selections do not change where performances are measured in another unit, from another origin."""
    draw = random.Random(seed)
    table = [[float(draw.randint(0, 7) + k) for k in range(num_learners)] for _ in range(150)]
    one, two = (Clock(Incumbent(0.1, 0.2), num_learners, seed=seed) for _ in range(2))
    for row in table:
        selected = one.select()
        assert two.select() == selected
        one.observe(selected, row[selected])
        two.observe(selected, scale * (row[selected] + shift))


@given(num_learners=st.integers(2, 6), share=st.sampled_from([0.02, 0.1, 0.3]), seed=st.integers(0, 2**32))
@settings(max_examples=8)
def test_rehearsals_are_at_most_their_share(num_learners: int, share: float, seed: int) -> None:
    """Of learners that never win and are about one deviation behind; at first, when intervals double, log₂ B more each.

    A factor of ½ to 3/2 with a mean of 1 and a variance of 1/12: over k bursts the mean is within 3/√(12 k) of 1.
    """
    draw = random.Random(seed)
    clock = begun(Incumbent(rehearsal_share=share), 0.0, *[-1.0] * (num_learners - 1), seed=seed)
    episodes, shortest = 500, (num_learners - 1) / share
    selected = play(clock, episodes, lambda learner: 0.0 if learner == 0 else -draw.random())
    bursts = episodes / shortest
    most = bursts * (1.0 + 3.0 / math.sqrt(12.0 * bursts)) + math.log2(shortest) + 2.0
    assert all(1 <= selected.count(k) <= most for k in range(1, num_learners))


def test_hopeless_learners_are_rehearsed_ever_less() -> None:
    """With B = 20, at most 2 (√101 − 1) = 18.1 times in 2 000 episodes, and log₂ 20 = 4.3 times when intervals double.

    An interval is what it has become at its end, √(B u) + B/2 where it began at u, so that 18.1 loses
    ln(1 + 2 √100) = 3.0.
    """
    counts = [
        play(begun(Incumbent(0.05), 0.0, -1.0, seed=seed), 2000, lambda learner: -float(learner)).count(1)
        for seed in range(3)
    ]
    assert np.mean(counts) == pytest.approx(18.1 - 3.0 + 4.3, abs=2.0)


@pytest.mark.parametrize("whole", [True, False])
def test_false_takeovers_are_rarer_than_stated(whole: bool) -> None:
    """Of two learners that are equal, at most a share δ of the rehearsals ends in a takeover.

    For wins and losses the exact rate is 1/(2 b); the bound holds for any distribution, here a normal one.
    """
    draw, selector = random.Random(2), Incumbent(rehearsal_share=0.2, takeover_error=0.1)
    clock = begun(selector, 0.0, 0.0)
    rehearsals = takeovers = 0
    for _ in range(3000):
        incumbent, in_duel = seen(clock).incumbent[0], seen(clock).challenger[0] >= 0.0
        selected = clock.select()
        clock.observe(selected, float(draw.random() < 0.5) if whole else draw.gauss(0.0, 1.0))
        rehearsals += selected != incumbent and not in_duel
        takeovers += seen(clock).incumbent[0] != incumbent
    assert rehearsals > 100
    assert takeovers / rehearsals < selector.takeover_error


def test_delay_after_a_change() -> None:
    """I/2 + b where the challenger always wins from some episode on, (1 + 1/12) I/2 as intervals vary: 15.3 + 9.

    δ = .1: b = 9; ρ = .04: B = 25. Of five performances that are 0 or −1 with probability ½ the mean of √z is 1.13
    (1 up to two −1, then 1.05, 1.34, and at most √11 with five): I = 28.3. The standard error of 30 runs is 1.6.
    """
    delays = []
    for seed in range(30):
        draw = random.Random(seed)
        clock = begun(Incumbent(0.04, 0.1), 0.0, -1.0, seed=seed)
        play(clock, 250, lambda learner, draw=draw: -float(learner * draw.randint(0, 1)))  # type: ignore[misc]
        delays.append(0)
        while seen(clock).incumbent[0] == 0.0:
            play(clock, 1, float)
            delays[-1] += 1
    assert np.mean(delays) == pytest.approx(24.3, abs=4.0)


def test_others_that_a_floor_lets_play_do_not_end_a_duel() -> None:
    """With an acting floor anybody may play at any time: the duel goes on where it stood."""
    clock = begun(Incumbent(), 3.0, 2.0, 1.0)
    clock.observe(1, 9.0)
    assert (seen(clock).challenger[0], seen(clock).lead[0]) == (1.0, 1.0)
    for learner, performance in ((2, 9.0), (0, 3.0)):
        clock.observe(learner, performance)
        assert (seen(clock).challenger[0], seen(clock).lead[0]) == (1.0, 1.0)
        assert clock.select() == 1


def test_those_that_are_alike_take_turns() -> None:
    """Where nobody has succeeded all try, in turns; one that succeeds plays on until its lead is b = 4, ties or not."""
    clock = begun(Incumbent(takeover_error=0.2), -1.0, -1.0, -1.0)
    assert sorted(play(clock, 3, lambda _: -1.0)) == [0, 1, 2]
    selected = play(clock, 60, lambda _: -1.0)
    assert [selected.count(k) for k in range(3)] == [20, 20, 20]
    lucky = next(k for k in range(3) if k != seen(clock).incumbent[0])
    clock.observe(lucky, 0.0)
    assert play(clock, 2, lambda _: -1.0) == [lucky] * 2
    assert play(clock, 3, lambda _: 0.0) == [lucky] * 3
    assert seen(clock).incumbent[0] == lucky


def test_a_duel_has_an_end() -> None:
    """A win and then nothing but ties: after m = ⌈1/(3 · .04)⌉ = 9 episodes it is over, and all take turns again."""
    clock = begun(Incumbent(takeover_error=0.2), -1.0, -1.0, -1.0)
    clock.observe(1, 0.0)
    assert play(clock, 8, lambda _: -1.0) == [1] * 8
    assert seen(clock).challenger[0] == -1.0
    assert set(play(clock, 6, lambda _: -1.0)) == {0, 1, 2}


@pytest.mark.parametrize(
    ("few", "reference", "tied"),
    [
        ([1.0, 1.0], [1.0, 1.0, 1.0], True),
        ([1.0, 2.0], [1.0, 1.0, 1.0], False),
        ([1.0, 1.0], [1.0, 1.0, 2.0], False),
        ([2.0, 2.0], [1.0, 1.0, 1.0], False),
    ],
)
def test_tied_are_equal_numbers_alone(few: list[float], reference: list[float], tied: bool) -> None:
    """All of both have to be the same: one that differs on either side is no tie."""
    assert are_tied(np.array(few), np.array(reference)) is tied
