"""What is remembered, and what is drawn from it: rings of transitions, and their priorities (Schaul et al. 2016)."""

from __future__ import annotations

import math

import numpy as np
import pytest
from gymnasium import spaces
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy import stats

from apel.learners.deep.prioritised import PriorityOptions, draw_by_priority
from cluster.checkpoint import pack, unpack
from tests.apel.learners.deep.memories import PriorityTrees, Ring, acting_streams, sampling_streams
from tests.apel.learners.deep.steps import runs_of, transitions
from tests.apel.splitmix import SplitMix64

PAIRS = spaces.Box(-np.inf, np.inf, (2,))


def ring(capacity: int = 4, num_runs: int = 2) -> Ring:
    return Ring(num_runs, capacity, PAIRS)


def fill(memory: Ring, run: int, numbers: range) -> list[int]:
    """Transition n is (n, n) → (−n, −n) with action n mod 3, reward n / 2, terminated where n is odd."""
    slots: list[int] = []
    for n in numbers:
        step = transitions(
            [[n, n]], [[-n, -n]], action=n % 3, reward=n / 2, terminated=n % 2 == 1, truncated=n % 2 == 0
        )
        slots += memory.add(runs_of(run), step).tolist()
    return slots


# The ring.


def test_what_is_added_is_what_is_taken() -> None:
    """Every field comes back, by run and slot; a truncated step is not a terminated one."""
    memory = ring()
    memory.add(
        runs_of(0, 1),
        transitions(
            [[1, 2], [3, 4]],
            [[5, 6], [7, 8]],
            action=[2, 1],
            reward=[0.5, -1.5],
            terminated=[True, False],
            truncated=True,
        ),
    )
    batch = memory.take(runs_of(0, 1), np.zeros((2, 1), dtype=np.int64))
    assert batch.observation.tolist() == [[[1.0, 2.0]], [[3.0, 4.0]]]
    assert batch.next_observation.tolist() == [[[5.0, 6.0]], [[7.0, 8.0]]]
    assert batch.action.tolist() == [[2], [1]]
    assert batch.reward.tolist() == [[0.5], [-1.5]]
    assert batch.terminated.tolist() == [[True], [False]]
    assert (batch.observation.dtype, batch.action.dtype, batch.reward.dtype) == (np.float32, np.int64, np.float32)


def test_the_oldest_is_overwritten() -> None:
    """A full ring of 4 keeps the last 4; each run counts its own."""
    memory = ring()
    assert fill(memory, 1, range(3)) == [0, 1, 2]
    assert memory.size.tolist() == [0, 3]
    assert fill(memory, 1, range(3, 11)) == [3, 0, 1, 2, 3, 0, 1, 2]
    assert memory.size.tolist() == [0, 4]
    kept = memory.take(runs_of(1), np.arange(4)[None]).observation[0, :, 0]
    assert sorted(kept.tolist()) == [7.0, 8.0, 9.0, 10.0]
    assert fill(memory, 0, range(1)) == [0]
    assert memory.size.tolist() == [1, 4]


def test_slots_are_drawn_uniformly() -> None:
    """20 000 draws of each of two runs with 7 and 3 transitions: chi-square with p > 0.001, and nothing beyond."""
    memory = ring(capacity=10)
    fill(memory, 0, range(7))
    fill(memory, 1, range(3))
    slots = memory.draw(runs_of(0, 1), 20_000, sampling_streams([5, 6]))
    for run, size in enumerate([7, 3]):
        counts = np.bincount(slots[run])
        assert len(counts) == size
        assert stats.chisquare(counts).pvalue > 0.001


def test_draws_are_those_of_the_runs_stream() -> None:
    """A run's slots follow from its own stream, whoever is drawn for beside it; the oracle is plain SplitMix64."""
    memory = ring(num_runs=3)
    for run in range(3):
        fill(memory, run, range(run + 2))
    streams = sampling_streams([11, 12, 13])
    states = [(int(state), int(gamma)) for state, gamma in streams]
    slots = memory.draw(runs_of(0, 2), 6, streams)
    for row, run in enumerate([0, 2]):
        plain = SplitMix64(*states[run])
        assert slots[row].tolist() == [plain.integer(run + 2) for _ in range(6)]
    assert (int(streams[1][0]), int(streams[1][1])) == states[1]


def test_actions_and_minibatches_have_streams_of_their_own() -> None:
    """What a run's learner does must not be correlated with what it draws from memory, nor with other runs."""
    streams = [*acting_streams([1, 2]), *sampling_streams([1, 2])]
    assert len({int(state) for state, _ in streams}) == 4
    assert len({int(increment) for _, increment in streams}) == 4


@pytest.mark.parametrize("before", [0, 3, 9])
def test_restored_ring_goes_on_identically(before: int) -> None:
    """A state that went through a file gives the same contents and the same next slots, in a ring that was in use."""
    memory, other = ring(), ring()
    fill(memory, 0, range(before))
    fill(memory, 1, range(20, 22))
    fill(other, 0, range(50, 56))
    other.restore(unpack(pack(memory.state())))
    assert other.size.tolist() == memory.size.tolist()
    assert fill(other, 0, range(30, 35)) == fill(memory, 0, range(30, 35))
    for run in (0, 1):
        slots = np.arange(memory.size[run])[None]
        for one, same in zip(memory.take(runs_of(run), slots), other.take(runs_of(run), slots), strict=True):
            np.testing.assert_array_equal(one, same)


def test_state_is_a_snapshot() -> None:
    """What comes later does not change a state; only what is filled is in it."""
    memory = ring(capacity=1000)
    fill(memory, 0, range(3))
    state = memory.state()
    before = [column.copy() for column in state["columns"]]
    assert {column.shape[1] for column in before} == {3}
    fill(memory, 0, range(100, 1101))
    assert all(np.array_equal(one, same) for one, same in zip(state["columns"], before, strict=True))
    assert state["added"].tolist() == [3, 0]


# Priorities.


EPSILON = 2.0**-20
"""So that subtracting it from a small whole number, and adding it again, rounds nothing."""


def tree(capacity: int, masses: NDArray[np.float64]) -> PriorityTrees:
    """Of one run with these masses p^α; the exponent is 1, and the errors lack the ε that is added."""
    priorities = PriorityTrees(1, capacity, PriorityOptions(exponent=1.0, epsilon=EPSILON))
    slots = np.arange(len(masses))[None]
    for slot in range(len(masses)):
        priorities.add(runs_of(0), np.array([slot]))
    priorities.update(runs_of(0), slots, (masses - EPSILON)[None])
    return priorities


def size_of(count: int) -> NDArray[np.int64]:
    return np.array([count])


def draw(
    priorities: PriorityTrees, size: int, batch_size: int, correction: float, seed: int = 1
) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
    slots, weights = priorities.draw(
        runs_of(0), size_of(size), batch_size, np.array([correction]), sampling_streams([seed])
    )
    return slots[0], weights[0]


def test_draws_are_proportional_to_mass() -> None:
    """P(i) = pᵢᵅ / Σ pᵅ: α = ½ makes errors 1, 4, 9, 16 the shares 1 : 2 : 3 : 4; chi-square with p > 0.001.

    With a single draw per call nothing is stratified.
    """
    priorities = PriorityTrees(1, 5, PriorityOptions(exponent=0.5, epsilon=1e-9))
    for slot in range(4):
        priorities.add(runs_of(0), np.array([slot]))
    priorities.update(runs_of(0), np.arange(4)[None], np.array([[1.0, -4.0, 9.0, -16.0]]))
    streams = sampling_streams([7])
    found = [priorities.draw(runs_of(0), size_of(4), 1, np.ones(1), streams)[0][0, 0] for _ in range(8000)]
    assert stats.chisquare(np.bincount(found), 8000 * np.array([0.1, 0.2, 0.3, 0.4])).pvalue > 0.001


def test_exponent_zero_is_uniform() -> None:
    """With α = 0 the errors play no part, neither in the draws nor in the weights."""
    priorities = PriorityTrees(1, 4, PriorityOptions(exponent=0.0))
    for slot in range(4):
        priorities.add(runs_of(0), np.array([slot]))
    priorities.update(runs_of(0), np.arange(4)[None], np.array([[1.0, 50.0, 0.0, 9.0]]))
    slots, weights = draw(priorities, 4, 4000, 0.7)
    assert np.bincount(slots).tolist() == [1000] * 4
    assert weights.tolist() == [1.0] * 4000


@pytest.mark.parametrize(
    ("correction", "expected"),
    [
        # N = 4, p = (0.1, 0.2, 0.3, 0.4). β = 1: 1/(N p) = (2.5, 1.25, 5/6, 0.625), over the largest, 2.5.
        (1.0, [1.0, 0.5, 1 / 3, 0.25]),
        # β = ½: their square roots.
        (0.5, [1.0, 0.5**0.5, 3**-0.5, 0.5]),
        (0.0, [1.0, 1.0, 1.0, 1.0]),
    ],
)
def test_importance_weights_by_hand(correction: float, expected: list[float]) -> None:
    """W = (N p)⁻ᵝ / max w, the largest being that of the rarest transition of the run, drawn or not."""
    slots, weights = draw(tree(4, np.array([1.0, 2.0, 3.0, 4.0])), 4, 40, correction)
    assert set(slots.tolist()) == {0, 1, 2, 3}
    assert weights.tolist() == pytest.approx([expected[slot] for slot in slots], rel=1e-5)


def test_largest_weight_counts_what_was_not_drawn() -> None:
    """One draw of a transition twice as probable as the rarest weighs ½ at β = 1, not 1."""
    priorities = tree(4, np.array([1e-3, 1e3, 1e3]))
    slots, weights = draw(priorities, 3, 8, 1.0)
    assert 0 not in slots
    assert weights.tolist() == pytest.approx([1e-6] * 8, rel=1e-3)


def test_draws_are_stratified() -> None:
    """The j-th of B draws falls into the j-th B-th of the mass: of masses 1, 1, 2 four draws give 0, 1, 2, 2."""
    priorities = tree(3, np.array([1.0, 1.0, 2.0]))
    for seed in range(50):
        assert draw(priorities, 3, 4, 1.0, seed)[0].tolist() == [0, 1, 2, 2]


def test_new_transitions_get_the_largest_priority() -> None:
    """1 in the beginning, then the largest that there has ever been, even where its transition has been overwritten."""
    options = PriorityOptions(exponent=0.5, epsilon=0.25)
    priorities = PriorityTrees(2, 4, options)
    first, second = runs_of(0), runs_of(1)

    def mass_of_new(run: NDArray[np.int64], slot: int) -> float:
        priorities.add(run, np.array([slot]))
        return float(priorities.state()["masses"][run[0], slot])

    assert mass_of_new(first, 0) == 1.0
    # |−8.75| + ¼ = 9, its square root 3.
    priorities.update(first, np.array([[0]]), np.array([[-8.75]]))
    assert mass_of_new(first, 1) == pytest.approx(3.0)
    priorities.update(first, np.array([[0, 1]]), np.array([[0.0, 0.0]]))
    assert mass_of_new(first, 0) == pytest.approx(3.0)
    # The other run has priorities of its own.
    assert mass_of_new(second, 0) == 1.0


def test_priorities_are_absolute_errors_plus_epsilon() -> None:
    """P = (|δ| + ε)ᵅ; of a transition that was drawn twice the later error stays."""
    priorities = PriorityTrees(1, 4, PriorityOptions(exponent=2.0, epsilon=0.5))
    for slot in range(3):
        priorities.add(runs_of(0), np.array([slot]))
    priorities.update(runs_of(0), np.array([[0, 1, 0]]), np.array([[9.0, -1.5, 0.5]]))
    assert priorities.state()["masses"][0, :3].tolist() == pytest.approx([1.0, 4.0, 1.0])


def plain_draw(masses: NDArray[np.float64], batch_size: int, stream: SplitMix64) -> list[int]:
    """The first slot whose cumulative mass exceeds that of the draw."""
    cumulative = np.cumsum(masses)
    marks = [(j + stream.uniform()) / batch_size * cumulative[-1] for j in range(batch_size)]
    return [min(int(np.searchsorted(cumulative, mark, side="right")), len(masses) - 1) for mark in marks]


@settings(max_examples=60)
@given(
    capacity=st.integers(1, 13),
    updates=st.lists(st.tuples(st.integers(0, 12), st.integers(0, 1000)), max_size=40),
    batch_size=st.integers(1, 9),
    seed=st.integers(0, 2**64 - 1),
)
def test_tree_is_the_plain_list(capacity: int, updates: list[tuple[int, int]], batch_size: int, seed: int) -> None:
    """After any updates, for any capacity: draws and weights are those of a cumulative sum over all transitions.

    Masses are whole numbers, so that both add up without rounding.
    """
    masses = np.ones(capacity)
    priorities = tree(capacity, masses)
    for number, mass in updates:
        slot = number % capacity
        masses[slot] = 1.0 + mass
        priorities.update(runs_of(0), np.array([[slot]]), np.array([[masses[slot] - EPSILON]]))
    assert priorities.state()["masses"][0, :capacity].tolist() == masses.tolist()
    slots, weights = draw(priorities, capacity, batch_size, 0.6, seed)
    streams = sampling_streams([seed])
    plain = SplitMix64(int(streams[0][0]), int(streams[0][1]))
    assert slots.tolist() == plain_draw(masses, batch_size, plain)
    share = masses / masses.sum() * capacity
    expected = (share[slots] ** -0.6) / (share**-0.6).max()
    assert weights.tolist() == pytest.approx(expected.tolist(), rel=1e-5)


@pytest.mark.parametrize("capacity", [1, 2, 3, 4, 5, 8, 9])
def test_only_what_is_there_is_drawn(capacity: int) -> None:
    """For every capacity and every filling, all that is there is drawn in the end, and nothing else."""
    priorities = PriorityTrees(1, capacity, PriorityOptions())
    for size in range(1, capacity + 1):
        priorities.add(runs_of(0), np.array([size - 1]))
        slots, _ = draw(priorities, size, 40, 0.4, seed=size)
        assert set(slots.tolist()) == set(range(size))


def test_restored_priorities_go_on_identically() -> None:
    """The trees are rebuilt from their leaves: draws, weights and later priorities are the same, bit for bit."""
    options = PriorityOptions(exponent=0.6, correction=0.4)
    rng = np.random.default_rng(2)
    kept, other = PriorityTrees(2, 11, options), PriorityTrees(2, 11, options)
    runs = runs_of(0, 1)
    for slot in range(8):
        kept.add(runs, np.array([slot, slot]))
        other.add(runs, np.array([10 - slot, slot]))
        kept.update(runs, rng.integers(slot + 1, size=(2, 3)), rng.normal(size=(2, 3)).astype(np.float32) * 4)
    other.restore(unpack(pack(kept.state())))
    for _ in range(2):
        found = []
        for one in (kept, other):
            slots, weights = one.draw(runs, np.array([8, 8]), 16, np.array([0.4, 0.7]), sampling_streams([1, 2]))
            one.update(runs, slots, np.sin(slots).astype(np.float32))
            one.add(runs, np.array([8, 9]))
            found.append((slots.tolist(), weights.tolist(), one.state()["masses"].tolist()))
        assert found[0] == found[1]


@pytest.mark.parametrize(("progress", "expected"), [(0.0, 0.4), (0.5, 0.7), (1.0, 1.0), (3.0, 1.0)])
def test_correction_rises_to_one(progress: float, expected: float) -> None:
    """β = β₀ + (1 − β₀) · min(progress, 1): of two transitions, one twice as probable as the other, it weighs 2⁻ᵝ."""
    trees = tree(2, np.array([1.0, 2.0])).priorities.arrays._replace(correction=0.4)
    slots, weights = np.zeros(6, dtype=np.int64), np.zeros(6, dtype=np.float32)
    draw_by_priority(trees, 0, 2, progress, 0, sampling_streams([1])[0], slots, weights)
    assert set(slots.tolist()) == {0, 1}
    assert weights.tolist() == pytest.approx([2.0 ** (-expected * slot) for slot in slots])


def test_defaults_are_those_of_baselines() -> None:
    """α = 0.6, β₀ = 0.4, ε = 1e-6 (OpenAI Baselines' deepq)."""
    assert PriorityOptions() == PriorityOptions(exponent=0.6, correction=0.4, epsilon=1e-6)


@pytest.mark.parametrize(
    ("option", "value"),
    [("exponent", -0.1), ("exponent", math.inf), ("correction", 1.1), ("correction", -0.1), ("epsilon", 0.0)],
)
def test_priority_options_out_of_range_are_refused(option: str, value: float) -> None:
    """0 ≤ α, 0 ≤ β ≤ 1, 0 < ε."""
    with pytest.raises(ValueError, match=option):
        PriorityOptions(**{option: value})
