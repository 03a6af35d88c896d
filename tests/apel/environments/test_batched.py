from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium import spaces
from gymnasium.wrappers import TimeLimit
from hypothesis import given, settings
from hypothesis import strategies as st

from apel.configs import EnvironmentConfig
from apel.dynamics.batched_environment import BatchedEnvironment, Stepped
from apel.dynamics.finite_model import FiniteModel
from apel.environments import CartPole, FiniteEnvironment, Maze, World, batched_environment, make_world
from apel.environments.batched import BatchedFinite
from apel.environments.cartpole import BatchedCartPole, CartPoleParameters, batched_cart_pole
from apel.environments.environment_list import EnvironmentList
from tests.apel.models import frozen_lakes, lottery, mazes

Policy = Callable[[np.random.Generator, gymnasium.Env[Any, Any]], int]


def at_random(rng: np.random.Generator, environment: gymnasium.Env[Any, Any]) -> int:
    """Any action, counted from 0."""
    assert isinstance(environment.action_space, spaces.Discrete)
    return int(rng.integers(environment.action_space.n))


def start(environment: gymnasium.Env[Any, Any], seed: int) -> tuple[Any, ...]:
    """Start an episode; the observation is copied, like that of `step`."""
    return np.array(environment.reset(seed=seed)[0]), 0.0, False, False


def step(environment: gymnasium.Env[Any, Any], action: int) -> tuple[Any, ...]:
    """Play an action counted from 0; Gymnasium counts from ``start``."""
    assert isinstance(environment.action_space, spaces.Discrete)
    observation, *rest = environment.step(action + int(environment.action_space.start))
    return np.array(observation), *rest


def told(found: Stepped) -> dict[int, str]:
    """The errors, as a failed run's line tells them."""
    return {position: f"{type(error).__name__}: {error}" for position, error in found.errors.items()}


def assert_same(found: Stepped, expected: Sequence[tuple[Any, ...]], batched: BatchedEnvironment) -> None:
    """Equal to the last bit to ``(observation, reward, terminated, truncated)`` of each environment alone."""
    assert found.errors == {}
    observations = np.stack([outcome[0] for outcome in expected])
    assert found.entry.flags.c_contiguous
    decoded = batched.decode(found.entry)
    assert (decoded.dtype, decoded.shape) == (observations.dtype, observations.shape)
    assert decoded.tobytes() == observations.tobytes()
    for column, values, dtype in (
        (found.reward, [outcome[1] for outcome in expected], np.float64),
        (found.terminated, [outcome[2] for outcome in expected], np.bool_),
        (found.truncated, [outcome[3] for outcome in expected], np.bool_),
    ):
        assert column.dtype == dtype
        assert column.tolist() == values


def play_in_lockstep(
    batched: BatchedEnvironment,
    environments: Sequence[gymnasium.Env[Any, Any]],
    seed: int,
    calls: int,
    policy: Policy = at_random,
) -> Counter[str]:
    """Play both with the same seeds and actions, in each call other runs; how often which end came."""
    rng = np.random.default_rng(seed)
    playing = np.zeros(len(environments), dtype=np.bool_)
    ends: Counter[str] = Counter()
    kept: list[tuple[Any, Any]] = []
    for _ in range(calls):
        named = rng.random(len(environments)) < 0.7
        starting, going = np.flatnonzero(named & ~playing), np.flatnonzero(named & playing)
        if len(starting):
            seeds = rng.integers(2**63, size=len(starting)).tolist()
            alone = [start(environments[r], s) for r, s in zip(starting.tolist(), seeds, strict=True)]
            assert_same(batched.reset(starting, seeds), alone, batched)
            playing[starting] = True
        if len(going):
            actions = [policy(rng, environments[r]) for r in going.tolist()]
            alone = [step(environments[r], a) for r, a in zip(going.tolist(), actions, strict=True)]
            found = batched.step(going, np.array(actions))
            assert_same(found, alone, batched)
            kept.append((found.entry, found.entry.copy()))
            playing[going] = ~(found.terminated | found.truncated)
            ends["step"] += len(going)
            ends["terminated"] += int(found.terminated.sum())
            ends["truncated"] += int(found.truncated.sum())
    assert all(np.array_equal(entry, copy) for entry, copy in kept)  # nobody writes into what was handed out
    return ends


# The cart pole


def balancing(rng: np.random.Generator, environment: gymnasium.Env[Any, Any]) -> int:
    """Mostly against the fall, so that some episodes fail and some reach their limit."""
    state = environment.unwrapped.state  # type: ignore[attr-defined]
    return int((state[2] + state[3] > 0) != (rng.random() < 0.35))


def batch(environments: Sequence[CartPole]) -> BatchedCartPole:
    """The batched form of what has one."""
    batched = batched_cart_pole(environments)
    assert batched is not None
    return batched


@pytest.mark.parametrize("time_limit", ["terminal", "truncation"])
@pytest.mark.parametrize("angle_limit", [12, 15])
def test_batched_cart_pole_is_the_cart_pole(angle_limit: float, time_limit: Any) -> None:
    """Thousands of steps of many runs, in changing subsets, equal to the single environments bit for bit."""
    environments = [CartPole(angle_limit, max_steps=40, time_limit=time_limit) for _ in range(20)]
    ends = play_in_lockstep(batch(environments), environments, seed=1, calls=250, policy=balancing)
    assert ends["step"] > 2000
    assert ends["terminated"] > 10
    # Where the limit is terminal, nothing is ever truncated.
    assert (ends["truncated"] > 10) == (time_limit == "truncation")


@settings(max_examples=15)
@given(seed=st.integers(0, 2**32), count=st.integers(1, 70))
def test_one_step_has_the_bits_of_gymnasium(seed: int, count: int) -> None:
    """From any state, also one that no episode begins with, and however many runs are named at once.

    NumPy takes arrays through vector instructions as wide as the machine has: a cosine that then had other bits would
    show here.
    """
    rng = np.random.default_rng(seed)
    states = rng.normal(size=(count, 4)) * (1.0, 1.0, 0.15, 1.5)
    actions, runs = rng.integers(2, size=count), np.arange(count)
    environment = CartPole(max_steps=10)
    batched = BatchedCartPole(CartPoleParameters.of(environment), count)
    batched.reset(runs, range(count))
    batched._state[:] = states.T
    found = batched.step(runs, actions)
    for run in range(count):
        environment.reset(seed=0)
        environment.state = states[run]
        observation, reward, terminated, truncated, _ = environment.step(int(actions[run]))
        assert batched._state[:, run].tobytes() == environment.state.tobytes()
        assert found.entry[run].tobytes() == observation.tobytes()
        assert (found.reward[run], found.terminated[run], found.truncated[run]) == (reward, terminated, truncated)


def test_batched_cart_pole_is_gymnasiums() -> None:
    """Until the pole falls, it plays Gymnasium's own CartPole-v1."""
    theirs = [gymnasium.make("CartPole-v1") for _ in range(8)]
    batched = batch([CartPole(max_steps=500) for _ in theirs])
    ends = play_in_lockstep(batched, theirs, seed=2, calls=200)
    assert ends["terminated"] > 10
    assert ends["truncated"] == 0


# Finite environments


@pytest.mark.parametrize(
    "models",
    [
        mazes(max_steps=15),
        [Maze(maze_seed=seed, size=3, distractors=(2, 3), max_steps=30).finite_model for seed in range(3)],
        [Maze(maze_seed=seed, size=2, max_steps=6).finite_model for seed in range(3)],
        frozen_lakes(),
        [lottery(max_steps=4)] * 2,
        [lottery(max_steps=1, num_distractors=0)] * 2,
    ],
    ids=["maze", "two distractors", "no distractor", "frozen lake", "lottery", "one step"],
)
@settings(max_examples=10)
@given(seed=st.integers(0, 2**32))
def test_batched_finite_is_the_finite_environment(models: list[FiniteModel], seed: int) -> None:
    """Observation for observation with the same seeds and actions, whichever runs are stepped together."""
    play_in_lockstep(BatchedFinite(models), [FiniteEnvironment(model) for model in models], seed, calls=60)


def test_batched_finite_meets_both_ends() -> None:
    """What the property above compares has terminations, also in the last step, and truncations."""
    models = [lottery(max_steps=2)] * 5
    ends = play_in_lockstep(BatchedFinite(models), [FiniteEnvironment(m) for m in models], seed=0, calls=300)
    assert ends["terminated"] > 50
    assert ends["truncated"] > 50


@pytest.mark.parametrize(
    ("model", "dtype"),
    [
        (lottery(), np.uint16),
        (frozen_lakes()[0], np.uint16),
        (Maze(size=3, distractors=(10_000,)).finite_model, np.int32),
    ],
    ids=["lottery", "frozen lake", "90 000 states"],
)
def test_entries_are_state_numbers(model: FiniteModel, dtype: Any) -> None:
    """Entries are the numbers of states, from which observations are read, in as few bytes as they fit."""
    batched, environment = BatchedFinite([model] * 40), FiniteEnvironment(model)
    sizes = model.feature_sizes
    entries = batched.reset(np.arange(40), range(40)).entry
    assert entries.dtype == dtype
    for seed, entry in enumerate(entries):
        observation, _ = environment.reset(seed=seed)
        assert int(entry) == np.ravel_multi_index(tuple(np.atleast_1d(observation)), sizes)
        np.testing.assert_array_equal(batched.decode(entry), observation)
    assert batched.decode(entries.reshape(4, 10)).shape[:2] == (4, 10)
    assert len(set(entries.tolist())) > (1 if len(model.start_cell) * model.num_distractor_values > 1 else 0)


# Any environments


class Shifted(gymnasium.Env[Any, Any]):
    """Actions from 5; whichever of these environments is called, its observation is written into the same array."""

    _written = np.zeros(2)

    def __init__(self) -> None:
        self.observation_space = spaces.Box(-np.inf, np.inf, (2,), np.float64)
        self.action_space = spaces.Discrete(3, start=5)
        self._state = np.zeros(2)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        super().reset(seed=seed)
        self._state = self.np_random.random(2)
        return self._observe(), {}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        assert self.action_space.contains(action)
        self._state = self._state + action
        return self._observe(), float(action), self.np_random.random() < 0.2, self.np_random.random() < 0.1, {}

    def _observe(self) -> Any:
        self._written[:] = self._state
        return self._written


class Faulty(Shifted):
    """Fails as it is told to."""

    def __init__(self, fault: str) -> None:
        super().__init__()
        self._fault = fault

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        if self._fault == "reset":
            message = "no power"
            raise OSError(message)
        return super().reset(seed=seed)

    def step(self, action: Any) -> Any:
        if self._fault == "step":
            message = "lost"
            raise KeyError(message)
        if self._fault == "shape":
            return np.zeros(3), 1.0, False, False, {}
        if self._fault == "text":
            return np.ones(2), "much", True, True, {}
        return super().step(action)


@pytest.mark.parametrize(
    "make",
    [
        lambda: gymnasium.make("CartPole-v1", max_episode_steps=15),
        lambda: make_world(EnvironmentConfig("Blackjack-v1"), 3).environment,
        lambda: FiniteEnvironment(frozen_lakes()[0]),
        lambda: FiniteEnvironment(lottery(max_steps=4)),
        Shifted,
    ],
    ids=["cart pole", "blackjack", "number", "numbers", "shifted"],
)
def test_environment_list_is_its_environments(make: Callable[[], gymnasium.Env[Any, Any]]) -> None:
    """Each run plays what its environment plays alone; actions are counted from the first one."""
    batched = EnvironmentList([make() for _ in range(5)])
    ends = play_in_lockstep(batched, [make() for _ in range(5)], seed=4, calls=80)
    assert ends["terminated"] + ends["truncated"] > 5


@pytest.mark.parametrize(
    ("fault", "error"),
    [
        ("step", "KeyError: 'lost'"),
        (
            "shape",
            (
                "ValueError: step 1: found the observation array([0., 0., 0.]), expected an element of "
                "Box(-inf, inf, (2,), float64): it has the shape (3,), not (2,)"
            ),
        ),
        ("text", "ValueError: step 1: found the reward 'much', expected a number"),
    ],
)
def test_faulty_step_ends_one_run_only(fault: str, error: str) -> None:
    """It is reported by its position in the call with zeros beside it, and the others have made their step."""
    batched, alone = EnvironmentList([Shifted(), Shifted(), Faulty(fault)]), Shifted()
    batched.reset(np.array([1, 2]), [7, 8])
    alone.reset(seed=7)
    found = batched.step(np.array([1, 2]), np.array([0, 1]))
    observation, reward, terminated, truncated, _ = alone.step(5)
    assert told(found) == {1: error}
    assert found.entry.tolist() == [observation.tolist(), [0.0, 0.0]]
    assert found.reward.tolist() == [reward, 0.0]
    assert found.terminated.tolist() == [terminated, False]
    assert found.truncated.tolist() == [truncated, False]


def test_faulty_reset_ends_one_run_only() -> None:
    """The others have begun, and can be stepped; even if there are no others, there is an answer."""
    batched, alone = EnvironmentList([Faulty("reset"), Shifted()]), Shifted()
    found = batched.reset(np.array([0, 1]), [7, 8])
    assert told(found) == {0: "OSError: no power"}
    assert found.entry.tolist() == [[0.0, 0.0], alone.reset(seed=8)[0].tolist()]
    assert batched.step(np.array([1]), np.array([2])).entry.tolist() == [alone.step(7)[0].tolist()]
    found = batched.reset(np.array([0]), [7])
    assert (list(found.errors), found.entry.tolist()) == ([0], [[0.0, 0.0]])


# Which of them


def cart_pole_world(**options: Any) -> World:
    """One run on the registered cart pole."""
    limit = options.pop("max_episode_steps", None)
    return make_world(EnvironmentConfig("apel/CartPole-v0", options, max_episode_steps=limit), 1)


def world_of(environment: gymnasium.Env[Any, Any]) -> World:
    """A run on whatever a user's factory returned."""
    return replace(cart_pole_world(), environment=environment)


class Variant(CartPole):
    """A user's, of which nothing is known."""


def longer_pole() -> CartPole:
    """A variant that is made by changing an attribute."""
    environment = CartPole()
    environment.length = 1.0
    return environment


def semi_implicit() -> CartPole:
    """Gymnasium's other integrator."""
    environment = CartPole()
    environment.kinematics_integrator = "semi-implicit euler"
    return environment


@pytest.mark.parametrize(
    ("worlds", "kind"),
    [
        ([cart_pole_world(), cart_pole_world()], BatchedCartPole),
        ([cart_pole_world(angle_limit=15, time_limit="truncation")], BatchedCartPole),
        ([cart_pole_world(), cart_pole_world(angle_limit=15)], EnvironmentList),
        ([cart_pole_world(), cart_pole_world(max_steps=100)], EnvironmentList),
        ([cart_pole_world(), cart_pole_world(time_limit="truncation")], EnvironmentList),
        ([cart_pole_world(max_episode_steps=100)] * 2, EnvironmentList),
        ([world_of(TimeLimit(CartPole(), 100))], EnvironmentList),
        ([world_of(Variant())], EnvironmentList),
        ([world_of(longer_pole())], BatchedCartPole),
        ([world_of(longer_pole()), cart_pole_world()], EnvironmentList),
        ([world_of(semi_implicit())], EnvironmentList),
        ([world_of(CartPole(render_mode="human"))], EnvironmentList),
        ([make_world(EnvironmentConfig("CartPole-v1"), 1)], EnvironmentList),
        ([make_world(EnvironmentConfig("FrozenLake-v1"), seed) for seed in (1, 2)], BatchedFinite),
        ([make_world(EnvironmentConfig("apel/Maze-v0", {"size": 3}, run_seed="maze_seed"), 1)] * 2, BatchedFinite),
        ([make_world(EnvironmentConfig("FrozenLake-v1"), 1), cart_pole_world()], EnvironmentList),
    ],
)
def test_the_fastest_that_fits(worlds: list[World], kind: type) -> None:
    """Arrays for equal cart poles without anything on top, tables for what is finite, a list for everything else."""
    assert type(batched_environment(worlds)) is kind


def test_changed_parameters_are_those_that_are_played() -> None:
    """A cart pole with a longer pole is batched with a longer pole."""
    play_in_lockstep(batch([longer_pole() for _ in range(3)]), [longer_pole() for _ in range(3)], seed=5, calls=50)


def test_limit_of_a_wrapped_maze_is_kept() -> None:
    """``max_episode_steps`` of a finite environment holds in its batched form."""
    options = {"size": 3, "max_steps": 20}
    world = make_world(EnvironmentConfig("apel/Maze-v0", options, max_episode_steps=2), 0)
    batched, runs = batched_environment([world]), np.array([0])
    batched.reset(runs, [0])
    assert [batched.step(runs, np.array([0])).truncated.tolist() for _ in range(2)] == [[False], [True]]


def test_models_of_different_shapes_are_refused() -> None:
    """Runs of one experiment have tables of one shape."""
    worlds = [make_world(EnvironmentConfig("apel/Maze-v0", {"size": size}), 0) for size in (3, 4)]
    with pytest.raises(ValueError, match="found tables of the shapes"):
        batched_environment(worlds)


@pytest.mark.parametrize("world", [cart_pole_world(max_steps=1), make_world(EnvironmentConfig("FrozenLake-v1"), 1)])
def test_misuse_is_refused(world: World) -> None:
    """No episode under way, no step; and no action but those there are."""
    batched, runs = batched_environment([world] * 3), np.array([0, 2])
    batched.reset(np.array([0]), [0])
    with pytest.raises(RuntimeError, match="call reset"):
        batched.step(runs, np.array([0, 0]))
    batched.reset(np.array([2]), [0])
    for action in (-1, 4):
        with pytest.raises(ValueError, match=rf"found the actions \[0, {action}\]"):
            batched.step(runs, np.array([0, action]))


@pytest.mark.parametrize("world", [cart_pole_world(max_steps=1), world_of(FiniteEnvironment(lottery(max_steps=1)))])
def test_step_after_the_end_is_refused(world: World) -> None:
    """An episode that is over has to be reset before the next step, which then goes through."""
    if isinstance(world.environment, FiniteEnvironment):
        world = replace(world, model=world.environment.finite_model)
    batched, runs = batched_environment([world]), np.array([0])
    for _ in range(2):
        batched.reset(runs, [0])
        batched.step(runs, np.array([0]))
        with pytest.raises(RuntimeError, match="call reset"):
            batched.step(runs, np.array([0]))
