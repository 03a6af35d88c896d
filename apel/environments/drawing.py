"""Pictures of mazes and cart poles, as arrays."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from apel.environments.canvas import BLACK, BLUE, GREEN, GREY, LIGHT_GREY, ORANGE, WHITE, Canvas, Colour, Point

_CELL_PIXELS, _WALL_PIXELS = 24, 2
_OFTEN_VISITED = (250, 205, 150)
_FADING = 0.7
"""How much of a cell's white each further visit leaves."""

_METRE_PIXELS = 100
_SCENE_WIDTH, _SCENE_HEIGHT, _TRACK_Y = 600, 210, 170
_CART_WIDTH, _CART_HEIGHT, _WHEEL = 56, 26, 6


def draw_maze(
    passages: NDArray[np.bool_], size: int, start: int, goal: int, agent: int, visits: NDArray[np.int64]
) -> NDArray[np.uint8]:
    """Draw a maze with ``passages`` ``bool[cells, 4]`` (up, right, down, left): ``uint8[height, width, 3]``.

    Start, goal and agent are cells; cell (x, y) has number x · size + y, and y = 0 is the top row. A cell is the darker
    the more often it was visited, ``int64[cells]``.
    """
    side = size * _CELL_PIXELS + _WALL_PIXELS
    canvas = Canvas(side, side)
    for cell in np.flatnonzero(visits).tolist():
        canvas.rectangle(*_corner(cell, size), _CELL_PIXELS, _CELL_PIXELS, _shade(int(visits[cell])))
    for cell in range(size * size):
        _draw_walls(canvas, *_corner(cell, size), passages[cell])
    canvas.disc(_middle(start, size), 9, BLUE)
    canvas.disc(_middle(start, size), 7, _shade(int(visits[start])))
    canvas.disc(_middle(goal, size), 9, GREEN)
    canvas.disc(_middle(agent, size), 6, BLACK)
    canvas.disc(_middle(agent, size), 5, ORANGE)
    return canvas.image


def _draw_walls(canvas: Canvas, left: int, top: int, passages: NDArray[np.bool_]) -> None:
    long = _CELL_PIXELS + _WALL_PIXELS
    walls = (
        (left, top, long, _WALL_PIXELS),
        (left + _CELL_PIXELS, top, _WALL_PIXELS, long),
        (left, top + _CELL_PIXELS, long, _WALL_PIXELS),
        (left, top, _WALL_PIXELS, long),
    )
    for wall, is_open in zip(walls, passages, strict=True):
        if not is_open:
            canvas.rectangle(*wall, BLACK)


def _corner(cell: int, size: int) -> tuple[int, int]:
    column, row = divmod(cell, size)
    return column * _CELL_PIXELS, row * _CELL_PIXELS


def _middle(cell: int, size: int) -> Point:
    left, top = _corner(cell, size)
    inner = (_CELL_PIXELS + _WALL_PIXELS) // 2
    return left + inner, top + inner


def _shade(visits: int) -> Colour:
    """From white to the colour of a cell that was visited often."""
    share = 1.0 - _FADING**visits
    red, green, blue = (round(w + share * (o - w)) for w, o in zip(WHITE, _OFTEN_VISITED, strict=True))
    return red, green, blue


def draw_cart_pole(
    position: float, angle: float, pole_length: float, position_limit: float, angle_limit: float
) -> NDArray[np.uint8]:
    """Draw a cart pole, lengths in m and angles in rad, from the vertical to the right: ``uint8[210, 600, 3]``.

    The posts at the track are as far as the cart's middle may go, the grey lines as far as the pole may lean.
    """
    canvas = Canvas(_SCENE_WIDTH, _SCENE_HEIGHT)
    middle = _SCENE_WIDTH / 2 - 0.5
    canvas.rectangle(0, _TRACK_Y, _SCENE_WIDTH, 2, BLACK)
    for side in (-1, 1):
        post = middle + side * position_limit * _METRE_PIXELS
        canvas.line((post, _TRACK_Y + 10), (post, _TRACK_Y + 24), 1.5, GREY)
    x = middle + position * _METRE_PIXELS
    floor, length = _TRACK_Y - 2 * _WHEEL, pole_length * _METRE_PIXELS
    axle = (x, floor - _CART_HEIGHT + 4.0)
    for side in (-1, 1):
        canvas.line(axle, _tip(axle, length + 24, side * angle_limit), 0.6, LIGHT_GREY)
    _draw_cart(canvas, x, floor)
    canvas.line(axle, _tip(axle, length, angle), 5, ORANGE)
    canvas.disc(axle, 3, BLACK)
    return canvas.image


def _draw_cart(canvas: Canvas, x: float, floor: float) -> None:
    rounding = _CART_HEIGHT / 2
    reach = _CART_WIDTH / 2 - rounding
    canvas.line((x - reach, floor - rounding), (x + reach, floor - rounding), rounding, BLUE)
    for side in (-1, 1):
        wheel = (x + side * reach, floor + _WHEEL - 1.0)
        canvas.disc(wheel, _WHEEL, BLACK)
        canvas.disc(wheel, 2, LIGHT_GREY)


def _tip(axle: Point, length: float, angle: float) -> Point:
    return axle[0] + length * math.sin(angle), axle[1] - length * math.cos(angle)
