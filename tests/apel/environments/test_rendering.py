"""What pictures of the maze and the cart pole show, and episodes that are played once more for them."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, ClassVar

import gymnasium
import numpy as np
import pytest
from gymnasium import spaces
from gymnasium.utils.env_checker import check_env
from numpy.typing import NDArray

from apel.configs import EnvironmentConfig, LearnerConfig
from apel.environments import CartPole, Maze, make_world
from apel.environments.canvas import BLACK, BLUE, ORANGE, Canvas
from apel.environments.drawing import draw_cart_pole
from apel.environments.rendering import frames, rendered_world
from apel.experience.trajectory import Trajectory
from apel.learners.base import StreakLimit
from apel.run.opening import open_book
from apel.selectors import Fixed
from tests.apel.rounds import make_banks

MAZE = EnvironmentConfig("apel/Maze-v0", {"size": 4, "max_steps": 30}, run_seed="maze_seed")
CART = EnvironmentConfig("apel/CartPole-v0")


def middle_of(image: NDArray[np.uint8], colour: tuple[int, int, int]) -> tuple[float, float]:
    """(x, y) of the mean pixel of a colour."""
    rows, columns = np.nonzero((image == colour).all(axis=-1))
    return float(columns.mean()), float(rows.mean())


def test_a_line_covers_its_area() -> None:
    """The sum over all pixels is the area of the line with its round ends; beyond the edge nothing is drawn."""
    canvas = Canvas(40, 30)
    canvas.line((10.3, 8.2), (25.9, 20.1), 3.0, (0, 0, 0))
    covered = (255.0 - canvas.image[..., 0]).sum() / 255
    assert covered == pytest.approx(6 * math.hypot(15.6, 11.9) + math.pi * 9, rel=0.01)
    edge = Canvas(10, 10)
    edge.disc((-30, 40), 5, BLACK)
    edge.rectangle(-5, -5, 3, 3, BLACK)
    assert (edge.image == 255).all()


def test_maze_shades_the_cells_that_were_visited() -> None:
    """Visited cells are shaded, the more the oftener, until the next episode."""
    maze = Maze(2, size=5, render_mode="rgb_array")
    maze.reset(seed=0)
    corner = [24 * place + 5 for place in reversed(divmod(maze.start_cell, 5))]
    fresh = maze.render()[tuple(corner)]
    wall = next(action for action in range(4) if not maze.passages[maze.start_cell, action])
    for _ in range(5):
        maze.step(wall)
    assert maze.render()[tuple(corner)].sum() < fresh.sum() < 3 * 255
    assert ((maze.render() == 255).all(axis=-1)).any()
    maze.reset(seed=0)
    assert (maze.render()[tuple(corner)] == fresh).all()


@pytest.mark.parametrize("angle", [-0.2, 0.0, 0.1, math.pi / 4])
@pytest.mark.parametrize("position", [-2.4, 0.0, 1.3])
def test_cart_pole_stands_where_it_is(position: float, angle: float) -> None:
    """The cart's middle is at its position, 100 pixels per metre, and the pole leans by its angle from the axle."""
    image = draw_cart_pole(position, angle, 1.0, 2.4, 0.2)
    assert image.shape == (210, 600, 3)
    x = 299.5 + 100 * position
    if angle == 0.0:  # else the pole covers more of one half
        assert middle_of(image, BLUE)[0] == pytest.approx(x, abs=1)
    axle, pole = middle_of(image[:155], BLACK), middle_of(image[:130], ORANGE)
    assert axle[0] == pytest.approx(x, abs=1)
    assert math.atan2(pole[0] - axle[0], axle[1] - pole[1]) == pytest.approx(angle, abs=0.03)


def test_cart_pole_renders_its_state() -> None:
    """As Gymnasium prescribes, without pygame; and its dynamics are the same with and without."""
    shown, plain = CartPole(render_mode="rgb_array"), CartPole()
    assert np.array_equal(shown.reset(seed=3)[0], plain.reset(seed=3)[0])
    before = shown.render()
    for action in (1, 1, 0, 1):
        one, other = shown.step(action), plain.step(action)
        assert np.array_equal(one[0], other[0])
        assert one[1:] == other[1:]
    assert shown.render().dtype == np.uint8
    assert not np.array_equal(before, shown.render())


@pytest.mark.filterwarnings("ignore:.*A Box observation space")  # velocities are unbounded
def test_cart_pole_passes_the_checks_of_gymnasium() -> None:
    """With its rendering, but for that on a screen, which is Gymnasium's own and needs pygame."""
    environment = gymnasium.make("apel/CartPole-v0", render_mode="rgb_array").unwrapped
    environment.metadata = {**environment.metadata, "render_modes": ["rgb_array"]}
    check_env(environment)


def recorded(config: EnvironmentConfig, episode: int) -> Trajectory:
    """An episode of random actions, in the environment without pictures."""
    world = make_world(config, 7)
    environment, generator = world.environment, np.random.default_rng(0)
    environment.reset(seed=world.seeds.of_episode(episode))
    actions, rewards, terminated, truncated = [], [], False, False
    while not (terminated or truncated):
        actions.append(int(generator.integers(environment.action_space.n)))  # type: ignore[attr-defined]
        _, reward, terminated, truncated, _ = environment.step(actions[-1])
        rewards.append(float(reward))
    return Trajectory(np.empty(0), np.array(actions), np.array(rewards), terminated)


@pytest.mark.parametrize("config", [MAZE, CART])
def test_frames_of_an_episode(config: EnvironmentConfig) -> None:
    """One per state, with the return so far; of every few steps the first and the last are always there."""
    trajectory, world = recorded(config, 5), rendered_world(config, 7)
    shown = list(frames(world, 5, trajectory))
    assert [frame.step for frame in shown] == list(range(len(trajectory) + 1))
    assert shown[0].return_so_far == 0.0
    assert shown[-1].return_so_far == trajectory.undiscounted_return
    assert any(not np.array_equal(shown[0].image, frame.image) for frame in shown)
    thinned = list(frames(world, 5, trajectory, every=7))
    assert [frame.step for frame in thinned] == sorted({*range(0, len(trajectory), 7), len(trajectory)})
    assert np.array_equal(thinned[-1].image, shown[-1].image)


def test_an_episode_that_goes_otherwise_is_refused() -> None:
    """Another reward, an end that is missing, and one that comes too early."""
    trajectory, world = recorded(CART, 5), rendered_world(CART, 7)
    rewards = np.concatenate([trajectory.reward[:-1], [0.5]])
    shorter = replace(trajectory, action=trajectory.action[:-1], reward=trajectory.reward[:-1])
    longer = replace(trajectory, action=np.tile(trajectory.action, 2), reward=np.tile(trajectory.reward, 2))
    for wrong in (replace(trajectory, reward=rewards), shorter, longer):
        with pytest.raises(ValueError, match=r"step \d+ of episode 5, played again .* found the reward 1.0 and"):
            list(frames(world, 5, wrong))


class Shown(gymnasium.Env[int, int]):
    """Draws what it is told to."""

    metadata: ClassVar[dict[str, Any]] = {"render_modes": ["rgb_array"]}  # type: ignore[misc]

    def __init__(self, picture: Any = None, render_mode: str | None = None) -> None:
        self.observation_space, self.action_space = spaces.Box(0, 1, (1,)), spaces.Discrete(2, start=5)
        self.picture, self.render_mode = picture, render_mode

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        return np.zeros(1, dtype=np.float32), {}

    def step(self, action: int) -> Any:
        return np.zeros(1, dtype=np.float32), float(action), True, False, {}

    def render(self) -> Any:
        if self.picture is None:
            message = "no display"
            raise OSError(message)
        return self.picture


class Hidden(Shown):
    """Does not render."""

    def __init__(self, render_mode: str | None = None) -> None:
        super().__init__()


class Blind(Shown):
    """Does not know of rendering."""

    def __init__(self) -> None:
        super().__init__()


@pytest.mark.parametrize(
    ("factory", "options", "message"),
    [
        (Blind, {}, "cannot be rendered: .*unexpected keyword argument 'render_mode'"),
        (Hidden, {}, r"cannot be rendered: found the render modes \['rgb_array'\], expected rgb_array among them"),
        (Shown, {}, "cannot be rendered: OSError: no display"),
        (Shown, {"picture": "text"}, "cannot be rendered: found a picture <U4"),
        (Shown, {"picture": np.zeros((2, 2), dtype=np.uint8)}, r"expected uint8\[height, width, 3\]"),
    ],
)
def test_environments_that_cannot_be_rendered(factory: Any, options: dict[str, Any], message: str) -> None:
    """Whatever the reason, it is said before anything is played."""
    with pytest.raises(ValueError, match=message):
        rendered_world(EnvironmentConfig("tests:Shown", options), 0, factory)


@pytest.mark.parametrize("id_", ["FrozenLake-v1", "Acrobot-v1"])
def test_environments_of_gymnasium_that_cannot_be_rendered(id_: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Finite ones, since their tables are played with other random numbers; others without pygame."""
    monkeypatch.setitem(__import__("sys").modules, "pygame", None)
    with pytest.raises(ValueError, match="cannot be rendered"):
        rendered_world(EnvironmentConfig(id_), 0)


def test_actions_are_those_that_were_played() -> None:
    """An environment whose first action is 5, with an episode as a learner plays it: the same action, and reward."""
    config = EnvironmentConfig("tests:Shown", {"picture": np.zeros((2, 3, 3), dtype=np.uint8)})
    learners, world = [LearnerConfig("tests.channelled:Witness")], make_world(config, 0, Shown)
    (bank,), book = make_banks(learners, [world], [0]), open_book(Fixed(), 1, 1, None, [0], [{}])
    bank.learner.learners[0].act = lambda observation: (6, None)  # type: ignore[attr-defined]
    batch = bank.play([0], book, Fixed(), 0, StreakLimit(1, 1), record=True).batch
    assert batch is not None
    ((_, _, trajectory),) = batch.trajectories()
    assert (trajectory.action.tolist(), trajectory.reward.tolist()) == ([6], [6.0])
    assert list(frames(rendered_world(config, 0, Shown), 0, trajectory))[-1].return_so_far == 6.0
