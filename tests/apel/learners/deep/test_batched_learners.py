"""What all deep learners owe: runs do not touch each other, states are whole, policies are what they say, and learn."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any
from unittest.mock import patch

import numpy as np
import pytest
from gymnasium import spaces
from numpy.typing import NDArray
from scipy import stats

from apel.learners.banks.batched_learner import BatchedLearner, Transitions
from apel.learners.deep import deep_learner
from apel.learners.deep.acer import BatchedAcer
from apel.learners.deep.deep_learner import BatchedDeepLearner
from apel.learners.deep.dqn import BatchedDqn
from apel.learners.deep.sac import BatchedSac
from cluster.checkpoint import pack, unpack
from tests.apel.learners.deep.driving import NUM_ACTIONS, Tick, assert_same_state, drive, life, part_of_run
from tests.apel.learners.deep.steps import runs_of, transitions

SPACE = spaces.Box(-np.inf, np.inf, (4,))
SEEDS = [2**63 + 11, 12, 13, 14, 2**64 - 1]
ALL = runs_of(*range(len(SEEDS)))
NETWORK = {"hidden": [16], "activation": "relu"}
DQN = {
    "learning_rate": 1e-2,
    "replay_size": 40,
    "batch_size": 8,
    "learning_starts": 20,
    "target_update_every": 10,
    "total_steps": 500,
    "final_exploration": 0.3,
    "head_hidden": [16],
    "discount": 0.9,
    "network": NETWORK,
}
ACER = {
    "learning_rate": 1e-2,
    "rollout": 5,
    "replay_size": 12,
    "batch_size": 3,
    "replay_ratio": 2,
    "learning_starts": 3,
    "network": NETWORK,
}
SAC = {"learning_rate": 1e-2, "replay_size": 40, "batch_size": 8, "learning_starts": 20, "network": NETWORK}
LEARNERS: dict[str, tuple[Callable[..., BatchedDeepLearner], dict[str, Any]]] = {
    "dqn": (BatchedDqn, DQN),
    # Sizes that fill no vector register, in some of them.
    "dqn prioritised": (
        BatchedDqn,
        {**DQN, "prioritized": {}, "train_every": 2, "batch_size": 7, "head_hidden": [5], "network": {"hidden": [13]}},
    ),
    "acer": (
        BatchedAcer,
        {**ACER, "trust_region": {"bound": 0.1, "average": 0.9}, "network": {"hidden": [33], "activation": "relu"}},
    ),
    "acer minimalrl": (BatchedAcer, {**ACER, "preset": "minimalrl"}),
    "acer Poisson": (BatchedAcer, {**ACER, "replay_count": "poisson"}),
    "sac": (BatchedSac, SAC),
}
ON_PYTORCH = "on PyTorch: "
each_learner = pytest.mark.parametrize("kind", [*LEARNERS, *(ON_PYTORCH + kind for kind in LEARNERS)])
each_compiled_learner = pytest.mark.parametrize("kind", LEARNERS)


def make(kind: str, seeds: list[int] = SEEDS, **options: Any) -> BatchedDeepLearner:
    constructor, given = LEARNERS[kind.removeprefix(ON_PYTORCH)]
    with patch.object(deep_learner, "is_compiled_for", new=lambda _: not kind.startswith(ON_PYTORCH)):
        return constructor(SPACE, NUM_ACTIONS, seeds, **{**given, **options})


def weights(learner: BatchedLearner) -> NDArray[np.float32]:
    """Of the networks that act."""
    state = learner.state()
    return state["online"] if "online" in state else state["policy"]["online"]


@each_learner
def test_is_a_stacked_learner(kind: str) -> None:
    """All satisfy the protocol, and may learn from others."""
    learner = make(kind)
    assert isinstance(learner, BatchedLearner)
    assert learner.off_policy


@each_learner
def test_runs_do_not_touch_each_other(kind: str) -> None:
    """Five runs together, named in random subsets, are five batches of one: all they do, and all of their states."""
    ticks = life(len(SEEDS), 110, freezes=(60, 80, 100))
    together = make(kind)
    before = weights(together)
    done = drive(together, ticks)
    assert (weights(together) != before).any(axis=1).all()
    for run, seed in enumerate(SEEDS):
        alone = make(kind, [seed])
        found = [acted._replace(run=run) for acted in drive(alone, [tick.only(run) for tick in ticks])]
        assert found == [acted for acted in done if acted.run == run]
        state = alone.state()
        assert_same_state(part_of_run(together.state(), run, state), state)


@each_compiled_learner
@pytest.mark.parametrize("lanes", [2, 8])
def test_filled_up_calls_give_the_same(kind: str, lanes: int) -> None:
    """However many lanes all calls have, nothing else comes out: for more runs than these, and fewer."""
    ticks = life(len(SEEDS), 60, freezes=(40, 52))
    plain, filled = make(ON_PYTORCH + kind, lanes=len(SEEDS)), make(ON_PYTORCH + kind, lanes=lanes)
    assert drive(filled, ticks) == drive(plain, ticks)
    assert_same_state(filled.state(), plain.state())


@each_compiled_learner
def test_both_engines_learn_the_same(kind: str) -> None:
    """One algorithm: after the same life, whatever rounds differently, weights and values are the same."""
    ticks = without_acting(life(len(SEEDS), 80))
    compiled, stacked = make(kind), make(ON_PYTORCH + kind)
    assert compiled.is_alone
    assert not stacked.is_alone
    before = weights(compiled)
    np.testing.assert_array_equal(weights(stacked), before)
    for learner in (compiled, stacked):
        drive(learner, ticks)
    assert np.abs(weights(compiled) - before).max() > 0.05
    np.testing.assert_allclose(weights(compiled), weights(stacked), atol=2e-3)
    observation = np.random.default_rng(1).normal(size=(len(SEEDS), 4))
    values = [learner.action_values(ALL, observation) for learner in (compiled, stacked)]
    np.testing.assert_allclose(*values, atol=2e-3)


@each_compiled_learner
def test_steps_in_one_call_are_steps_one_by_one(kind: str) -> None:
    """A run may be named for several steps in turn, as for an episode of somebody else's."""
    ticks = without_acting(life(1, 50))
    one_by_one, together = make(kind, SEEDS[:1]), make(kind, SEEDS[:1])
    drive(one_by_one, ticks)
    columns = [np.concatenate([tick[column] for tick in ticks]) for column in range(3, 10)]
    together.learn(np.zeros(len(ticks), dtype=np.int64), in_order(columns))
    assert_same_state(together.state(), one_by_one.state())


def in_order(columns: list[Any]) -> Transitions:
    seen, following, action, reward, terminated, truncated, probability = columns
    return Transitions(seen, action, reward, following, terminated, truncated, probability)


@each_learner
@pytest.mark.parametrize("stop", [10, 70])
def test_restored_learners_go_on_identically(kind: str, stop: int) -> None:
    """A state that went through a file, restored into a new learner of other seeds, gives the same life.

    The stops are before the first update, and after many and with frozen policies.
    """
    ticks = life(len(SEEDS), 100, freezes=(50, 65, 85))
    learner, other = make(kind), make(kind, [seed // 2 for seed in SEEDS])
    drive(learner, ticks[:stop])
    stored = unpack(pack(learner.state()))
    protect(stored)
    other.restore(stored)
    assert_same_state(other.state(), learner.state())
    assert drive(other, ticks[stop:]) == drive(learner, ticks[stop:])
    assert_same_state(other.state(), learner.state())


def protect(tree: Any) -> None:
    """Make all arrays read-only: a restored learner has its own."""
    match tree:
        case dict():
            for child in tree.values():
                protect(child)
        case list():
            for child in tree:
                protect(child)
        case np.ndarray():
            tree.flags.writeable = False


@each_learner
def test_state_is_a_snapshot(kind: str) -> None:
    """What is learned later does not change a state."""
    learner = make(kind)
    drive(learner, life(len(SEEDS), 45, freezes=(30,)))
    state = learner.state()
    before = unpack(pack(state))
    drive(learner, life(len(SEEDS), 15, seed=5, freezes=(10,)))
    assert_same_state(state, before)


@each_learner
def test_same_seeds_have_the_same_life(kind: str) -> None:
    """And another seed another one, from the first weights on."""
    ticks = life(2, 45)
    first, second = make(kind, [7, 8]), make(kind, [7, 9])
    done, other = drive(first, ticks), drive(second, ticks)
    assert [acted for acted in done if acted.run == 0] == [acted for acted in other if acted.run == 0]
    assert [acted for acted in done if acted.run == 1] != [acted for acted in other if acted.run == 1]
    assert not np.array_equal(weights(make(kind, [8])), weights(make(kind, [9])))


@each_learner
def test_probabilities_are_those_of_a_policy(kind: str) -> None:
    """They sum to 1, and what is done is possible."""
    for acted in drive(make(kind), life(len(SEEDS), 70)):
        assert sum(acted.probability) == pytest.approx(1.0, abs=1e-12)
        assert min(acted.probability) >= 0.0
        assert acted.probability[acted.action] > 0.0


@each_learner
@pytest.mark.parametrize("ticks", [5, 60])
def test_actions_are_drawn_with_their_probabilities(kind: str, ticks: int) -> None:
    """1000 actions in one state are as frequent as μ says (chi-square with p > 0.0001), untrained and trained."""
    learner = make(kind)
    drive(learner, life(len(SEEDS), ticks))
    runs, observation = runs_of(0, 3), np.full((2, 4), 0.3)
    probability = learner.act(runs, observation)[1]
    draws = np.array([learner.act(runs, observation)[0] for _ in range(1000)])
    for column, expected in zip(draws.T, probability, strict=True):
        counts = np.bincount(column, minlength=NUM_ACTIONS)
        likely = expected * 2000 >= 5
        assert (
            stats.chisquare(counts[likely], expected[likely] * counts[likely].sum() / expected[likely].sum()).pvalue
            > 1e-4
        )
        assert counts[~likely].sum() <= 30


@each_learner
def test_values_are_looked_up_without_a_trace(kind: str) -> None:
    """What it thinks of actions draws nothing and changes nothing."""
    learner = make(kind)
    drive(learner, life(len(SEEDS), 35))
    before = learner.state()
    observation = np.ones((2, 4))
    first = learner.action_values(runs_of(1, 2), observation)
    np.testing.assert_array_equal(first, learner.action_values(runs_of(1, 2), observation))
    assert first.shape == (2, NUM_ACTIONS)
    assert first.dtype == np.float64
    assert_same_state(learner.state(), before)


@each_learner
def test_frozen_policies_stay(kind: str) -> None:
    """Acting is as it was when they froze while learning goes on, until they freeze again; learning does not notice."""
    ticks = life(len(SEEDS), 60)
    observation = np.random.default_rng(1).normal(size=(len(SEEDS), 4))
    frozen, free = make(kind), make(kind)
    for learner in (frozen, free):
        drive(learner, ticks[:40])
    frozen.freeze(ALL)
    before = frozen.action_values(ALL, observation)
    np.testing.assert_array_equal(before, free.action_values(ALL, observation))
    for learner in (frozen, free):
        drive(learner, without_acting(ticks[40:]))
    np.testing.assert_array_equal(before, frozen.action_values(ALL, observation))
    if "acer" in kind:
        np.testing.assert_array_equal(before, frozen.act(ALL, observation)[1])
    after = free.action_values(ALL, observation)
    assert (after != before).any(axis=1).all()
    np.testing.assert_array_equal(weights(frozen), weights(free))
    frozen.freeze(runs_of(1, 4))
    now = frozen.action_values(ALL, observation)
    np.testing.assert_array_equal(now[[1, 4]], after[[1, 4]])
    np.testing.assert_array_equal(now[[0, 2, 3]], before[[0, 2, 3]])


def without_acting(ticks: list[Tick]) -> list[Tick]:
    return [tick._replace(acting=tick.acting[:0]) for tick in ticks]


@each_learner
def test_first_freeze_leaves_the_others_alone(kind: str) -> None:
    """Runs that were never frozen act on what they know today, also after others froze."""
    ticks = life(len(SEEDS), 60)
    observation = np.ones((len(SEEDS), 4))
    frozen, free = make(kind), make(kind)
    for learner in (frozen, free):
        drive(learner, ticks[:40])
    frozen.freeze(runs_of(1))
    for learner in (frozen, free):
        drive(learner, without_acting(ticks[40:]))
    others = runs_of(0, 2, 3, 4)
    expected = free.action_values(others, observation[:4])
    np.testing.assert_array_equal(frozen.action_values(others, observation[:4]), expected)


# Learning from others.

CONTEXTS = 4
BANDIT = {"replay_size": 200, "trust_region": {}}
# minimalRL's hundredths of rewards would take hundredfold patience.
MINIMAL_BANDIT = {"replay_size": 200, "reward_scale": 1.0}
TASKS: dict[str, tuple[str, dict[str, Any], bool]] = {
    "dqn": ("dqn", {"total_steps": 200, "target_update_every": 20}, True),
    "dqn prioritised": ("dqn prioritised", {"total_steps": 200, "train_every": 1}, True),
    "acer": ("acer", BANDIT, True),
    "acer, unknown behaviour": ("acer", BANDIT, False),
    "acer minimalrl": ("acer minimalrl", MINIMAL_BANDIT, True),
    "acer minimalrl, unknown behaviour": ("acer minimalrl", MINIMAL_BANDIT, False),
    "sac": ("sac", {"replay_size": 200, "initial_temperature": 0.1}, True),
}


@pytest.mark.parametrize("task", TASKS)
def test_learns_the_right_action_from_others(task: str) -> None:
    """Someone acts uniformly at random; reward 1 for the action c mod 3 in context c, each step an episode.

    It never acts itself. In the end its best action is the right one in every context, in every run.
    """
    kind, options, is_known = TASKS[task]
    constructor, given = LEARNERS[kind]
    learner = constructor(spaces.Discrete(CONTEXTS), NUM_ACTIONS, SEEDS, **{**given, **options})
    rng = np.random.default_rng(8)
    uniform = np.full((len(SEEDS), NUM_ACTIONS), 1 / NUM_ACTIONS if is_known else np.nan)
    for _ in range(200):
        context, action = rng.integers(CONTEXTS, size=len(SEEDS)), rng.integers(NUM_ACTIONS, size=len(SEEDS))
        reward = (action == context % NUM_ACTIONS).astype(np.float64)
        following = rng.integers(CONTEXTS, size=len(SEEDS))
        step = transitions(context, following, action=action, reward=reward, terminated=True, probability=uniform)
        learner.learn(ALL, step)
        learner.end_episode(ALL)
    for context in range(CONTEXTS):
        values = learner.action_values(ALL, np.full(len(SEEDS), context))
        assert values.argmax(axis=1).tolist() == [context % NUM_ACTIONS] * len(SEEDS)


# Corners.


def test_acer_starts_to_learn_when_enough_has_been_seen() -> None:
    """``learning_starts`` segments must have been seen: a memory that holds no more than these is no reason to wait."""
    learner = make("acer", replay_size=3, learning_starts=3)
    before = weights(learner)
    drive(learner, life(len(SEEDS), 60))
    assert (weights(learner) != before).any()


@pytest.mark.parametrize("start", [0, 5])
def test_acer_learns_from_short_episodes(start: int) -> None:
    """Episodes shorter than the rollout leave steps that were never written, in spaces that start anywhere."""
    learner = BatchedAcer(spaces.Discrete(2, start=start), NUM_ACTIONS, [1], **ACER)
    before = weights(learner)
    for _ in range(8):
        learner.learn(runs_of(0), transitions([start], [start + 1], reward=1.0, terminated=True))
    assert (weights(learner) != before).any()


@each_compiled_learner
def test_images_are_learned_from(kind: str) -> None:
    """Bytes of 10 × 10 × 4 (channels first) with a convolution: two runs together are two batches of one."""
    space = spaces.Box(0, 255, (4, 10, 10), dtype=np.uint8)
    constructor, given = LEARNERS[kind]
    starts = {"learning_starts": 2}
    network = {"hidden": [16], "convolutions": [[4, 3, 1]], "activation": "relu"}
    options = {**given, **starts, "network": network, "batch_size": 4}
    together, alone = (constructor(space, NUM_ACTIONS, seeds, **options) for seeds in ([1, 2], [2]))
    before = weights(together)
    rng = np.random.default_rng(1)
    for t in range(20):
        image, following = rng.integers(0, 256, size=(2, 2, 4, 10, 10), dtype=np.uint8)
        both = transitions(image, following, action=t % 3, reward=[1.0, -1.0], truncated=t % 4 == 3)
        one = transitions(image[1:], following[1:], action=t % 3, reward=-1.0, truncated=t % 4 == 3)
        together.learn(runs_of(0, 1), both)
        alone.learn(runs_of(0), one)
    assert (weights(together) != before).any(axis=1).all()
    np.testing.assert_array_equal(weights(together)[1], weights(alone)[0])
