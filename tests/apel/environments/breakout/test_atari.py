from __future__ import annotations

import sys
from itertools import pairwise
from typing import Any, NamedTuple

import gymnasium
import numpy as np
import pytest
from gymnasium import spaces
from gymnasium.error import DependencyNotInstalled
from gymnasium.utils.env_checker import check_env
from numpy.typing import NDArray

import apel.environments  # noqa: F401 (registers)
from apel.environments.breakout.atari import AtariBreakout
from tests.apel.environments.breakout.atari_screen import FIRE, LEFT, NOOP, RIGHT, HandPlayed, Raw, lapsing_player

NUM_STEPS = 1500


class Step(NamedTuple):
    """A step of the environment, and the same step played by hand."""

    before: dict[str, NDArray[Any]]
    last_raw: Raw
    observation: dict[str, NDArray[Any]]
    reward: float
    terminated: bool
    truncated: bool
    info: dict[str, float]
    raw: list[Raw]
    frame: NDArray[np.uint8]
    points: float
    lives: int


@pytest.fixture(scope="module")
def games() -> list[list[Step]]:
    """Games of together a few thousand steps, each also played by hand; the last one is not played to its end."""
    environment, by_hand = AtariBreakout(), HandPlayed()
    player = lapsing_player(seed=0)
    result: list[list[Step]] = []
    while sum(map(len, result)) < NUM_STEPS:
        result.append(_game(environment, by_hand, player, seed=len(result)))
    return result


def _game(environment: AtariBreakout, by_hand: HandPlayed, player: Any, seed: int) -> list[Step]:
    before, _ = environment.reset(seed=seed)
    by_hand.reset(seed)
    steps: list[Step] = []
    while len(steps) < 700 and not (steps and steps[-1].terminated):
        action, last_raw = player(before["ram"]), by_hand.raw[-1]
        observation, reward, terminated, truncated, info = environment.step(action)
        points, _ = by_hand.step(action)
        hand = (by_hand.raw, by_hand.frame, points, by_hand.ale.lives())
        steps.append(Step(before, last_raw, observation, reward, terminated, truncated, info, *hand))
        before = observation
    return steps


@pytest.fixture(scope="module")
def steps(games: list[list[Step]]) -> list[Step]:
    return [step for game in games for step in game]


def test_registered_and_lazy() -> None:
    """The object that Gymnasium makes has the channels and signals, and takes all options."""
    options: dict[str, Any] = {"noop_max": 3, "frame_skip": 2, "max_steps": 9, "render_mode": "rgb_array"}
    environment = gymnasium.make("apel/AtariBreakout-v0", **options)
    assert environment.get_wrapper_attr("signals") == ("clipped", "paddle_hit", "life_lost")
    assert environment.action_space == spaces.Discrete(4)
    assert environment.observation_space == spaces.Dict(
        frame=spaces.Box(0, 255, (84, 84), np.uint8),
        ram=spaces.Box(0, 255, (128,), np.uint8),
        handcrafted=spaces.MultiDiscrete([5, 4, 2]),
    )
    _, info = environment.reset(seed=0)
    assert info == {"clipped": 0.0, "paddle_hit": 0.0, "life_lost": 0.0}
    assert environment.render().shape == (210, 160, 3)  # type: ignore[union-attr]


def test_passes_the_checks_of_gymnasium() -> None:
    """Spaces, reseeding and types are as Gymnasium prescribes."""
    check_env(AtariBreakout(), skip_render_check=True)


def test_observations_lie_in_their_space(steps: list[Step]) -> None:
    """Each has the type and shape that were declared, and is not written to by later steps."""
    space = AtariBreakout().observation_space
    for step in steps[::10]:
        assert space.contains(step.observation)
        assert all(type(value) is float for value in (step.reward, *step.info.values()))


def test_frames_are_those_of_baselines(steps: list[Step]) -> None:
    """Grey before the maximum or after it: in this game both give the same, pixel for pixel."""
    whole = [step for step in steps if not step.terminated]
    assert len(whole) > NUM_STEPS - 20
    for step in whole:
        np.testing.assert_array_equal(step.observation["frame"], step.frame)
    # So that the comparison is not one of still pictures.
    assert len({step.frame.tobytes() for step in whole}) > len(whole) / 2


def test_emulator_is_played_as_by_hand(steps: list[Step]) -> None:
    """No-ops, launches, frame skip and actions lead to the same RAM and the same points in every step."""
    for step in steps:
        np.testing.assert_array_equal(step.observation["ram"], step.raw[-1].ram)
        assert step.reward == step.points
        assert step.info["clipped"] == np.sign(step.points)
    assert {step.reward for step in steps} >= {0.0, 1.0, 4.0}  # raw, not clipped


def test_lost_life_does_not_end_the_game(games: list[list[Step]]) -> None:
    """A game has five lives, and its points go on to add up after each of them."""
    ended = [game for game in games if game[-1].terminated]
    assert len(ended) >= 2
    for game in ended:
        lost = [step.info["life_lost"] for step in game]
        assert (sum(lost), lost[-1]) == (5.0, 1.0)
        assert [step.terminated for step in game] == [False] * (len(game) - 1) + [True]
        lives = [5, *(step.lives for step in game)]
        assert lost == [float(b < a) for a, b in pairwise(lives)]
    lives_with_points = [(n, step.lives) for n, game in enumerate(games) for step in game if step.reward]
    assert len(set(lives_with_points)) > len(games) + 2


def test_ball_is_launched_in_the_step_in_which_a_life_is_lost(steps: list[Step]) -> None:
    """Nobody sees a screen without a ball, nor needs to press FIRE, before the game is over."""
    relaunched = [step for step in steps if step.info["life_lost"] and not step.terminated]
    assert len(relaunched) >= 8
    for step in relaunched:
        assert len(step.raw) == 3 * 4
        ball = step.raw[-1].ball
        assert ball is not None
        assert ball[1] > 120
    for step in steps:
        assert step.terminated or step.observation["ram"][101] > 0


@pytest.mark.parametrize("action", [NOOP, FIRE, RIGHT, LEFT])
def test_ball_is_launched_whatever_is_held(action: int) -> None:
    """Even with FIRE held down while lives are lost, the ball is in play after every step and the game ends."""
    environment = AtariBreakout()
    observation, _ = environment.reset(seed=5)
    lost, terminated = 0.0, False
    for _ in range(600):
        assert observation["ram"][101] > 0
        observation, _, terminated, _, info = environment.step(action)
        lost += info["life_lost"]
        if terminated:
            break
    assert (lost, terminated) == (5.0, True)


def test_ram_says_what_the_pixels_show(steps: list[Step]) -> None:
    """Ball and paddle are where the cells 99, 101 and 72 put them, in every frame in which they can be made out."""
    raw = [raw for step in steps for raw in step.raw]
    balls = [(raw.ball, (int(raw.ram[99]) - 49, int(raw.ram[101]) + 9)) for raw in raw if raw.ball]
    paddles = [(raw.paddle, int(raw.ram[72]) - 47) for raw in raw if raw.paddle is not None]
    assert min(len(balls), len(paddles)) > 0.8 * len(raw) > 5000
    assert all(seen == told for seen, told in balls)
    assert all(seen == told for seen, told in paddles)


def test_handcrafted_position_and_half_are_those_of_the_pixels(steps: list[Step]) -> None:
    """Centres at most 3 pixels apart: above; at most 8: above the left or right part; else beside the paddle."""
    seen = set()
    for step in steps:
        ball, paddle = step.raw[-1].ball, step.raw[-1].paddle
        if ball is None or paddle is None:
            continue
        apart = (ball[0] + 1) - (paddle + 8)
        position = next(n for n, end in enumerate((-8, -3, 4, 9, 999)) if apart < end)
        expected = (position, int(ball[1] >= 110))
        assert (step.observation["handcrafted"][0], step.observation["handcrafted"][2]) == expected
        seen.add(expected)
    assert len(seen) == 10


def test_handcrafted_direction_is_that_of_the_pixels(steps: list[Step]) -> None:
    """It is where the ball moves between the last two frames, but where the paddle has just pushed it aside."""
    directions = {(-1, -1): 0, (1, -1): 1, (1, 1): 2, (-1, 1): 3}
    compared = []
    for step in steps:
        frames = [step.last_raw, *step.raw][-3:]
        balls = [frame.ball for frame in frames]
        if not all(balls):
            continue
        a, b, c = balls
        right, down = np.sign(np.subtract(c, b))  # type: ignore[arg-type]
        turned = np.sign(b[1] - a[1]) != down  # type: ignore[index]
        if right and not turned:
            assert step.observation["handcrafted"][1] == directions[int(right), int(down)]
            compared.append((right, down))
    assert len(compared) > 0.6 * len(steps)
    assert len(set(compared)) == 4


def test_paddle_hits_are_those_of_the_pixels(games: list[list[Step]]) -> None:
    """A ball that is seen to fall and then, right above the paddle, to rise has been hit once in between.

    Next to the paddle, which has its colour, it is not seen. Nothing else is a hit.
    """
    num_exact = 0
    for game in games:
        windows = _turns_above_the_paddle(game)
        hits = [n for n, step in enumerate(game) if step.info["paddle_hit"]]
        assert len(hits) == len(windows)
        assert all(first <= hit <= last for hit, (first, last) in zip(hits, windows, strict=True))
        num_exact += sum(first == last for first, last in windows)
    assert num_exact > 15


def _turns_above_the_paddle(game: list[Step]) -> list[tuple[int, int]]:
    """The first and the last step in which each may have been."""
    rows = [(n, raw.ball_row) for n, step in enumerate(game) for raw in step.raw]
    turns = []
    falling, seen, hidden_since = True, 0, None
    for step, row in rows:
        if row is None:
            hidden_since = step if hidden_since is None else hidden_since
            continue
        came_back = hidden_since is not None and seen > 180 and row > 150  # and no other ball was launched
        if falling and row > 150 and (row < seen or came_back):
            turns.append((step if hidden_since is None else hidden_since, step))
        if came_back or row != seen:
            falling = row > seen and not came_back
        seen, hidden_since = row, None
    return turns


def test_paddle_hits_are_signalled_in_the_step_in_which_they_happen(steps: list[Step]) -> None:
    """The ball's row in RAM, which is that of the pixels, turns in one of the step's frames."""
    expected = []
    falling = True  # as launched
    for step in steps:
        rows = [int(raw.ram[101]) for raw in (step.last_raw, *step.raw)]
        hit = False
        for before, after in pairwise(rows):
            hit |= falling and before > after > 150
            falling = after > before
        falling |= step.terminated
        expected.append(float(hit))
    assert [step.info["paddle_hit"] for step in steps] == expected
    assert sum(expected) > 30


@pytest.mark.parametrize("seed", range(3))
def test_episode_replays_on_a_used_environment(seed: int) -> None:
    """An episode is a function of its seed and its actions, whatever was played before it and how far."""
    used = AtariBreakout()
    for before in range(3):
        used.reset(seed=100 + before)
        for _ in range(50 * before):
            used.step(RIGHT)
    expected = _recorded(AtariBreakout(), seed)
    assert _recorded(used, seed) == expected
    assert _recorded(used, seed) == expected
    assert _recorded(used, seed + 1) != expected


def _recorded(environment: AtariBreakout, seed: int) -> list[Any]:
    player = lapsing_player(seed)
    observation, info = environment.reset(seed=seed)
    record: list[Any] = [_frozen(observation), info]
    for _ in range(150):
        observation, *rest = environment.step(player(observation["ram"]))
        record.append((_frozen(observation), rest))
    return record


def _frozen(observation: dict[str, NDArray[Any]]) -> dict[str, bytes]:
    return {name: value.tobytes() for name, value in observation.items()}


@pytest.mark.parametrize(("noop_max", "expected"), [(4, {1, 2, 3, 4}), (1, {1}), (0, {0})])
def test_number_of_no_ops(noop_max: int, expected: set[int]) -> None:
    """Uniform over 1 to ``noop_max``, drawn at each reset, with a seed or without."""
    environment = AtariBreakout(noop_max=noop_max)
    assert {_num_no_ops(environment, seed) for seed in range(12)} == expected
    assert {_num_no_ops(environment, None) for _ in range(12)} == expected


def test_number_of_no_ops_by_default() -> None:
    """Baselines' 1 to 30."""
    environment = AtariBreakout()
    counts = {_num_no_ops(environment, seed) for seed in range(50)}
    assert counts <= set(range(1, 31))
    assert (min(counts) <= 3, max(counts) >= 28, len(counts) > 15) == (True, True, True)


def _num_no_ops(environment: AtariBreakout, seed: int | None) -> int:
    environment.reset(seed=seed)
    return int(environment._emulator.getEpisodeFrameNumber()) - 2 * 4


@pytest.mark.parametrize("frame_skip", [1, 2, 5])
def test_frame_skip(frame_skip: int) -> None:
    """As many frames as asked for, of which the last two make an observation."""
    environment, by_hand = AtariBreakout(frame_skip=frame_skip), HandPlayed(frame_skip)
    environment.reset(seed=1)
    by_hand.reset(1)
    for action in (RIGHT, LEFT, NOOP, LEFT) * 10:
        observation, reward, *_ = environment.step(action)
        assert by_hand.step(action)[0] == reward
        np.testing.assert_array_equal(observation["ram"], by_hand.raw[-1].ram)
        if frame_skip > 1:
            np.testing.assert_array_equal(observation["frame"], by_hand.frame)


def test_time_limit_truncates() -> None:
    """Steps and buttons of launches, including the two of the reset, add up to ``max_steps``."""
    environment = AtariBreakout(max_steps=60)
    for _ in range(2):
        environment.reset(seed=0)
        ends: list[tuple[bool, bool]] = []
        lost = 0.0
        while not ends or not any(ends[-1]):
            _, _, terminated, truncated, info = environment.step(NOOP)
            lost += info["life_lost"]
            ends.append((terminated, truncated))
        assert lost > 0
        assert len(ends) == 60 - 2 - 2 * lost
        assert ends[-1] == (False, True)
        with pytest.raises(RuntimeError, match="call reset"):
            environment.step(NOOP)


@pytest.mark.parametrize("left_over", range(3))
def test_time_limit_may_cut_a_launch_short(left_over: int) -> None:
    """Where a life is lost just before the limit, only so many buttons are pressed as there are steps left."""
    unlimited = AtariBreakout()
    unlimited.reset(seed=0)
    until_lost = 1
    while not unlimited.step(NOOP)[4]["life_lost"]:
        until_lost += 1
    environment = AtariBreakout(max_steps=2 + until_lost + left_over)
    num_no_ops = _num_no_ops(environment, seed=0)
    ends = [environment.step(NOOP)[2:4] for _ in range(until_lost)]
    assert ends == [(False, False)] * (until_lost - 1) + [(False, True)]
    assert environment._emulator.getEpisodeFrameNumber() == num_no_ops + 4 * environment.max_steps


def test_step_without_a_game_is_refused() -> None:
    """No game under way, no step; an unknown action is refused too."""
    environment = AtariBreakout()
    with pytest.raises(RuntimeError, match="call reset"):
        environment.step(NOOP)
    environment.reset(seed=0)
    with pytest.raises(ValueError, match="found the action 4, expected one of Discrete"):
        environment.step(4)


@pytest.mark.parametrize(
    ("option", "value"),
    [
        ("noop_max", -1),
        ("noop_max", 1.0),
        ("frame_skip", 0),
        ("frame_skip", 17),
        ("max_steps", 2),
        ("max_steps", None),
        ("render_mode", "human"),
    ],
)
def test_options_that_make_no_sense_are_refused(option: str, value: Any) -> None:
    """Each refusal names the option, what was found and what was expected."""
    with pytest.raises(ValueError, match=f"{option}: found .*, expected "):
        AtariBreakout(**{option: value})


@pytest.mark.parametrize("name", ["ale_py", "cv2"])
def test_missing_package_is_named(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whoever lacks one is told what to install."""
    monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(DependencyNotInstalled, match=rf"{name} .*pip install 'apel\[atari\]'"):
        AtariBreakout()
