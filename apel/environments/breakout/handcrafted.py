"""The handcrafted state of Breakout (§4.2.3), and the paddle hits that its learner is rewarded for.

A state has three parts, 5 × 4 × 2 = 40 states in all: where the ball is relative to the paddle (0 left, 1 above its
left part, 2 above its middle, 3 above its right part, 4 right), where it flies (MinAtar's numbers: 0 up-left,
1 up-right, 2 down-right, 3 down-left), and the half of the screen that it is in (0 upper, 1 lower).

Source: the RAM cells of the Atari game are those of AtariARI (Anand et al. 2019, *Unsupervised State Representation
Learning in Atari*, ``ram_annotations.py``), velocities and offsets were measured; `tests.apel.environments.breakout`
compares all of them with the pixels.
"""

from __future__ import annotations

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

LEFT, ABOVE_LEFT, ABOVE, ABOVE_RIGHT, RIGHT = range(5)
UP_LEFT, UP_RIGHT, DOWN_RIGHT, DOWN_LEFT = range(4)
UPPER, LOWER = range(2)

# RAM cells. The ball's left edge is at pixel column ram[99] - 49 and its top edge at row ram[101] + 9; 0 in cell 101
# means that there is no ball. The paddle's left edge is at column ram[72] - 47. Velocities are signed bytes.
BALL_X, BALL_Y, PADDLE_X, DOWNWARD_VELOCITY, LEFTWARD_VELOCITY = 99, 101, 72, 103, 105
_NEGATIVE = 128
"""From here on a byte stands for a negative number."""

_CENTRES = 9
"""ram[99] - ram[72] where the centres of ball and paddle (2 and 16 pixels wide) are one above the other."""

_ATARI_MIDDLE, _ATARI_REACH = 3, 8
"""Pixels between these centres up to which the ball is above the middle, and above the paddle at all."""

_ATARI_MIDLINE = 101
"""ram[101] of a ball in the middle between its highest position, 23, and the paddle's, about 180."""

_MINATAR_MIDDLE, _MINATAR_REACH = 0, 1
"""The same in cells; the paddle has one, and reaches a ball that comes from a neighbouring column."""

_MINATAR_MIDLINE = 5
_MINATAR_ABOVE_PADDLE = 8


def handcrafted_space() -> spaces.MultiDiscrete:
    """All states."""
    return spaces.MultiDiscrete([5, 4, 2])


def relative_position(offset: int, middle: int, reach: int) -> int:
    """Where a ball is that is ``offset`` right of the paddle's centre."""
    if abs(offset) <= middle:
        return ABOVE
    if abs(offset) <= reach:
        return ABOVE_LEFT if offset < 0 else ABOVE_RIGHT
    return LEFT if offset < 0 else RIGHT


def atari_state(ram: NDArray[np.uint8]) -> NDArray[np.int64]:
    """The state ``int64[3]`` that the ``uint8[128]`` of the Atari 2600 stand for.

    Without a ball it is (above, down-left, upper), as for one that is launched. The environment launches a ball as soon
    as one is lost, so that nobody sees this but at the very end.

    The direction is read from the velocities. Differences of positions between agent steps, four frames apart, would
    be late: where the ball turns between two of them it may well end up below where it was, yet fly up (47 of 87
    paddle hits were seen in the right step). Differences between frames agree with the velocities but for the frame of
    a paddle hit, in which the paddle may push the ball aside. A ball that flies steeply to the left has 0 for its
    velocity, for it moves by less than a pixel per frame; so has one that is lost.
    """
    y = int(ram[BALL_Y])
    if y == 0:
        return np.array((ABOVE, DOWN_LEFT, UPPER), dtype=np.int64)
    position = relative_position(int(ram[BALL_X]) - int(ram[PADDLE_X]) - _CENTRES, _ATARI_MIDDLE, _ATARI_REACH)
    return np.array((position, _atari_direction(ram), LOWER if y >= _ATARI_MIDLINE else UPPER), dtype=np.int64)


def _atari_direction(ram: NDArray[np.uint8]) -> int:
    is_right = ram[LEFTWARD_VELOCITY] >= _NEGATIVE
    if ram[DOWNWARD_VELOCITY] >= _NEGATIVE:
        return UP_RIGHT if is_right else UP_LEFT
    return DOWN_RIGHT if is_right else DOWN_LEFT


def atari_paddle_hit(before: NDArray[np.uint8], after: NDArray[np.uint8]) -> bool:
    """Whether the paddle hit the ball between two agent steps, of which the RAM ``uint8[128]`` is given.

    The ball fell before and rises after. Where that is in the lower half there is nothing else to turn it: bricks turn
    falling balls too, but above.
    """
    fell = before[BALL_Y] > 0 and before[DOWNWARD_VELOCITY] < _NEGATIVE
    return bool(fell and after[BALL_Y] >= _ATARI_MIDLINE and after[DOWNWARD_VELOCITY] >= _NEGATIVE)


def minatar_state(ball_x: int, ball_y: int, ball_direction: int, paddle_x: int) -> NDArray[np.int64]:
    """The state ``int64[3]`` of a MinAtar game, in cells of its 10 × 10 (row 0 is the top)."""
    position = relative_position(ball_x - paddle_x, _MINATAR_MIDDLE, _MINATAR_REACH)
    return np.array((position, ball_direction, LOWER if ball_y >= _MINATAR_MIDLINE else UPPER), dtype=np.int64)


def minatar_paddle_hit(direction_before: int, direction: int, ball_y: int) -> bool:
    """Whether the paddle hit the ball in a step of MinAtar.

    It does so in row 9, and the game puts the ball back to row 8; bricks turn falling balls too, but in row 2 or above.
    """
    return direction_before in (DOWN_RIGHT, DOWN_LEFT) and direction <= UP_RIGHT and ball_y == _MINATAR_ABOVE_PADDLE
