"""Pictures of mazes, with start, goal and the shortest path between them (Figure 4.1)."""

from __future__ import annotations

import math
from collections import deque
from typing import Any

import numpy as np

from apel.configs import EnvironmentConfig
from apel.environments.factory import make_world
from apel.numerics.seeding import run_seeds
from jobs.analysis.plotting import style
from jobs.experiment.figures import Picture
from jobs.experiment.spec import Gallery

_MAZES_PER_ROW = 3


def draw_mazes(plt: Any, picture: Picture, gallery: Gallery) -> Any:
    """Figure 4.1: the mazes of the first runs, with start, goal and the shortest path."""
    columns = min(_MAZES_PER_ROW, picture.count)
    rows = math.ceil(picture.count / columns)
    figure, all_axes = plt.subplots(rows, columns, figsize=(2.5 * columns, 2.65 * rows + 0.9), squeeze=False)
    described = gallery.environment
    if described is None:
        message = f"{picture.name}: found no environment, expected one to draw"
        raise ValueError(message)
    config = EnvironmentConfig(**described.model_dump())
    for number, seed in enumerate(run_seeds(gallery.seed, picture.count)):
        _maze(all_axes.flat[number], make_world(config, seed).environment.unwrapped)
    for axes in all_axes.flat:
        axes.set_axis_off()
    style.legend(figure, [all_axes[0, 0]])
    style.title(figure, picture.title or gallery.title or gallery.name)
    return figure


def _maze(axes: Any, maze: Any) -> None:
    from matplotlib.collections import LineCollection

    size, start, goal = maze.size, maze.start_cell, maze.goal_cell
    cells = np.array(_shortest_path(maze.passages, size, start, goal))
    x, y = cells // size + 0.5, cells % size + 0.5
    axes.add_collection(LineCollection(_walls(maze.passages, size), colors="black", linewidths=1.3, capstyle="round"))
    axes.plot(x, y, color="#D55E00", linewidth=1.5, label="shortest path")
    axes.plot(x[:1], y[:1], "o", ms=8, color="#0072B2", linestyle="", label="start")
    axes.plot(x[-1:], y[-1:], "s", ms=8, color="#009E73", linestyle="", label="goal")
    axes.set(xlim=(-0.1, size + 0.1), ylim=(size + 0.1, -0.1), aspect="equal")
    axes.set_title(f"{len(cells) - 1} moves", fontsize=9, pad=2)


def _walls(passages: Any, size: int) -> list[Any]:
    """Every closed side of every cell, from corner to corner."""
    sides = (((0, 0), (1, 0)), ((1, 0), (1, 1)), ((0, 1), (1, 1)), ((0, 0), (0, 1)))  # up, right, down, left
    return [
        [(cell // size + x, cell % size + y) for x, y in sides[direction]]
        for cell, direction in zip(*np.nonzero(~passages), strict=True)
    ]


def _shortest_path(passages: Any, size: int, start: int, goal: int) -> list[int]:
    """Cells from start to goal, by breadth-first search."""
    offsets = (-1, size, 1, -size)  # up, right, down, left
    came_from = {start: start}
    queue = deque([start])
    while goal not in came_from:
        cell = queue.popleft()
        for offset, is_open in zip(offsets, passages[cell], strict=True):
            if is_open and cell + offset not in came_from:
                came_from[cell + offset] = cell
                queue.append(cell + offset)
    path = [goal]
    while path[-1] != start:
        path.append(came_from[path[-1]])
    return path[::-1]
