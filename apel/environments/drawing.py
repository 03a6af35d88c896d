"""Pictures of mazes, as arrays."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

_PIXELS_PER_CELL = 24
_WALL_PIXELS = 2
_WHITE, _BLACK = (255, 255, 255), (30, 30, 30)
_BLUE, _GREEN, _ORANGE = (0, 114, 178), (0, 158, 115), (230, 159, 0)


def draw_maze(passages: NDArray[np.bool_], size: int, start: int, goal: int, agent: int) -> NDArray[np.uint8]:
    """Draw a maze with ``passages`` ``bool[cells, 4]`` (up, right, down, left): ``uint8[height, width, 3]``.

    Cell (x, y) has number x · size + y; y = 0 is the top row.
    """
    side = size * _PIXELS_PER_CELL + _WALL_PIXELS
    image = np.full((side, side, 3), _WHITE, dtype=np.uint8)
    for cell in range(size * size):
        left, top = (cell // size) * _PIXELS_PER_CELL, (cell % size) * _PIXELS_PER_CELL
        bottom, right = top + _PIXELS_PER_CELL, left + _PIXELS_PER_CELL
        walls = (
            (slice(top, top + _WALL_PIXELS), slice(left, right + _WALL_PIXELS)),
            (slice(top, bottom + _WALL_PIXELS), slice(right, right + _WALL_PIXELS)),
            (slice(bottom, bottom + _WALL_PIXELS), slice(left, right + _WALL_PIXELS)),
            (slice(top, bottom + _WALL_PIXELS), slice(left, left + _WALL_PIXELS)),
        )
        for direction, area in enumerate(walls):
            if not passages[cell, direction]:
                image[area] = _BLACK
    _dot(image, size, start, _BLUE, radius=7)
    _dot(image, size, goal, _GREEN, radius=7)
    _dot(image, size, agent, _ORANGE, radius=4)
    return image


def _dot(image: NDArray[np.uint8], size: int, cell: int, colour: tuple[int, int, int], radius: int) -> None:
    middle = (_PIXELS_PER_CELL + _WALL_PIXELS) // 2
    column, row = (cell // size) * _PIXELS_PER_CELL + middle, (cell % size) * _PIXELS_PER_CELL + middle
    rows, columns = np.ogrid[: image.shape[0], : image.shape[1]]
    image[(rows - row) ** 2 + (columns - column) ** 2 <= radius**2] = colour
