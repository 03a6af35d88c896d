from __future__ import annotations

import math
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium import spaces
from gymnasium.envs.classic_control.cartpole import CartPoleEnv
from gymnasium.utils.env_checker import check_env

from apel.environments import CartPole

LEFT, RIGHT = range(2)


def leaning(degrees: float, **options: Any) -> CartPole:
    """A cart pole at rest in the middle whose pole leans by so many degrees."""
    environment = CartPole(**options)
    environment.reset(seed=0)
    environment.state = np.array([0.0, 0.0, math.radians(degrees), 0.0])
    return environment


def steps_until_it_falls(seed: int) -> int:
    """How many pushes to the right it takes from the start of this seed."""
    environment = CartPole()
    environment.reset(seed=seed)
    steps = 1
    while not environment.step(RIGHT)[2]:
        steps += 1
    return steps


@pytest.mark.parametrize("angle_limit", [12, 15])
def test_dynamics_are_those_of_gymnasium(angle_limit: int) -> None:
    """The same seed and actions give the same observations, bit for bit, and the same end as Gymnasium's cart pole.

    Of Gymnasium's angle limit, 12°, nothing has to be changed; any other is set there by hand.
    """
    ours, theirs = CartPole(angle_limit=angle_limit), CartPoleEnv()
    if angle_limit != 12:
        theirs.theta_threshold_radians = angle_limit * 2 * math.pi / 360
    rng = np.random.default_rng(0)
    for seed in range(60):
        first, info = ours.reset(seed=seed)
        expected, expected_info = theirs.reset(seed=seed)
        assert (first.tobytes(), info) == (expected.tobytes(), expected_info)
        fallen = False
        while not fallen:
            action = int(rng.integers(2))
            observation, *rest = ours.step(action)
            expected, *expected_rest = theirs.step(action)  # type: ignore[no-untyped-call]
            assert observation.dtype == np.float32
            assert (observation.tobytes(), rest) == (expected.tobytes(), expected_rest)
            fallen = bool(rest[1])


@pytest.mark.parametrize(("angle_limit", "falls"), [(12, True), (15, False), (12.5, True), (90, False)])
def test_angle_limit(angle_limit: float, falls: bool) -> None:
    """A pole that leans by 13° has fallen where the limit is below (a step moves it by much less than a degree)."""
    assert leaning(13, angle_limit=angle_limit).step(RIGHT)[2] == falls
    assert leaning(-13, angle_limit=angle_limit).step(LEFT)[2] == falls


def test_default_angle_limit_is_twelve_degrees() -> None:
    """As in the article and in Gymnasium."""
    assert CartPole().theta_threshold_radians == CartPoleEnv().theta_threshold_radians == 12 * 2 * math.pi / 360


@pytest.mark.parametrize(("angle_limit", "bound"), [(12, 24), (15, 30)])
def test_observation_bounds_are_twice_the_limits(angle_limit: int, bound: int) -> None:
    """Positions up to 4.8 m and angles up to twice the limit; velocities are unbounded."""
    space = CartPole(angle_limit=angle_limit).observation_space
    assert isinstance(space, spaces.Box)
    high = np.array([4.8, np.inf, math.radians(bound), np.inf], dtype=np.float32)
    np.testing.assert_array_equal(space.high, high)
    np.testing.assert_array_equal(space.low, -high)
    assert (space == CartPoleEnv().observation_space) == (angle_limit == 12)


@pytest.mark.parametrize(("options", "end"), [({}, (True, False)), ({"time_limit": "truncation"}, (False, True))])
def test_step_limit_is_reported_as_asked_for(options: dict[str, Any], end: tuple[bool, bool]) -> None:
    """The last step of an episode that did not fail is terminal, or a truncation; it is rewarded like all others."""
    environment = leaning(0, max_steps=4, **options)
    steps = [environment.step(action) for action in (LEFT, RIGHT, RIGHT, LEFT)]
    assert [step[2:4] for step in steps] == [(False, False)] * 3 + [end]
    assert [step[1] for step in steps] == [1.0] * 4


@pytest.mark.parametrize("time_limit", ["terminal", "truncation"])
def test_fall_in_the_last_step_is_no_truncation(time_limit: Any) -> None:
    """An episode that fails in step ``max_steps`` has terminated, whatever the time limit is taken for."""
    environment = CartPole(max_steps=steps_until_it_falls(seed=3), time_limit=time_limit)
    environment.reset(seed=3)
    steps = [environment.step(RIGHT) for _ in range(environment.max_steps)]
    assert steps[-1][1:4] == (1.0, True, False)


def test_episode_ends_after_two_hundred_steps_by_default() -> None:
    """Who keeps the pole upright is stopped after 200 steps, with a return of 200 (§4.1.2)."""
    environment = CartPole()
    observation, _ = environment.reset(seed=0)
    total, over = 0.0, False
    while not over:
        observation, reward, terminated, truncated, _ = environment.step(int(observation[2] + observation[3] > 0))
        total, over = total + reward, terminated or truncated
    assert (total, terminated, truncated) == (200.0, True, False)


def test_every_episode_has_its_own_step_limit() -> None:
    """A reset in the middle of an episode starts to count anew."""
    environment = leaning(0, max_steps=3)
    for _ in range(2):
        environment.reset(seed=0)
        assert [environment.step(LEFT)[2] for _ in range(2)] == [False, False]


def test_step_without_an_episode_is_refused() -> None:
    """No episode under way, no step: before the first reset, after a fall, after the step limit."""
    environment = CartPole()
    with pytest.raises(RuntimeError, match="call reset"):
        environment.step(LEFT)
    for ended in (leaning(13), leaning(0, max_steps=1), leaning(0, max_steps=1, time_limit="truncation")):
        ended.step(LEFT)
        with pytest.raises(RuntimeError, match="call reset"):
            ended.step(LEFT)


def test_unknown_action_is_refused() -> None:
    """A refused action changes nothing."""
    environment = leaning(0)
    with pytest.raises(ValueError, match="found the action 2, expected one of Discrete"):
        environment.step(2)
    assert environment.step(LEFT)[0].tobytes() == leaning(0).step(LEFT)[0].tobytes()


@pytest.mark.parametrize(
    ("option", "value"),
    [
        ("angle_limit", 0),
        ("angle_limit", -12),
        ("angle_limit", 91),
        ("angle_limit", math.nan),
        ("angle_limit", "12"),
        ("max_steps", 0),
        ("max_steps", 200.0),
        ("time_limit", "terminated"),
        ("time_limit", None),
    ],
)
def test_options_that_make_no_sense_are_refused(option: str, value: Any) -> None:
    """Each refusal names the option, what was found and what was expected."""
    with pytest.raises(ValueError, match=f"{option}: found .*, expected "):
        CartPole(**{option: value})


def test_registered_without_wrappers() -> None:
    """It limits itself; no TimeLimit reports its limit in another way. 195 solves it."""
    environment = gymnasium.make("apel/CartPole-v0", disable_env_checker=True, angle_limit=15, render_mode="rgb_array")
    assert type(environment) is CartPole
    assert environment.theta_threshold_radians == 15 * 2 * math.pi / 360
    assert environment.render_mode == "rgb_array"
    assert environment.spec is not None
    assert (environment.spec.max_episode_steps, environment.spec.reward_threshold) == (None, 195.0)


@pytest.mark.filterwarnings("ignore:.*A Box observation space")  # velocities are unbounded, there as here
def test_passes_the_checks_of_gymnasium() -> None:
    """Spaces, reseeding and types are as Gymnasium prescribes."""
    check_env(gymnasium.make("apel/CartPole-v0").unwrapped, skip_render_check=True)
