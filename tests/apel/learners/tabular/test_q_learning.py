from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from gymnasium import spaces
from hypothesis import given
from hypothesis import strategies as st

from apel.learners import Decay, Learner, QLearning, QLearningOptions, Switch, Transition

OBSERVATIONS, ACTIONS = spaces.Discrete(4), spaces.Discrete(3)


def make(seed: int = 1, **options: Any) -> QLearning:
    return QLearning(OBSERVATIONS, ACTIONS, seed, **options)


def step(
    state: int, action: int, reward: float, successor: int, *, terminated: bool = False, truncated: bool = False
) -> Transition:
    return Transition(state, action, reward, successor, terminated, truncated, None)


def test_is_an_off_policy_learner() -> None:
    """Q-learning satisfies the learner's protocol, and may learn from others."""
    learner = make()
    assert isinstance(learner, Learner)
    assert learner.off_policy


def test_update_by_hand() -> None:
    """Q(s, a) ← Q(s, a) + α (r + γ max Q(s′, ·) − Q(s, a)) with α = 0.5, γ = 0.9 (Eq. 2.8)."""
    learner = make(learning_rate=0.5, discount=0.9)
    learner.learn(step(1, 2, 4.0, 3))
    assert learner.table[(1,)].tolist() == [0.0, 0.0, 2.0]  # 0 + 0.5 (4 + 0.9 · 0 − 0)
    learner.learn(step(0, 0, 1.0, 1))
    assert learner.table[(0,)].tolist() == pytest.approx([1.4, 0.0, 0.0])  # 0.5 (1 + 0.9 · 2)
    learner.learn(step(0, 0, 1.0, 1))
    assert learner.table[(0,)].tolist() == pytest.approx([2.1, 0.0, 0.0])  # 1.4 + 0.5 (2.8 − 1.4)
    learner.learn(step(0, 1, -1.0, 0))
    # The state follows itself: 0.5 (−1 + 0.9 · 2.1) = 0.445
    assert learner.table[(0,)].tolist() == pytest.approx([2.1, 0.445, 0.0])
    assert learner.steps == 4


def test_best_following_value_may_be_negative() -> None:
    """The maximum is over the actions, not over them and zero."""
    learner = make(learning_rate=1.0)
    for action in range(3):
        learner.learn(step(2, action, -5.0 - action, 3, terminated=True))
    learner.learn(step(0, 0, -1.0, 2))
    assert learner.table[(0,)][0] == -6.0  # −1 + max(−5, −6, −7)


def test_terminal_states_have_no_value_and_truncation_bootstraps() -> None:
    """V(terminal) = 0, while a truncated episode's last state keeps its value."""
    learner = make(learning_rate=1.0)
    learner.learn(step(3, 0, 10.0, 0, terminated=True))
    learner.learn(step(0, 0, 1.0, 3, terminated=True))
    learner.learn(step(1, 0, 1.0, 3, truncated=True))
    learner.learn(step(2, 0, 1.0, 3))
    assert [learner.table[(state,)][0] for state in (0, 1, 2)] == [1.0, 11.0, 11.0]


@given(exploration=st.floats(0.0, 1.0), values=st.lists(st.integers(-2, 2), min_size=3, max_size=3))
def test_probabilities_are_epsilon_greedy(exploration: float, values: list[int]) -> None:
    """μ(a) = ε / |A|, and (1 − ε) / |greedy| more for each of the best actions."""
    learner = make(exploration=exploration)
    learner.table[(0,)] = np.array(values, dtype=np.float64)
    action, probability = learner.act(0)
    best = [value == max(values) for value in values]
    expected = [exploration / 3 + (1.0 - exploration) / sum(best) * one for one in best]
    assert probability.tolist() == pytest.approx(expected, abs=1e-15)
    assert float(probability.sum()) == pytest.approx(1.0)
    assert probability[action] > 0.0 or 0.0 < exploration < 1e-300


@pytest.mark.parametrize(
    ("values", "expected"),
    [
        # ε = 0.3: each action 0.1, and 0.7 shared by the best.
        ([5.0, 5.0, 0.0], [0.45, 0.45, 0.1]),
        ([0.0, 0.0, 0.0], [1 / 3, 1 / 3, 1 / 3]),
        ([-2.0, -1.0, -3.0], [0.1, 0.8, 0.1]),
    ],
)
def test_actions_are_drawn_with_their_probabilities(values: list[float], expected: list[float]) -> None:
    """Frequencies follow μ, ties broken evenly, within 5 standard errors."""
    learner = make(exploration=0.3)
    learner.table[(0,)] = np.array(values)
    draws = []
    for _ in range(8_000):
        action, probability = learner.act(0)
        draws.append(action)
    assert probability.tolist() == pytest.approx(expected)
    for action, p in enumerate(expected):
        assert abs(draws.count(action) / 8_000 - p) <= 5 * math.sqrt(p * (1 - p) / 8_000)


def test_exploration_decays_with_observed_steps() -> None:
    """ε(t) = end + (start − end) exp(−t / steps), with t counted on others' steps too."""
    learner = make(exploration=Decay(start=0.9, end=0.1, steps=2.0))
    probabilities = []
    for _ in range(3):
        probabilities.append(learner.act(3)[1].tolist())
        learner.table[(3,)] = np.array([1.0, 0.0, 0.0])
        learner.learn(step(0, 0, 0.0, 1))
    # ε(0) = 0.9 with all three tied, ε(1) = 0.1 + 0.8 e^−½ = 0.5852, ε(2) = 0.1 + 0.8 e^−1 = 0.3943; others get ε / 3.
    assert probabilities[0] == pytest.approx([1 / 3] * 3)
    assert probabilities[1][1] == pytest.approx((0.1 + 0.8 * math.exp(-0.5)) / 3)
    assert probabilities[2][1] == pytest.approx((0.1 + 0.8 * math.exp(-1.0)) / 3)


@pytest.mark.parametrize(("steps", "expected"), [(0, 0.9), (7500, 0.01 + 0.89 / math.e), (10**9, 0.01)])
def test_decay_schedule(steps: int, expected: float) -> None:
    """The schedule of Fig. 4.6: 0.9 falling to 0.01 with a scale of 7500 steps; episodes do not matter."""
    options = QLearningOptions(exploration=Decay(start=0.9, end=0.01, steps=7500))
    assert options.exploration_rate(episode=3, steps=steps) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize(("episode", "expected"), [(0, 0.8), (999, 0.8), (1000, 0.01), (5000, 0.01)])
def test_switch_schedule(episode: int, expected: float) -> None:
    """ε is the old one up to the episode before the switch, the new one from it on (§4.2.2); steps do not matter."""
    options = QLearningOptions(exploration=Switch(before=0.8, episode=1000, after=0.01))
    assert options.exploration_rate(episode=episode, steps=12345) == expected


def test_switch_counts_others_episodes() -> None:
    """The episode clock advances at the end of every episode, own or another's."""
    learner = make(exploration=Switch(before=1.0, episode=2, after=0.0))
    learner.table[(0,)] = np.array([0.0, 1.0, 0.0])
    rates = []
    for _ in range(3):
        rates.append(learner.act(0)[1].tolist())
        learner.end_episode()
    assert rates == [pytest.approx([1 / 3] * 3), pytest.approx([1 / 3] * 3), [0.0, 1.0, 0.0]]


def test_defaults_are_those_of_the_dissertation() -> None:
    """Learning rate 0.1, discount 1, ε 0.1 (§4.3.1)."""
    assert QLearningOptions() == QLearningOptions(learning_rate=0.1, discount=1.0, exploration=0.1)


def test_options_may_come_as_data() -> None:
    """Schedules are made from mappings, as an experiment file gives them."""
    learner = make(exploration={"before": 0.5, "episode": 3, "after": 0.25})
    assert learner.options.exploration == Switch(before=0.5, episode=3, after=0.25)
    learner = make(exploration={"start": 0.5, "end": 0.25, "steps": 3})
    assert learner.options.exploration == Decay(start=0.5, end=0.25, steps=3.0)


def test_observations_are_told_apart_by_value() -> None:
    """A vector of whole numbers is one state, whatever its type; a number is the vector of one."""
    learner = QLearning(spaces.MultiDiscrete([3, 3]), ACTIONS, 0, learning_rate=1.0)
    learner.learn(step(np.array([1, 2]), 0, 5.0, np.array([0, 0]), terminated=True))  # type: ignore[arg-type]
    learner.learn(step(np.array([2, 1], dtype=np.int8), 0, 7.0, np.array([0, 0]), terminated=True))  # type: ignore[arg-type]
    assert learner.table[(1, 2)][0] == 5.0
    assert learner.table[(2, 1)][0] == 7.0


def test_actions_may_start_elsewhere_than_at_zero() -> None:
    """An action space {5, 6, 7} is acted in and learned in as such."""
    learner = QLearning(OBSERVATIONS, spaces.Discrete(3, start=5), 0, learning_rate=1.0, exploration=0.0)
    learner.learn(step(0, 6, 1.0, 1, terminated=True))
    action, probability = learner.act(0)
    assert action == 6
    assert probability.tolist() == [0.0, 1.0, 0.0]


def play(learner: QLearning, steps: int) -> list[Any]:
    """A made-up environment: the action decides reward and next state."""
    state, trace = 0, []
    for t in range(steps):
        action, probability = learner.act(state)
        successor = (state + action + t) % 4
        learner.learn(step(state, action, math.sin(t + action), successor, truncated=t % 7 == 6))
        if t % 7 == 6:
            learner.end_episode()
        trace.append((action, probability.tolist()))
        state = successor
    return trace


@pytest.mark.parametrize(
    "exploration", [0.3, Decay(start=0.9, end=0.1, steps=20), Switch(before=0.9, episode=10, after=0.1)]
)
def test_restored_learner_goes_on_identically(exploration: Any) -> None:
    """A state restored into a new learner gives the same actions, values and clocks from there on."""
    learner = make(seed=4, exploration=exploration)
    play(learner, 50)
    state = learner.state()
    expected = play(learner, 100)
    other = make(seed=99, exploration=exploration)
    play(other, 10)
    other.restore(state)
    assert play(other, 100) == expected
    assert {key: values.tolist() for key, values in other.table.items()} == {
        key: values.tolist() for key, values in learner.table.items()
    }
    assert (other.episode, other.steps) == (learner.episode, learner.steps)


def test_state_is_a_snapshot() -> None:
    """Learning on after `state` does not change what it returned; a learner that saw nothing has a state too."""
    learner = make()
    fresh = learner.state()
    play(learner, 20)
    state = learner.state()
    before = state["table"]["values"].copy(), state["stream"].copy()
    play(learner, 20)
    np.testing.assert_array_equal(state["table"]["values"], before[0])
    np.testing.assert_array_equal(state["stream"], before[1])
    learner.restore(fresh)
    assert (len(learner.table), learner.steps, learner.episode) == (0, 0, 0)


def test_learns_the_best_arm() -> None:
    """On a trivial task, one state and one good action, the greedy action is the good one."""
    learner = make(exploration=0.5)
    for _ in range(200):
        action, _ = learner.act(0)
        learner.learn(step(0, action, float(action == 1), 0, terminated=True))
    assert int(np.argmax(learner.table[(0,)])) == 1
    assert learner.table[(0,)][1] == pytest.approx(1.0, abs=0.01)


@pytest.mark.parametrize(
    ("option", "value"),
    [
        ("learning_rate", 0.0),
        ("learning_rate", 1.1),
        ("learning_rate", math.nan),
        ("discount", -0.1),
        ("discount", 1.1),
        ("exploration", -0.1),
        ("exploration", 1.1),
        ("exploration", {"start": 0.5, "end": 0.1, "steps": 0.0}),
        ("exploration", {"before": 0.5, "after": 0.1, "episode": -1}),
        ("exploration", {"start": 0.5, "end": 0.1}),
        ("speed", 1.0),
    ],
)
def test_options_out_of_range_are_refused(option: str, value: Any) -> None:
    """0 < α ≤ 1, 0 ≤ γ ≤ 1, 0 ≤ ε ≤ 1, schedules complete, and nothing unknown."""
    with pytest.raises(ValueError, match=option):
        make(**{option: value})


def test_continuous_observations_are_refused() -> None:
    """A table needs finitely many states: the error says how to get them."""
    with pytest.raises(ValueError, match=r"a table needs finitely many states: .*Box.*representation with bins"):
        QLearning(spaces.Box(0.0, 1.0, (2,)), ACTIONS, 0)
