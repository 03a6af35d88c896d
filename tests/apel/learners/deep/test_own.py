"""A share of what is replayed is the learner's own: in rings, by priority, in segments, and in what learners draw."""

from __future__ import annotations

import numpy as np
import pytest
from gymnasium import spaces
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from apel.building.registry import LEARNERS, load
from apel.learners.deep.deep_learner import BatchedDeepLearner
from apel.learners.deep.prioritised import PriorityOptions
from apel.learners.own_share import own_part_of
from cluster.checkpoint import pack, unpack
from tests.apel.learners.deep.driving import assert_same_state, drive, life, part_of_run
from tests.apel.learners.deep.memories import PriorityTrees, Ring, SegmentStore, sampling_streams
from tests.apel.learners.deep.steps import runs_of, transitions
from tests.apel.learners.deep.test_batched_learners import ON_PYTORCH, SEEDS, make
from tests.apel.splitmix import SplitMix64

NUMBERS = spaces.Box(-np.inf, np.inf, (1,))
PLAYED = st.lists(st.booleans(), min_size=1, max_size=30)
SHARE = 0.3
SMALL = {"network": {"hidden": [4]}, "learning_starts": 5}
KINDS = ("dqn", "dqn prioritised", "acer", "sac")
LEARNING = {
    "dqn": {"type": "dqn", "batch_size": 10, "replay_size": 100, "head_hidden": [], **SMALL},
    "prioritised": {"type": "dqn", "batch_size": 10, "replay_size": 100, "head_hidden": [], "prioritized": {}, **SMALL},
    "sac": {"type": "sac", "batch_size": 10, "replay_size": 100, **SMALL},
    "acer": {"type": "acer", "batch_size": 10, "replay_size": 100, "rollout": 4, "replay_ratio": 1, **SMALL},
}


def plain_of(streams: NDArray[np.uint64], run: int = 0) -> SplitMix64:
    """The oracle of a run's stream, as it stands."""
    return SplitMix64(int(streams[run][0]), int(streams[run][1]))


@pytest.mark.parametrize(
    ("size", "share", "part"),
    [(32, 0.5, 16), (5, 0.5, 3), (1, 0.01, 1), (8, 1.0, 8), (100, 0.07, 7), (10, 0.3, 3), (3, 1 / 3, 1), (30, 0.1, 3)],
)
def test_part_of_a_minibatch(size: int, share: float, part: int) -> None:
    """The least whole number that is not below the share, as that is written: not 8 for 100 · 0.07."""
    assert own_part_of(size, share) == part


@settings(max_examples=60)
@given(capacity=st.integers(1, 7), played=PLAYED, part=st.integers(1, 6), seed=st.integers(0, 2**64 - 1))
def test_ring(capacity: int, played: list[bool], part: int, seed: int) -> None:
    """The first are those of the own ones that are remembered, oldest first, and the rest of all, by the run's stream;
    a restored ring draws the same. Without own ones the draws are those of a ring that does not ask.
    """
    ring, other, plain = (Ring(2, capacity, NUMBERS) for _ in range(3))
    for one in (ring, other):
        one.memory.keep_own(part)
    for number, own in enumerate(played):
        for one in (ring, plain):
            one.add(runs_of(1), transitions([[number]], [[number]]), own=own)
        other.add(runs_of(0, 1), transitions([[7], [8]], [[9], [9]]), own=not own)
    remembered = range(max(len(played) - capacity, 0), len(played))
    own_slots = [number % capacity for number in remembered if played[number]]
    streams = sampling_streams([0, seed])
    oracle = plain_of(streams, 1)
    drawn = min(part, 6) if own_slots else 0
    expected = [own_slots[oracle.integer(len(own_slots))] for _ in range(drawn)]
    expected += [oracle.integer(len(remembered)) for _ in range(6 - drawn)]
    assert ring.draw(runs_of(1), 6, streams)[0].tolist() == expected
    other.restore(unpack(pack(ring.state())))
    assert other.draw(runs_of(1), 6, sampling_streams([0, seed]))[0].tolist() == expected
    if not own_slots:
        assert plain.draw(runs_of(1), 6, sampling_streams([0, seed]))[0].tolist() == expected
    assert_same_state(other.state(), ring.state())
    assert "own" not in plain.state()


def test_state_without_a_word_of_who_played() -> None:
    """What comes from a memory that did not ask is nobody's own; what comes later is known."""
    asking, plain = Ring(1, 4, NUMBERS), Ring(1, 4, NUMBERS)
    asking.memory.keep_own(6)
    asking.add(runs_of(0), transitions([[0]], [[0]]), own=True)
    for number in range(3):
        plain.add(runs_of(0), transitions([[number]], [[number]]), own=True)
    asking.restore(plain.state())
    assert set(asking.draw(runs_of(0), 40, sampling_streams([1]))[0].tolist()) == {0, 1, 2}
    asking.add(runs_of(0), transitions([[3]], [[3]]), own=True)
    assert asking.draw(runs_of(0), 40, sampling_streams([1]))[0, :6].tolist() == [3] * 6
    plain.restore(asking.state())  # which does not ask, and is not told
    assert "own" not in plain.state()


@settings(max_examples=60)
@given(
    capacity=st.integers(1, 9),
    steps=st.lists(st.tuples(st.booleans(), st.integers(1, 50)), min_size=1, max_size=25),
    part=st.integers(1, 5),
    seed=st.integers(0, 2**64 - 1),
)
def test_priorities(capacity: int, steps: list[tuple[bool, int]], part: int, seed: int) -> None:
    """One from each of ``part`` equal shares of the own mass, the rest likewise of all: those of a cumulative sum.

    Masses are whole numbers, so that both add up without rounding; of weights the rarest of all counts, for both parts.
    """
    epsilon = 2.0**-20
    priorities, other = (PriorityTrees(1, capacity, PriorityOptions(exponent=1.0, epsilon=epsilon)) for _ in range(2))
    for one in (priorities, other):
        one.priorities.keep_own()
    other.add(runs_of(0), np.array([capacity - 1]), own=True)
    mass, is_own = np.zeros(capacity), np.zeros(capacity, dtype=np.bool_)
    for number, (own, priority) in enumerate(steps):
        slot = number % capacity
        mass[slot], is_own[slot] = priority, own
        priorities.add(runs_of(0), np.array([slot]), own=own)
        priorities.update(runs_of(0), np.array([[slot]]), np.array([[priority - epsilon]]))
    other.restore(unpack(pack(priorities.state())), is_own[None])
    size = np.array([min(len(steps), capacity)])
    oracle = plain_of(sampling_streams([seed]))
    drawn = part if is_own.any() else 0
    expected: list[int] = []
    for masses, count in ((np.where(is_own, mass, 0.0), drawn), (mass, 5 - drawn)):
        cumulative = np.cumsum(masses)
        marks = [(j + oracle.uniform()) / count * cumulative[-1] for j in range(count)]
        expected += [int(np.searchsorted(cumulative, mark, side="right")) for mark in marks]
    for one in (priorities, other):
        streams = sampling_streams([seed])
        slots, weights = one.draw(runs_of(0), size, 5, np.ones(1), streams, part=drawn)
        assert slots[0].tolist() == expected
        assert weights[0].tolist() == pytest.approx((mass[mass > 0].min() / mass[slots[0]]).tolist())


@settings(max_examples=40)
@given(
    capacity=st.integers(1, 5),
    episodes=st.lists(st.tuples(st.booleans(), st.integers(1, 5)), min_size=1, max_size=12),
    part=st.integers(1, 4),
    seed=st.integers(0, 2**64 - 1),
)
def test_segments(capacity: int, episodes: list[tuple[bool, int]], part: int, seed: int) -> None:
    """Own segments are drawn for the part that is to be own; the newest, too, is an own one, drawn where another played
    last.
    """
    memory, other = (SegmentStore(1, capacity, 2) for _ in range(2))
    for one in (memory, other):
        one.memory.keep_own(part)
        one.add(runs_of(0), transitions([[1]], [[1]], terminated=True, num_actions=2), own=True)
    memory.restore(other.state())
    closed = [(0.0, True)]  # the reward of a segment's first step, by which it is known, and whether it is own
    for number, (own, length) in enumerate(episodes, start=1):
        for step in range(length):
            reward = 100.0 * number + step
            row = transitions([[0]], [[0]], reward=reward, terminated=step + 1 == length, num_actions=2)
            memory.add(runs_of(0), row, own=own)
            if step % 2 == 0:
                closed.append((reward, own))
    kept = closed[-capacity:]
    mine = [reward for reward, own in kept if own]
    other.restore(unpack(pack(memory.state())))
    for one in (memory, other):
        streams = sampling_streams([seed])
        oracle = plain_of(streams)
        newest = one.newest(runs_of(0), streams).reward[0, 0, 0]
        drawn = one.draw(runs_of(0), 4, streams).reward[0, :, 0].tolist()
        own_newest = kept[-1][1] or not mine
        assert newest == (kept[-1][0] if own_newest else mine[oracle.integer(len(mine))])
        count = part if mine else 0
        expected = [mine[oracle.integer(len(mine))] for _ in range(count)]
        expected += [kept[-1 - oracle.integer(len(kept))][0] for _ in range(4 - count)]
        assert drawn == expected


@pytest.mark.parametrize("name", LEARNING)
def test_share_is_reached(name: str) -> None:
    """Over 1 000 episodes, a twentieth of them its own, every minibatch has the share, and the mean is that of the rule
    within sampling error. Who played stands in the rewards, so that nothing here rests on what memories note.
    """
    options = dict(LEARNING[name])
    batched = load(LEARNERS[options.pop("type")]).batched_type
    learner, draws = batched(NUMBERS, 2, [5], **options), np.random.default_rng(3)
    learner.replay_own(SHARE)
    played, found, expected = list[bool](), list[float](), list[float]()
    for _ in range(1000):
        own = bool(draws.random() < 0.05)
        for step in range(3):
            seen = draws.normal(size=(2, 1, 1))
            if own:
                learner.act(runs_of(0), seen[0])
            row = transitions(seen[0], seen[1], action=0, reward=float(own), terminated=step == 2, num_actions=2)
            learner.learn(runs_of(0), row)
            played.append(own)
        learner.end_episode(runs_of(0))
        remembered = played[-3 * 100 :: 3] if name == "acer" else played[-100:]
        if len(played) > 30 and any(remembered):
            batch = learner.learner.batch
            whose = batch.reward[0, batch.begin[0, :-1]] if name == "acer" else batch.reward[0]
            found.append(float(whose.mean()))
            expected.append(0.3 + 0.7 * float(np.mean(remembered)))
    assert len(found) > 500
    assert min(found) >= SHARE
    if name == "prioritised":
        return  # whose other part is not uniform
    error = np.sqrt(0.25 * 7 / 10**2 / len(found))  # of the mean of 7 draws in 10, at most
    assert abs(np.mean(found) - np.mean(expected)) < 4 * error


@pytest.mark.parametrize("name", LEARNING)
def test_learning_without_own_ones_moves_no_draw(name: str) -> None:
    """A learner that never plays learns what one learns that does not ask, value for value; one that plays does not."""
    options = dict(LEARNING[name])
    batched = load(LEARNERS[options.pop("type")]).batched_type
    states = []
    for share, acts in ((None, False), (SHARE, False), (None, True), (SHARE, True)):
        learner, draws = batched(NUMBERS, 2, [5], **options), np.random.default_rng(3)
        if share is not None:
            learner.replay_own(share)
        for step in range(60):
            seen = draws.normal(size=(2, 1, 1))
            if acts and step % 8 < 2:
                learner.act(runs_of(0), seen[0])
            learner.learn(runs_of(0), transitions(seen[0], seen[1], terminated=step % 2 == 1, num_actions=2))
        state = learner.state()
        states.append({part: state[part] for part in state if part not in ("replay", "memory", "streams")})
    assert_same_state(states[1], states[0])
    with pytest.raises(AssertionError):
        assert_same_state(states[3], states[2])


@pytest.mark.parametrize("kind", [f"{engine}{kind}" for engine in ("", ON_PYTORCH) for kind in KINDS])
def test_runs_by_themselves_and_restored(kind: str) -> None:
    """Runs together are, on both engines, batches of one, and one that is restored on the way goes on the same: all
    that they do, and all of their states.
    """
    ticks = [tick._replace(acting=tick.learning[::2]) for tick in life(2, 70)]
    together, other = asking(kind, SEEDS[:2]), asking(kind, SEEDS[2:4])
    first = drive(together, ticks[:50])
    drive(other, ticks[20:40])
    other.restore(unpack(pack(together.state())))
    second = drive(together, ticks[50:])
    assert drive(other, ticks[50:]) == second
    done = first + [acted._replace(tick=acted.tick + 50) for acted in second]
    assert_same_state(other.state(), together.state())
    for run, seed in enumerate(SEEDS[:2]):
        alone = asking(kind, [seed])
        found = [acted._replace(run=run) for acted in drive(alone, [tick.only(run) for tick in ticks])]
        assert found == [acted for acted in done if acted.run == run]
        assert_same_state(part_of_run(together.state(), run, alone.state()), alone.state())


def asking(kind: str, seeds: list[int]) -> BatchedDeepLearner:
    """A learner of some runs that replays its own."""
    learner = make(kind, seeds)
    learner.replay_own(0.4)
    return learner
