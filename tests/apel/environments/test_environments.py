from __future__ import annotations

import itertools
import math
from collections import Counter, deque
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium import spaces
from gymnasium.envs.classic_control import CartPoleEnv
from gymnasium.envs.toy_text import FrozenLakeEnv
from gymnasium.envs.toy_text.frozen_lake import generate_random_map
from gymnasium.utils.env_checker import check_env

from apel.configs import EnvironmentConfig
from apel.dynamics.finite_model import FiniteModel
from apel.environments import FiniteEnvironment, Maze, World, make_world
from apel.environments.finite_environment import toy_text_model
from apel.numerics.seeding import Role, make_key
from tests.apel import splitmix

UP, RIGHT, DOWN, LEFT = range(4)
MOVES = {UP: (0, -1), RIGHT: (1, 0), DOWN: (0, 1), LEFT: (-1, 0)}
SEEDS = range(40)


def neighbour(cell: int, action: int, size: int) -> int | None:
    """The cell next to ``cell``, whatever walls there are; None outside."""
    x, y = divmod(cell, size)
    x, y = x + MOVES[action][0], y + MOVES[action][1]
    return x * size + y if 0 <= x < size and 0 <= y < size else None


def distances(maze: Maze, start: int) -> dict[int, int]:
    """Moves from ``start`` to every cell that can be reached, by breadth-first search."""
    found, queue = {start: 0}, deque([start])
    while queue:
        cell = queue.popleft()
        for action in MOVES:
            successor = neighbour(cell, action, maze.size)
            if maze.passages[cell, action] and successor is not None and successor not in found:
                found[successor] = found[cell] + 1
                queue.append(successor)
    return found


def shortest_actions(maze: Maze) -> list[int]:
    """The moves of the shortest path from start to goal."""
    to_goal, cell, actions = distances(maze, maze.goal_cell), maze.start_cell, []
    while cell != maze.goal_cell:
        for action in MOVES:
            successor = neighbour(cell, action, maze.size)
            if maze.passages[cell, action] and successor is not None and to_goal[successor] < to_goal[cell]:
                actions.append(action)
                cell = successor
                break
    return actions


# The maze: its shape


@pytest.mark.parametrize("size", [2, 3, 10])
def test_maze_is_perfect(size: int) -> None:
    """Exactly one path joins any two cells: all cells are connected by cells − 1 passages."""
    for seed in SEEDS:
        maze = Maze(maze_seed=seed, size=size)
        assert int(maze.passages.sum()) == 2 * (size * size - 1)  # each is open from both sides
        assert len(distances(maze, 0)) == size * size


def test_passages_are_symmetric_and_stay_inside() -> None:
    """A passage is open from both of its cells, and none leads out of the maze."""
    for seed in SEEDS:
        maze = Maze(maze_seed=seed)
        for cell, action in itertools.product(range(100), MOVES):
            successor = neighbour(cell, action, 10)
            if successor is None:
                assert not maze.passages[cell, action]
            else:
                assert maze.passages[cell, action] == maze.passages[successor, (action + 2) % 4]


@pytest.mark.parametrize("size", [2, 5, 10])
def test_start_and_goal_are_far_apart(size: int) -> None:
    """Their Euclidean distance is at least 80 % of the corner-to-corner diagonal (§4.1.1)."""
    places = set()
    for seed in SEEDS:
        maze = Maze(maze_seed=seed, size=size)
        (x, y), (goal_x, goal_y) = divmod(maze.start_cell, size), divmod(maze.goal_cell, size)
        assert math.hypot(x - goal_x, y - goal_y) >= 0.8 * math.hypot(size - 1, size - 1)
        places.add((maze.start_cell, maze.goal_cell))
    assert len(places) > 3  # drawn, not fixed


def test_optimal_length_is_the_shortest_path() -> None:
    """The reported optimal length is the number of moves of the shortest path."""
    for seed in SEEDS:
        maze = Maze(maze_seed=seed)
        _, info = maze.reset(seed=0)
        assert info == {"optimal_length": distances(maze, maze.start_cell)[maze.goal_cell]}


@pytest.mark.parametrize(("wanted", "permitted"), [((33, 35), {33, 34, 35}), (34, {34}), ([20, 21], {20, 21})])
def test_optimal_length_is_in_the_wanted_range(wanted: Any, permitted: set[int]) -> None:
    """A range is inclusive at both ends, a single number is met exactly, and every permitted length comes up."""
    lengths = {Maze(maze_seed=seed, optimal_length=wanted).finite_model.info["optimal_length"] for seed in range(60)}
    assert lengths == permitted


def test_mazes_are_drawn_by_depth_first_search() -> None:
    """Long corridors: optimal lengths are centred on 34 (Wilson's algorithm gives 22, Kruskal's 21.5, Prim's 18).

    The mean over 3 000 mazes was measured as 34.1 with a standard deviation of about 12: 300 mazes have a standard
    error of 0.7.
    """
    lengths = [float(Maze(maze_seed=seed).finite_model.info["optimal_length"]) for seed in range(300)]
    assert float(np.mean(lengths)) == pytest.approx(34.1, abs=3.5)


def test_maze_is_a_function_of_its_seed() -> None:
    """Equal seeds give equal mazes, different seeds different ones; distractors do not change the maze."""
    shapes = set()
    for seed in SEEDS:
        one, two = Maze(maze_seed=seed), Maze(maze_seed=seed, distractors=(10,))
        np.testing.assert_array_equal(one.passages, two.passages)
        assert (one.start_cell, one.goal_cell) == (two.start_cell, two.goal_cell)
        shapes.add(one.passages.tobytes())
    assert len(shapes) == len(SEEDS)


def test_impossible_optimal_length_says_what_was_found() -> None:
    """A range that no maze meets is given up after ``max_draws``, with the lengths that were seen."""
    seen = [Maze(maze_seed=seed, size=3).finite_model.info["optimal_length"] for seed in range(200)]
    with pytest.raises(ValueError, match="optimal_length: none of 500 mazes of 3x3 cells") as error:
        Maze(size=3, optimal_length=(50, 60), max_draws=500)
    assert f"50 to 60 moves; those drawn had {min(seen)} to {max(seen)}" in str(error.value)


@pytest.mark.parametrize(
    ("option", "value"),
    [
        ("size", 1),
        ("size", 2.5),
        ("size", 1001),
        ("distractors", 10),
        ("distractors", (1,)),
        ("distractors", "10"),
        ("max_steps", 0),
        ("max_draws", 0),
        ("reward_scale", 0),
        ("reward_scale", -1.0),
        ("reward_scale", float("nan")),
        ("optimal_length", (35, 33)),
        ("optimal_length", (33, 34, 35)),
        ("optimal_length", (33.0, 35.0)),
    ],
)
def test_maze_refuses_options_that_make_no_sense(option: str, value: Any) -> None:
    """Each refusal names the option and what was found."""
    with pytest.raises(ValueError, match=f"{option}: found"):
        Maze(**{option: value})


# The maze: its dynamics


def test_scale_multiplies_rewards_alone() -> None:
    """−0.1 and +1 become −10 and +100; nothing else changes."""
    plain, scaled = Maze(maze_seed=3).finite_model, Maze(maze_seed=3, reward_scale=100).finite_model
    np.testing.assert_array_equal(scaled.reward, 100 * plain.reward)
    np.testing.assert_array_equal(scaled.next_cell, plain.next_cell)


def test_moves_follow_passages_and_walls_stay() -> None:
    """In every cell, each action leads through an open passage or stays; −0.1 each, and +1 for entering the goal."""
    maze = Maze(maze_seed=3, size=6)
    model = maze.finite_model
    for cell, action in itertools.product(range(36), MOVES):
        expected = neighbour(cell, action, 6) if maze.passages[cell, action] else cell
        assert model.next_cell[cell, action, 0] == expected
        if cell != maze.goal_cell:
            enters = expected == maze.goal_cell
            assert model.reward[cell, action, 0] == (1.0 if enters else -0.1)
            assert bool(model.terminal[cell, action, 0]) == enters


def test_bump_into_a_wall_through_the_interface() -> None:
    """A move into a wall leaves the observation as it is and costs 0.1."""
    maze = Maze(maze_seed=0)
    before, _ = maze.reset(seed=0)
    wall = next(action for action in MOVES if not maze.passages[maze.start_cell, action])
    after, reward, terminated, truncated, _ = maze.step(wall)
    assert after.tolist() == before.tolist() == list(divmod(maze.start_cell, 10))
    assert (reward, terminated, truncated) == (-0.1, False, False)


def test_shortest_path_reaches_the_goal() -> None:
    """34 moves along the shortest path end at the goal: 33 · (−0.1) + 1 = −2.3."""
    maze = Maze(maze_seed=5, optimal_length=34)
    maze.reset(seed=0)
    steps = [maze.step(action) for action in shortest_actions(maze)]
    assert [terminated for _, _, terminated, _, _ in steps] == [False] * 33 + [True]
    assert sum(reward for _, reward, _, _, _ in steps) == pytest.approx(-2.3)
    assert steps[-1][0].tolist() == list(divmod(maze.goal_cell, 10))


@pytest.mark.parametrize("max_steps", [1, 7])
def test_maze_truncates(max_steps: int) -> None:
    """After ``max_steps`` steps the episode is truncated, not terminated."""
    maze = Maze(max_steps=max_steps)
    maze.reset(seed=0)
    wall = next(action for action in MOVES if not maze.passages[maze.start_cell, action])
    flags = [maze.step(wall)[2:4] for _ in range(max_steps)]
    assert flags == [(False, False)] * (max_steps - 1) + [(False, True)]


def test_maze_truncates_after_a_thousand_steps_by_default() -> None:
    """The limit of the dissertation's maze is 1000 steps (§4.1.1)."""
    assert Maze().finite_model.max_steps == 1000


def test_step_after_the_end_is_refused() -> None:
    """No episode under way, no step: before the first reset, after termination, after truncation."""
    maze = Maze(maze_seed=1, max_steps=3)
    with pytest.raises(RuntimeError, match="call reset"):
        maze.step(UP)
    maze.reset(seed=0)
    wall = next(action for action in MOVES if not maze.passages[maze.start_cell, action])
    for _ in range(3):
        maze.step(wall)
    with pytest.raises(RuntimeError, match="call reset"):
        maze.step(wall)
    longer = Maze(maze_seed=1)
    longer.reset(seed=0)
    for action in shortest_actions(longer):
        longer.step(action)
    with pytest.raises(RuntimeError, match="call reset"):
        longer.step(UP)


@pytest.mark.parametrize("options", [{}, {"distractors": (10,)}, {"distractors": (2, 3), "render_mode": "rgb_array"}])
def test_maze_passes_the_checks_of_gymnasium(options: dict[str, Any]) -> None:
    """Spaces, reseeding, types and rendering are as Gymnasium prescribes."""
    environment = gymnasium.make("apel/Maze-v0", size=4, **options)
    check_env(environment.unwrapped, skip_render_check="render_mode" not in options)


@pytest.mark.parametrize("distractors", [(), (10,)])
def test_episode_is_a_function_of_seed_and_actions(distractors: tuple[int, ...]) -> None:
    """The same seed and actions give the same episode, whatever was played before."""
    actions = np.random.default_rng(0).integers(0, 4, 50).tolist()

    def play(maze: Maze, seed: int) -> list[Any]:
        observation, _ = maze.reset(seed=seed)
        return [observation.tolist(), *((o.tolist(), r, d, t) for o, r, d, t, _ in map(maze.step, actions))]

    used, fresh = Maze(distractors=distractors), Maze(distractors=distractors)
    play(used, 1)
    assert play(used, 2) == play(fresh, 2)
    assert (play(used, 3) == play(used, 2)) == (not distractors)  # without distractors nothing is random


def test_reset_without_seed_goes_on_with_the_generator() -> None:
    """Without a seed, episodes follow from the last seeded reset, and differ from each other (Gymnasium's contract)."""
    one, two = Maze(distractors=(1000,)), Maze(distractors=(1000,))
    one.reset(seed=4)
    two.reset(seed=4)
    drawn = [(one.reset()[0].tolist(), two.reset()[0].tolist()) for _ in range(10)]
    assert all(first == second for first, second in drawn)
    assert len({tuple(first) for first, _ in drawn}) == 10


def test_distractor_is_uniform_and_independent() -> None:
    """A distractor takes each of its 10 values equally often, at reset and at every step, whatever it was before."""
    maze = Maze(distractors=(10,), max_steps=10**6)
    wall = next(action for action in MOVES if not maze.passages[maze.start_cell, action])
    maze.reset(seed=0)
    values = [int(maze.step(wall)[0][2]) for _ in range(20_000)]
    starts = [int(maze.reset(seed=seed)[0][2]) for seed in range(5_000)]
    for draws in (values, starts):
        tolerance = 5 * math.sqrt(0.1 * 0.9 / len(draws))
        for value in range(10):
            assert abs(draws.count(value) / len(draws) - 0.1) <= tolerance
    repeats = sum(one == other for one, other in itertools.pairwise(values)) / (len(values) - 1)
    assert abs(repeats - 0.1) <= 5 * math.sqrt(0.1 * 0.9 / len(values))


@pytest.mark.parametrize(
    ("distractors", "names"),
    [((), ()), ((10,), ("distractor",)), ((2, 3), ("distractor_0", "distractor_1"))],
)
def test_features_of_the_maze(distractors: tuple[int, ...], names: tuple[str, ...]) -> None:
    """An observation is x, y, then the distractors, in a MultiDiscrete space."""
    maze = Maze(size=7, distractors=distractors)
    assert maze.finite_model.features == ("x", "y", *names)
    assert maze.observation_space == spaces.MultiDiscrete([7, 7, *distractors])


def test_maze_picture_shows_start_goal_and_agent() -> None:
    """A picture is uint8 RGB, with a blue start, a green goal, black walls, and an orange agent that moves."""
    maze = Maze(maze_seed=2, size=5, render_mode="rgb_array")
    maze.reset(seed=0)
    before = maze.render()
    assert before.dtype == np.uint8
    assert before.shape == (5 * 24 + 2, 5 * 24 + 2, 3)
    maze.step(shortest_actions(maze)[0])
    after = maze.render()
    for colour in ((0, 114, 178), (0, 158, 115), (230, 159, 0), (30, 30, 30), (255, 255, 255)):
        for image in (before, after):
            assert np.all(image == colour, axis=-1).any(), colour
    orange = [np.argwhere(np.all(image == (230, 159, 0), axis=-1)).mean(axis=0) for image in (before, after)]
    # Column and row of the agent, in cells of 24 pixels behind a wall of 2: the middle of cell c is at 24 c + 13.
    for place, cell in zip(orange, (maze.start_cell, maze._cell), strict=True):
        assert [(place[1] - 13) / 24, (place[0] - 13) / 24] == pytest.approx(divmod(cell, 5))


def test_maze_picture_draws_walls_where_passages_are_shut() -> None:
    """Between two cells there is black exactly where no passage is."""
    maze = Maze(maze_seed=2, size=5, render_mode="rgb_array")
    maze.reset(seed=0)
    image = maze.render()
    for cell, action in itertools.product(range(25), MOVES):
        (x, y), (dx, dy) = divmod(cell, 5), MOVES[action]
        # From the middle of the cell (24 c + 12) twelve pixels in the direction of the move.
        pixel = image[24 * y + 12 + 12 * dy + (dy >= 0), 24 * x + 12 + 12 * dx + (dx >= 0)]
        assert (pixel.tolist() == [30, 30, 30]) == (not maze.passages[cell, action])


# Gymnasium's own finite environments


@pytest.mark.parametrize(
    ("id_", "options", "max_steps"),
    [
        ("FrozenLake-v1", {}, None),
        ("FrozenLake-v1", {"map_name": "8x8", "is_slippery": False}, None),
        ("CliffWalking-v1", {}, 60),
        ("CliffWalking-v1", {"is_slippery": True}, 60),
        ("Taxi-v4", {}, None),
    ],
)
def test_tables_are_those_of_gymnasium(id_: str, options: dict[str, Any], max_steps: int | None) -> None:
    """For every state and action the tables give each (next state, reward, end) the probability that Gymnasium does."""
    world = make_world(EnvironmentConfig(id_, options, max_episode_steps=max_steps), 0)
    raw: Any = gymnasium.make(id_, max_episode_steps=max_steps, **options).unwrapped
    model = world.model
    assert model is not None
    assert model.features == ("state",)
    for state, actions in raw.P.items():
        for action, outcomes in actions.items():
            expected: Counter[Any] = Counter()
            for probability, successor, reward, terminated in outcomes:
                expected[(successor, float(reward), bool(terminated))] += probability
            assert outcome_probabilities(model, state, action) == pytest.approx(
                {key: p for key, p in expected.items() if p > 0}, abs=1e-12
            )
    starts = np.diff(model.start_cumulative, prepend=0.0)
    assert dict(zip(model.start_cell.tolist(), starts.tolist(), strict=True)) == pytest.approx(
        {s: p for s, p in enumerate(raw.initial_state_distrib.tolist()) if p > 0}, abs=1e-12
    )


def outcome_probabilities(model: FiniteModel, state: int, action: int) -> dict[Any, float]:
    """Probability of each (next state, reward, end), over outcomes that can happen."""
    found: Counter[Any] = Counter()
    below = 0.0
    for outcome, cumulative in enumerate(model.cumulative[state, action].tolist()):
        key = (
            int(model.next_cell[state, action, outcome]),
            float(model.reward[state, action, outcome]),
            bool(model.terminal[state, action, outcome]),
        )
        if cumulative > below:
            found[key] += cumulative - below
        below = cumulative
    assert below == 1.0
    return dict(found)


class Awkward:
    """Tables whose probabilities do not add up to 1 in floating point, and with impossible outcomes at the end."""

    # 0.1 ten times adds up to 0.9999999999999999.
    P: dict[int, dict[int, list[tuple[float, int, float, bool]]]] = {  # noqa: RUF012 - the interface is Gymnasium's
        0: {0: [(0.1, k % 2, float(k), False) for k in range(10)], 1: [(1.0, 1, 0.0, True)]},
        1: {0: [(0.5, 0, 0.0, False), (0.5, 1, 1.0, True), (0.0, 0, 9.0, False)], 1: [(1.0, 1, 0.0, True)]},
    }
    initial_state_distrib = np.array([0.0, 1.0])


def test_cumulative_tables_end_in_one() -> None:
    """The last outcome that can happen has cumulative probability exactly 1, so that no draw falls behind it."""
    model = toy_text_model(Awkward(), 5)
    assert model.cumulative[0, 0, 9] == 1.0
    assert model.cumulative[0, 0, :9].max() < 1.0
    assert model.cumulative[1, 0].tolist()[:3] == [0.5, 1.0, 1.0]  # the third outcome is impossible
    assert model.cumulative[0, 1].tolist() == [1.0] * 10
    assert (model.start_cell.tolist(), model.start_cumulative.tolist()) == ([1], [1.0])


def test_finite_environment_without_limit_is_refused() -> None:
    """An episode without a limit could last for ever: the error says what to give."""
    with pytest.raises(ValueError, match="CliffWalking-v1 sets no limit to an episode: give max_episode_steps"):
        make_world(EnvironmentConfig("CliffWalking-v1"), 0)


@pytest.mark.parametrize(("id_", "limit", "expected"), [("FrozenLake-v1", None, 100), ("FrozenLake-v1", 7, 7)])
def test_limit_is_gymnasiums_or_the_users(id_: str, limit: int | None, expected: int) -> None:
    """Without ``max_episode_steps`` the registered limit holds."""
    world = make_world(EnvironmentConfig(id_, max_episode_steps=limit), 0)
    assert world.model is not None
    assert world.model.max_steps == expected


# Worlds


def first_observation(world: World, episode_seed: int) -> Any:
    return np.asarray(world.environment.reset(seed=episode_seed)[0]).tolist()


def test_world_of_a_maze() -> None:
    """A maze's world has tables, names and its optimal length, and its shape is drawn from the run's maze stream."""
    config = EnvironmentConfig("apel/Maze-v0", {"distractors": [10]}, run_seed="maze_seed")
    world = make_world(config, 123)
    assert isinstance(world.environment.unwrapped, Maze)
    assert world.features == ("x", "y", "distractor")
    assert world.key == make_key(123, Role.ENVIRONMENT)
    expected = Maze(maze_seed=make_key(123, Role.MAZE) >> 1, distractors=[10])
    np.testing.assert_array_equal(world.environment.unwrapped.passages, expected.passages)
    assert world.info == dict(expected.finite_model.info)
    other = make_world(config, 124).environment.unwrapped
    assert isinstance(other, Maze)
    assert other.passages.tobytes() != expected.passages.tobytes()


def test_world_without_run_seed_is_the_same_in_every_run() -> None:
    """Without the name of a seed option, all runs play the same maze."""
    one, two = (make_world(EnvironmentConfig("apel/Maze-v0"), seed).model for seed in (1, 2))
    assert one is not None
    assert two is not None
    np.testing.assert_array_equal(one.next_cell, two.next_cell)


def test_shorter_limit_of_a_maze_reaches_its_tables() -> None:
    """``max_episode_steps`` shortens a maze in its interface and in its tables; a longer one leaves the maze's own."""
    for limit, expected in ((5, 5), (5_000, 20)):
        world = make_world(EnvironmentConfig("apel/Maze-v0", {"max_steps": 20}, max_episode_steps=limit), 0)
        assert world.model is not None
        assert world.model.max_steps == expected
        maze = world.environment.unwrapped
        assert isinstance(maze, Maze)
        world.environment.reset(seed=0)
        wall = next(action for action in MOVES if not maze.passages[maze.start_cell, action])
        steps = 1
        while not world.environment.step(wall)[3]:
            steps += 1
        assert steps == expected


def test_world_of_a_continuous_environment() -> None:
    """CartPole has no tables and no names; its episodes are functions of their seeds."""
    world = make_world(EnvironmentConfig("CartPole-v1", max_episode_steps=30), 9)
    assert (world.model, world.features, world.info) == (None, None, {})
    assert first_observation(world, 5) == first_observation(world, 5)
    assert first_observation(world, 5) != first_observation(world, 6)


def test_finite_world_plays_the_projects_streams() -> None:
    """A toy-text environment is replaced by its tables, so that compiled and plain code see the same episodes."""
    world = make_world(EnvironmentConfig("FrozenLake-v1"), 9)
    assert isinstance(world.environment, FiniteEnvironment)
    assert world.environment.finite_model is world.model


def test_tuple_observations_of_numbers_are_vectors() -> None:
    """Blackjack's tuple (player 32, dealer 11, ace 2) becomes a vector of three whole numbers, the same values."""
    world = make_world(EnvironmentConfig("Blackjack-v1"), 9)
    space = world.environment.observation_space
    assert isinstance(space, spaces.MultiDiscrete)
    assert (space.nvec.tolist(), world.features) == ([32, 11, 2], ("0", "1", "2"))
    plain = gymnasium.make("Blackjack-v1")
    for seed in range(5):
        observation, _ = world.environment.reset(seed=seed)
        assert (observation.dtype, tuple(observation.tolist())) == (np.int64, plain.reset(seed=seed)[0])


def test_other_tuples_are_flattened() -> None:
    """A tuple with a Box in it becomes one vector of numbers."""

    class Mixed(Reporter):
        observation_space = spaces.Tuple((spaces.Discrete(3), spaces.Box(0, 1, (2,))))  # type: ignore[assignment]

        def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, Any]:
            return (2, np.array([0.5, 0.25], dtype=np.float32)), {}

    observation, _ = make_world(EnvironmentConfig(Mixed, {"label": "a"}), 9).environment.reset(seed=1)
    assert observation.tolist() == [0, 0, 1, 0.5, 0.25]


def test_first_reset_uses_the_seed_of_episode_0() -> None:
    """What a world reports is reported by the episode 0 that will be played."""
    config = EnvironmentConfig("tests:Reporter", {"label": "a"})
    world = make_world(config, 77, Reporter)
    assert world.info == {"seed": world.seeds.of_episode(0), "half": 0.5}
    assert world.info["seed"] < 2**31


def test_an_environment_says_that_it_takes_wide_seeds() -> None:
    """Then, and where it is known to, its seeds have 63 bits; a wrapper that seeds has to say so too."""

    class Wide(Reporter):
        seed_bits = 63

    class Reseeding(gymnasium.Wrapper[Any, Any, Any, Any]):
        def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
            return self.env.reset(seed=seed, options=options)

    class Renamed(gymnasium.ActionWrapper[Any, Any, Any]):
        def action(self, action: Any) -> Any:
            return action

    class Longer(CartPoleEnv):
        pass

    config = EnvironmentConfig("tests:Reporter", {"label": "a"})
    world = make_world(config, 77, Wide)
    assert world.info["seed"] == splitmix.episode_seed(world.key, 0)
    for made, is_wide in (
        (Wide, True),
        (lambda label: Reseeding(Wide(label)), False),
        (lambda label: Renamed(Wide(label)), True),
        (lambda label: Longer(), True),
        (lambda label: gymnasium.make("Acrobot-v1"), True),
        (lambda label: Renamed(gymnasium.make("Acrobot-v1")), True),
        (lambda label: Reseeding(gymnasium.make("Acrobot-v1")), False),
    ):
        assert make_world(config, 77, made).seeds.is_wide == is_wide


@pytest.mark.parametrize(("bits", "most"), [(None, 2**31), (63, 2**63)])
def test_the_seed_of_a_run_fits_as_well(bits: int | None, most: int) -> None:
    """``run_seed`` gives an environment a seed of 31 bits, unless what makes it says that it takes more."""

    def factory(label: int) -> Reporter:
        labels.append(label)
        return Reporter("a")

    labels: list[int] = []
    if bits:
        factory.seed_bits = bits  # type: ignore[attr-defined]
    for seed in range(40):
        make_world(EnvironmentConfig("tests:Reporter", run_seed="label"), seed, factory)
    assert most / 40 < max(labels) < most
    assert len(set(labels)) == 40


class Reporter(gymnasium.Env[Any, Any]):
    """An environment by import path that reports numbers, and other things that are none."""

    observation_space = spaces.Discrete(2)
    action_space = spaces.Discrete(2)

    def __init__(self, label: str) -> None:
        if label == "wrong":
            message = "label: found 'wrong'"
            raise ValueError(message)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        super().reset(seed=seed)
        return 0, {"seed": seed, "half": 0.5, "name": "text", "mask": np.ones(3)}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        return 0, 0.0, False, False, {}


class Saying(Reporter):
    """An environment that wants words."""

    action_space = spaces.Text(3)  # type: ignore[assignment]

    def __init__(self) -> None:
        super().__init__("a")


def test_environment_by_import_path_is_truncated() -> None:
    """``max_episode_steps`` bounds the episodes of an environment that Gymnasium does not know."""
    world = make_world(EnvironmentConfig("tests:Reporter", {"label": "a"}, max_episode_steps=3), 0, Reporter)
    world.environment.reset(seed=0)
    assert [world.environment.step(0)[3] for _ in range(3)] == [False, False, True]


def drawn_lake(seed: int | None = None) -> gymnasium.Env[Any, Any]:
    """A lake whose map is another one each time, unless it is given a seed."""
    return gymnasium.make("FrozenLake-v1", desc=generate_random_map(6, seed=seed))


class DrawnMaze(FiniteEnvironment):
    """The same of a user's class that declares its tables."""

    def __init__(self, seed: int | None = None) -> None:
        super().__init__(Maze(int(np.random.default_rng(seed).integers(2**32)), size=5).finite_model)


@pytest.mark.parametrize("make", [drawn_lake, DrawnMaze])
def test_tables_that_are_drawn_without_a_seed_are_refused(make: Any) -> None:
    """No other process, and no run that resumes, would play the same ones."""
    with pytest.raises(ValueError, match="tests:drawn: found other tables when it was made a second time"):
        make_world(EnvironmentConfig("tests:drawn"), 0, make)
    for options, run_seed in (({"seed": 3}, None), ({}, "seed")):
        world = make_world(EnvironmentConfig("tests:drawn", options, run_seed=run_seed), 0, make)
        assert world.model is not None


def test_tables_of_a_registered_id_that_are_drawn_without_a_seed_are_refused() -> None:
    """Whatever name the user's code goes by; and maps that Gymnasium draws for an id are told of as such."""
    try:
        gymnasium.register("tests/Drawn-v0", drawn_lake)
        gymnasium.register("tests/Lake-v0", FrozenLakeEnv, max_episode_steps=100, kwargs={"map_name": None})
        with pytest.raises(ValueError, match="tests/Drawn-v0: found other tables when it was made a second time"):
            make_world(EnvironmentConfig("tests/Drawn-v0"), 0)
        with pytest.raises(ValueError, match="tests/Lake-v0: map_name: found None and no desc"):
            make_world(EnvironmentConfig("tests/Lake-v0"), 0)
    finally:
        for name in ("tests/Drawn-v0", "tests/Lake-v0"):
            gymnasium.registry.pop(name, None)


def test_tables_are_held_against_each_other_once_for_all_runs() -> None:
    """It costs a second making of one environment, which is closed."""
    events: list[str] = []

    class Told(Maze):
        def __init__(self, **options: Any) -> None:
            events.append("made")
            super().__init__(size=3, **options)

        def close(self) -> None:
            events.append("closed")

    worlds = [make_world(EnvironmentConfig("tests:Told", run_seed="maze_seed"), seed, Told) for seed in range(3)]
    assert all(world.model is not None for world in worlds)
    assert events == ["made", "made", "closed", "made", "made"]


@pytest.mark.parametrize(
    ("config", "factory", "message"),
    [
        (EnvironmentConfig("Nowhere-v0"), None, "Nowhere-v0: .*exist"),
        (EnvironmentConfig("nowhere/Maze-v0"), None, "nowhere/Maze-v0: .*nowhere"),
        (EnvironmentConfig("no_such_module:Maze-v0"), None, "no_such_module"),
        (EnvironmentConfig("apel/Maze-v0", {"size": 1}), None, "apel/Maze-v0: size: found 1"),
        (EnvironmentConfig("apel/Maze-v0", {"colour": 1}), None, "apel/Maze-v0: .*colour"),
        (
            EnvironmentConfig("tests:Saying"),
            Saying,
            r"tests:Saying: found the action space Text.*expected one of Discrete,",
        ),
        (EnvironmentConfig("tests:Reporter", {"label": "wrong"}), Reporter, "tests:Reporter: label: found 'wrong'"),
        (EnvironmentConfig("tests:Reporter"), Reporter, "tests:Reporter: .*label"),
    ],
)
def test_unusable_environment_is_refused(config: EnvironmentConfig, factory: Any, message: str) -> None:
    """Unknown ids, wrong options and spaces that an ensemble cannot use become one `ValueError` that names the id."""
    with pytest.raises(ValueError, match=message):
        make_world(config, 0, factory)
