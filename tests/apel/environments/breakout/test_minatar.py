from __future__ import annotations

import subprocess
import sys
from typing import Any, NamedTuple

import gymnasium
import minatar
import numpy as np
import pytest
from gymnasium import spaces
from gymnasium.error import DependencyNotInstalled
from gymnasium.utils.env_checker import check_env
from gymnasium.utils.seeding import np_random
from numpy.typing import NDArray

import apel.environments  # noqa: F401 (registers)
from apel.environments.breakout.minatar import MinAtarBreakout

PADDLE, BALL, TRAIL, BRICK = range(4)
NOOP, LEFT, RIGHT = range(3)


class Step(NamedTuple):
    """A step, and what was seen before it."""

    before: dict[str, NDArray[Any]]
    observation: dict[str, NDArray[Any]]
    reward: float
    terminated: bool
    truncated: bool
    info: dict[str, float]


def place(observation: dict[str, NDArray[Any]], channel: int) -> tuple[int, int]:
    """Column and row of the only symbol in a channel."""
    (row,), (column,) = np.nonzero(observation["symbols"][channel])
    return int(column), int(row)


def follow(observation: dict[str, NDArray[Any]]) -> int:
    """The action that brings the paddle to where the ball is."""
    apart = place(observation, BALL)[0] - place(observation, PADDLE)[0]
    return RIGHT if apart > 0 else LEFT if apart < 0 else NOOP


def play(environment: MinAtarBreakout, seed: int, lapses: float) -> list[Step]:
    """An episode of somebody who follows the ball, but for a share of steps."""
    rng = np.random.default_rng(seed)
    observation, _ = environment.reset(seed=seed)
    steps: list[Step] = []
    while not steps or not (steps[-1].terminated or steps[-1].truncated):
        action = int(rng.integers(3)) if rng.random() < lapses else follow(observation)
        steps.append(Step(observation, *environment.step(action)))
        observation = steps[-1].observation
    return steps


@pytest.fixture(scope="module")
def steps() -> list[Step]:
    """Some thousand steps of good and of bad play."""
    environment = MinAtarBreakout(sticky_action_prob=0.05, max_steps=600)
    episodes = [play(environment, seed, lapses=(0.0, 0.1, 0.4, 1.0)[seed % 4]) for seed in range(60)]
    return [step for episode in episodes for step in episode]


def test_registered() -> None:
    """The object that Gymnasium makes has the channels and signals, and takes all options."""
    options: dict[str, Any] = {"sticky_action_prob": 0.2, "max_steps": 9, "render_mode": "rgb_array"}
    environment = gymnasium.make("apel/MinAtarBreakout-v0", disable_env_checker=True, **options)
    assert type(environment) is MinAtarBreakout
    assert environment.get_wrapper_attr("signals") == ("paddle_hit", "life_lost")
    assert environment.action_space == spaces.Discrete(3)
    assert environment.observation_space == spaces.Dict(
        symbols=spaces.Box(0, 1, (4, 10, 10), np.uint8), handcrafted=spaces.MultiDiscrete([5, 4, 2])
    )
    assert environment.reset(seed=0)[1] == {"paddle_hit": 0.0, "life_lost": 0.0}


def test_passes_the_checks_of_gymnasium() -> None:
    """Spaces, reseeding and types are as Gymnasium prescribes."""
    check_env(MinAtarBreakout(), skip_render_check=True)


def test_imported_late_and_without_plotting() -> None:
    """All of this project knows both games without importing them, and MinAtar's without Matplotlib and Seaborn."""
    code = (
        "import sys, gymnasium, apel.environments\n"
        "assert not {'ale_py', 'cv2', 'minatar', 'minatar.environments.breakout'} & set(sys.modules)\n"
        "gymnasium.make('apel/MinAtarBreakout-v0').reset(seed=0)\n"
        "assert 'minatar.environments.breakout' in sys.modules\n"
        "assert not {'ale_py', 'cv2', 'matplotlib', 'seaborn', 'pandas'} & set(sys.modules)\n"
    )
    subprocess.run([sys.executable, "-W", "error", "-c", code], check=True, timeout=600)


def test_observations_lie_in_their_space(steps: list[Step]) -> None:
    """Each has the type and shape that were declared, and is not written to by later steps."""
    space = MinAtarBreakout().observation_space
    assert len(steps) > 3000
    for step in steps[::5]:
        assert space.contains(step.observation)
        assert all(type(value) is float for value in (step.reward, *step.info.values()))


@pytest.mark.parametrize("sticky_action_prob", [0.0, 0.1, 0.5])
def test_plays_as_the_package_does(sticky_action_prob: float) -> None:
    """The same draws give the same symbols, rewards and ends as `minatar.Environment`, sticky actions included."""
    ours = MinAtarBreakout(sticky_action_prob=sticky_action_prob)
    theirs = minatar.Environment("breakout", sticky_action_prob=sticky_action_prob)
    rng = np.random.default_rng(0)
    num_steps = 0
    for seed in range(40):
        observation, _ = ours.reset(seed=seed)
        theirs.random = theirs.env.random = np.random.RandomState(np_random(seed)[0].bit_generator)
        theirs.reset()
        theirs.last_action = 0
        over = False
        while not over:
            np.testing.assert_array_equal(observation["symbols"], theirs.state().transpose(2, 0, 1))
            action = int(rng.integers(3)) if rng.random() < 0.2 else follow(observation)
            observation, reward, over, _, _ = ours.step(action)
            assert (reward, over) == theirs.act([0, 1, 3][action])
            num_steps += 1
    assert num_steps > 400


def test_rewards_are_bricks(steps: list[Step]) -> None:
    """+1 for each that is gone; a wall that has been cleared comes back as the ball falls on."""
    rebuilt = 0
    for step in steps:
        before, after = (view["symbols"][BRICK].sum(dtype=int) for view in (step.before, step.observation))
        if before == 0 and after == 30:
            rebuilt += 1
        else:
            assert step.reward == before - after
    assert rebuilt > 0
    assert {step.reward for step in steps} == {0.0, 1.0}


def test_life_is_lost_where_the_ball_reaches_the_ground(steps: list[Step]) -> None:
    """That is row 9, and the end of the game."""
    for step in steps:
        lost = place(step.observation, BALL)[1] == 9
        assert (step.terminated, step.info["life_lost"]) == (lost, float(lost))
    assert sum(step.terminated for step in steps) > 30


def test_paddle_hits_are_those_of_the_symbols(steps: list[Step]) -> None:
    """A ball that stays in row 8 has been hit: each step moves it by one row but for bounces, and no brick is there."""
    hits = [place(step.before, BALL)[1] == place(step.observation, BALL)[1] == 8 for step in steps]
    assert [step.info["paddle_hit"] for step in steps] == hits
    assert sum(hits) > 200


def test_handcrafted_state_is_that_of_the_symbols(steps: list[Step]) -> None:
    """Position and half as seen; direction as the ball moves next, unless it bounces (stays in its row or column)."""
    directions = {(-1, -1): 0, (1, -1): 1, (1, 1): 2, (-1, 1): 3}
    states, num_moves = set(), 0
    for step in steps:
        (x, y), (next_x, next_y) = place(step.before, BALL), place(step.observation, BALL)
        position, direction, half = (int(part) for part in step.before["handcrafted"])
        apart = x - place(step.before, PADDLE)[0]
        assert (position, half) == (int(np.clip(apart, -2, 2)) + 2, int(y >= 5))
        if next_x != x and next_y != y:
            assert direction == directions[next_x - x, next_y - y]
            num_moves += 1
        states.add((position, direction, half))
    assert num_moves > 0.6 * len(steps)
    assert len(states) > 35


@pytest.mark.parametrize("seed", range(8))
def test_episode_replays_on_a_used_environment(seed: int) -> None:
    """An episode is a function of its seed and its actions, whatever was played before it and how far.

    The last action before the reset was none of those that a fresh environment would stick to.
    """
    used = MinAtarBreakout(sticky_action_prob=0.5)
    used.reset(seed=100)
    for _ in range(3):
        used.step(RIGHT)
    assert _recorded(used, seed) == _recorded(MinAtarBreakout(sticky_action_prob=0.5), seed)
    play(used, seed=7, lapses=0.5)
    assert _recorded(used, seed) == _recorded(MinAtarBreakout(sticky_action_prob=0.5), seed)


def _recorded(environment: MinAtarBreakout, seed: int) -> list[Any]:
    observation, info = environment.reset(seed=seed)
    record: list[Any] = [_frozen(observation), info]
    for action in np.random.default_rng(seed).integers(3, size=200):
        observation, *rest = environment.step(action)
        record.append((_frozen(observation), rest))
        if rest[1]:
            break
    return record


def _frozen(observation: dict[str, NDArray[Any]]) -> dict[str, bytes]:
    return {name: value.tobytes() for name, value in observation.items()}


def test_seeds_differ() -> None:
    """The ball starts on either side, and sticky actions are drawn anew."""
    environment = MinAtarBreakout(sticky_action_prob=0.5)
    starts = {place(environment.reset(seed=seed)[0], BALL) for seed in range(20)}
    assert starts == {(0, 3), (9, 3)}
    assert len({tuple(_paddle_path(environment, seed, RIGHT)) for seed in range(20)}) >= 3
    unseeded = [place(environment.reset()[0], BALL) for _ in range(20)]
    assert set(unseeded) == starts


@pytest.mark.parametrize(("sticky_action_prob", "path"), [(0.0, [5, 6, 7, 8]), (1.0, [4, 4, 4, 4])])
def test_actions_stick_as_often_as_asked_for(sticky_action_prob: float, path: list[int]) -> None:
    """Never: the paddle goes right at once. Always: nothing is what was done before the first step."""
    environment = MinAtarBreakout(sticky_action_prob=sticky_action_prob)
    for seed in range(5):
        assert _paddle_path(environment, seed, RIGHT) == path


def _paddle_path(environment: MinAtarBreakout, seed: int, action: int) -> list[int]:
    environment.reset(seed=seed)
    return [place(environment.step(action)[0], PADDLE)[0] for _ in range(4)]


@pytest.mark.parametrize("max_steps", [1, 20, 300])
def test_time_limit_truncates(max_steps: int) -> None:
    """An episode that goes on after ``max_steps`` is cut off; each counts anew."""
    environment = MinAtarBreakout(sticky_action_prob=0.0, max_steps=max_steps)
    for seed in range(2):
        steps = play(environment, seed, lapses=0.0)
        assert [step[3:5] for step in steps] == [(False, False)] * (max_steps - 1) + [(False, True)]
        with pytest.raises(RuntimeError, match="call reset"):
            environment.step(NOOP)


def test_life_lost_in_the_last_step_is_no_truncation() -> None:
    """An episode that ends in step ``max_steps`` has terminated."""
    environment = MinAtarBreakout(sticky_action_prob=0.0)
    until_lost = len(play(environment, 3, lapses=1.0))
    last = play(MinAtarBreakout(sticky_action_prob=0.0, max_steps=until_lost), 3, lapses=1.0)[-1]
    assert (last.terminated, last.truncated) == (True, False)


def test_render_shows_the_symbols() -> None:
    """One colour for each, 16 pixels per cell; the ball is seen where its trail is too, as at the start."""
    environment = MinAtarBreakout(render_mode="rgb_array")
    observation, _ = environment.reset(seed=0)
    image = environment.render()
    assert (image.shape, image.dtype) == ((160, 160, 3), np.uint8)
    cells = image.reshape(10, 16, 10, 16, 3)
    assert (cells == cells[:, :1, :, :1]).all()
    covered = np.zeros((10, 10), dtype=np.bool_)
    colours = []
    for channel in (PADDLE, BALL, BRICK):
        shown = (observation["symbols"][channel] == 1) & ~covered
        colours.append(np.unique(cells[:, 0, :, 0][shown], axis=0).tolist())
        covered |= shown
    background = np.unique(cells[:, 0, :, 0][~covered], axis=0).tolist()
    assert [len(found) for found in (*colours, background)] == [1] * 4
    assert len({tuple(found[0]) for found in (*colours, background)}) == 4
    environment.step(NOOP)
    assert len(np.unique(environment.render().reshape(-1, 3), axis=0)) == 5
    assert MinAtarBreakout().render() is None


def test_step_without_an_episode_is_refused() -> None:
    """No episode under way, no step; an unknown action is refused too."""
    environment = MinAtarBreakout()
    with pytest.raises(RuntimeError, match="call reset"):
        environment.step(NOOP)
    environment.reset(seed=0)
    with pytest.raises(ValueError, match="found the action 3, expected one of Discrete"):
        environment.step(3)


@pytest.mark.parametrize(
    ("option", "value"),
    [
        ("sticky_action_prob", -0.1),
        ("sticky_action_prob", 1.1),
        ("sticky_action_prob", "0.1"),
        ("max_steps", 0),
        ("max_steps", 10.0),
        ("render_mode", "human"),
    ],
)
def test_options_that_make_no_sense_are_refused(option: str, value: Any) -> None:
    """Each refusal names the option, what was found and what was expected."""
    with pytest.raises(ValueError, match=f"{option}: found .*, expected "):
        MinAtarBreakout(**{option: value})


def test_missing_package_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whoever lacks it is told what to install."""
    monkeypatch.delitem(sys.modules, "minatar.environments.breakout", raising=False)
    monkeypatch.setitem(sys.modules, "minatar", None)
    with pytest.raises(DependencyNotInstalled, match=r"minatar .*pip install 'apel\[minatar\]'"):
        MinAtarBreakout()
