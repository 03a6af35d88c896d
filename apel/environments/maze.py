"""The maze domain (§4.1.1): a perfect maze with a far-off goal, and optional distractor variables.

Perfect: exactly one path joins any two cells. The maze is drawn by randomised depth-first search (recursive
backtracker) from a random cell; its long corridors are what gives optimal lengths centred on the dissertation's 33–35.
Start and goal are uniform over the pairs of cells whose Euclidean distance is at least 80 % of the corner-to-corner
diagonal. Mazes are drawn until the optimal length, counted in moves, lies in the wanted range.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from apel.dynamics.finite_model import FiniteModel
from apel.environments.drawing import draw_maze
from apel.environments.finite_environment import FiniteEnvironment
from apel.numerics.compiled import njit
from apel.numerics.streams import Stream, integer, stream_of_seed

UP, RIGHT, DOWN, LEFT = range(4)
_MOVES = np.array([(0, -1), (1, 0), (0, 1), (-1, 0)], dtype=np.int64)
_STEP_REWARD = -0.1
_GOAL_REWARD = 1.0
_MIN_DISTANCE_SHARE = 0.8
_MAX_STATES = 1_000_000
"""Cells and values of distractors: tables of all states must fit into memory, for every run and learner."""
_MAX_CELLS_DRAWN = 10_000_000
"""Over all mazes that are drawn for one: seconds, where none fits."""


class Maze(FiniteEnvironment):
    """A maze of ``size`` × ``size`` cells.

    Observation: ``int64[2 + len(distractors)]``, the column x, the row y (0 is the top row), then the distractors,
    each drawn anew at every step. Actions: 0 up, 1 right, 2 down, 3 left; a move into a wall stays. Reward: −0.1 per
    step, and +1 instead on the step that reaches the goal, which ends the episode; times ``reward_scale``. Truncated
    after ``max_steps`` steps.

    Parameters
    ----------
    maze_seed:
        The seed of the maze, start and goal.
    size:
        Cells per side, at least 2.
    distractors:
        The number of values of each distractor variable, such as ``(10,)``.
    optimal_length:
        A length in moves, or an inclusive range ``(shortest, longest)``, that the shortest path must have.
    max_steps:
        Steps after which an episode is truncated.
    max_draws:
        How many mazes are drawn at most to meet ``optimal_length``; fewer where they are very large.
    render_mode:
        See Gymnasium; ``"rgb_array"`` is the only one.
    reward_scale:
        What all rewards are multiplied by, above 0.

    Raises
    ------
    ValueError
        If an argument makes no sense, or if none of ``max_draws`` mazes has a fitting optimal length.
    """

    metadata: ClassVar[dict[str, Any]] = {"render_modes": ["rgb_array"], "render_fps": 10}  # type: ignore[misc]

    def __init__(
        self,
        maze_seed: int = 0,
        size: int = 10,
        distractors: Sequence[int] = (),
        optimal_length: int | Sequence[int] | None = None,
        max_steps: int = 1000,
        max_draws: int = 10_000,
        render_mode: str | None = None,
        reward_scale: float = 1.0,
    ) -> None:
        _check(maze_seed, size, distractors, max_steps, max_draws)
        if not 0 < reward_scale < math.inf:
            message = f"reward_scale: found {reward_scale!r}, expected a number above 0"
            raise ValueError(message)
        max_draws = min(max_draws, max(_MAX_CELLS_DRAWN // size**2, 1))
        shortest, longest = _length_range(optimal_length, size)
        stream = stream_of_seed(maze_seed)
        passages = np.zeros((size * size, 4), dtype=np.bool_)
        start, goal, length, shortest_seen, longest_seen = _draw_until(
            stream, size, passages, shortest, longest, max_draws
        )
        if length < 0:
            message = (
                f"optimal_length: none of {max_draws} mazes of {size}x{size} cells has an optimal length of "
                f"{shortest} to {longest} moves; those drawn had {shortest_seen} to {longest_seen}"
            )
            raise ValueError(message)
        self.passages: NDArray[np.bool_] = passages
        """``bool[cells, 4]``: whether the move in each direction is open."""
        self.start_cell, self.goal_cell = int(start), int(goal)
        self.size = size
        self.render_mode = render_mode
        self._visits = np.zeros(size * size, dtype=np.int64)
        model = _model(passages, size, self.start_cell, self.goal_cell, int(length), tuple(distractors), max_steps)
        super().__init__(replace(model, reward=model.reward * reward_scale))

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Start an episode."""
        started = super().reset(seed=seed, options=options)
        self._visits[:] = 0
        self._visits[self._cell] = 1
        return started

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """See `FiniteEnvironment`."""
        stepped = super().step(action)
        self._visits[self._cell] += 1
        return stepped

    def render(self) -> Any:
        """The maze as ``uint8[height, width, 3]``: walls black, start blue, goal green, agent orange; a cell is the
        darker the more often it was visited in this episode.
        """
        return draw_maze(self.passages, self.size, self.start_cell, self.goal_cell, self._cell, self._visits)


def _check(maze_seed: int, size: int, distractors: Sequence[int], max_steps: int, max_draws: int) -> None:
    if not isinstance(maze_seed, int) or not 0 <= maze_seed < 2**64:
        message = f"maze_seed: found {maze_seed!r}, expected a whole number from 0 to 2^64 - 1"
        raise ValueError(message)
    if not isinstance(size, int) or not 2 <= size <= 1000:
        message = f"size: found {size!r}, expected a whole number of cells from 2 to 1000"
        raise ValueError(message)
    if not isinstance(distractors, list | tuple) or any(not isinstance(n, int) or n < 2 for n in distractors):
        message = f"distractors: found {distractors!r}, expected a list of whole numbers of values, each at least 2"
        raise ValueError(message)
    states = size**2 * math.prod(distractors)
    if states > _MAX_STATES:
        message = (
            f"distractors: found {distractors!r} in a maze of {size}x{size} cells, which makes {states:,} states, "
            f"expected at most {_MAX_STATES:,}"
        )
        raise ValueError(message)
    for name, value in (("max_steps", max_steps), ("max_draws", max_draws)):
        if not isinstance(value, int) or value < 1:
            message = f"{name}: found {value!r}, expected a whole number of at least 1"
            raise ValueError(message)


def _length_range(optimal_length: int | Sequence[int] | None, size: int) -> tuple[int, int]:
    if optimal_length is None:
        return 1, size * size
    if isinstance(optimal_length, int):
        return optimal_length, optimal_length
    bounds = list(optimal_length) if isinstance(optimal_length, list | tuple) else []
    if len(bounds) != 2 or not all(isinstance(bound, int) for bound in bounds) or bounds[0] > bounds[1]:
        message = f"optimal_length: found {optimal_length!r}, expected a number of moves or [shortest, longest]"
        raise ValueError(message)
    return bounds[0], bounds[1]


def _model(
    passages: NDArray[np.bool_], size: int, start: int, goal: int, length: int, distractors: tuple[int, ...], steps: int
) -> FiniteModel:
    cells = size * size
    offset = _MOVES[:, 0] * size + _MOVES[:, 1]
    next_cell = np.arange(cells)[:, None] + np.where(passages, offset[None, :], 0)
    terminal = next_cell == goal
    return FiniteModel(
        next_cell=next_cell.astype(np.int32)[..., None],
        cumulative=np.ones((cells, 4, 1)),
        reward=np.where(terminal, _GOAL_REWARD, _STEP_REWARD)[..., None],
        terminal=terminal[..., None],
        start_cell=np.array([start], dtype=np.int32),
        start_cumulative=np.ones(1),
        max_steps=steps,
        features=("x", "y", *_distractor_names(len(distractors))),
        feature_sizes=(size, size, *distractors),
        num_distractors=len(distractors),
        info={"optimal_length": length},
    )


def _distractor_names(count: int) -> tuple[str, ...]:
    return ("distractor",) if count == 1 else tuple(f"distractor_{i}" for i in range(count))


@njit
def _carve(stream: Stream, size: int, passages: NDArray[np.bool_]) -> None:
    """Randomised depth-first search with an explicit stack; ``passages`` is written in place."""
    cells = size * size
    passages[:] = False
    visited = np.zeros(cells, dtype=np.bool_)
    stack = np.empty(cells, dtype=np.int64)
    candidates = np.empty(4, dtype=np.int64)
    depth = 0
    stack[0] = integer(stream, cells)
    visited[stack[0]] = True
    while depth >= 0:
        cell = stack[depth]
        x, y = cell // size, cell % size
        count = 0
        for direction in range(4):
            next_x, next_y = x + _MOVES[direction, 0], y + _MOVES[direction, 1]
            if 0 <= next_x < size and 0 <= next_y < size and not visited[next_x * size + next_y]:
                candidates[count] = direction
                count += 1
        if count == 0:
            depth -= 1
            continue
        direction = candidates[integer(stream, count)]
        successor = (x + _MOVES[direction, 0]) * size + y + _MOVES[direction, 1]
        passages[cell, direction] = True
        passages[successor, (direction + 2) % 4] = True
        visited[successor] = True
        depth += 1
        stack[depth] = successor


@njit
def _shortest_path(passages: NDArray[np.bool_], size: int, start: int, goal: int) -> int:
    """Number of moves from start to goal, by breadth-first search."""
    distance = np.full(size * size, -1, dtype=np.int64)
    queue = np.empty(size * size, dtype=np.int64)
    queue[0] = start
    distance[start] = 0
    head, tail = 0, 1
    while head < tail:
        cell = queue[head]
        head += 1
        for direction in range(4):
            successor = cell + _MOVES[direction, 0] * size + _MOVES[direction, 1]
            if passages[cell, direction] and distance[successor] < 0:
                distance[successor] = distance[cell] + 1
                queue[tail] = successor
                tail += 1
    return distance[goal]


@njit
def _draw_until(
    stream: Stream, size: int, passages: NDArray[np.bool_], shortest: int, longest: int, max_draws: int
) -> tuple[int, int, int, int, int]:
    """Draw mazes until one fits: start, goal, optimal length (−1 if none did), shortest and longest length seen."""
    wanted = _MIN_DISTANCE_SHARE * (size - 1) * math.sqrt(2.0)
    shortest_seen, longest_seen = size * size, 0
    for _ in range(max_draws):
        _carve(stream, size, passages)
        while True:
            start, goal = integer(stream, size * size), integer(stream, size * size)
            if math.hypot(start // size - goal // size, start % size - goal % size) >= wanted:
                break
        length = _shortest_path(passages, size, start, goal)
        shortest_seen, longest_seen = min(shortest_seen, length), max(longest_seen, length)
        if shortest <= length <= longest:
            return start, goal, length, shortest_seen, longest_seen
    return 0, 0, -1, shortest_seen, longest_seen
