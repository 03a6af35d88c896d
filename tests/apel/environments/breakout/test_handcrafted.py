from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from numpy.typing import NDArray

from apel.environments.breakout.handcrafted import (
    atari_paddle_hit,
    atari_state,
    minatar_paddle_hit,
    minatar_state,
    relative_position,
)

UP, DOWN = 254, 2


def ram(x: int, y: int, paddle: int, downward: int = DOWN, leftward: int = 1) -> NDArray[np.uint8]:
    """The cells that matter of an Atari 2600."""
    cells = np.zeros(128, dtype=np.uint8)
    cells[[99, 101, 72, 103, 105]] = x, y, paddle, downward, leftward
    return cells


@pytest.mark.parametrize(
    ("offset", "position"), [(-99, 0), (-9, 0), (-8, 1), (-4, 1), (-3, 2), (0, 2), (3, 2), (4, 3), (8, 3), (9, 4)]
)
def test_five_positions(offset: int, position: int) -> None:
    """Left, above left, above, above right, right; both bounds belong to what is nearer."""
    assert relative_position(offset, middle=3, reach=8) == position
    state = atari_state(ram(x=109 + offset, y=50, paddle=100))
    assert state[0] == position
    assert state.dtype == np.int64
    assert state.shape == (3,)


@pytest.mark.parametrize(
    ("downward", "leftward", "direction"),
    [(254, 1, 0), (252, 255, 1), (1, 254, 2), (3, 2, 3), (255, 0, 0), (1, 0, 3), (1, 255, 2)],
)
def test_atari_directions(downward: int, leftward: int, direction: int) -> None:
    """Signed velocities, the horizontal one positive to the left; 0 is a steep one to the left."""
    assert atari_state(ram(100, 100, 100, downward, leftward))[1] == direction


@pytest.mark.parametrize(("y", "half"), [(23, 0), (100, 0), (101, 1), (207, 1)])
def test_atari_halves(y: int, half: int) -> None:
    """The lower half begins at 101."""
    assert atari_state(ram(100, y, 100))[2] == half


def test_atari_without_a_ball() -> None:
    """One state, wherever the paddle is."""
    assert {tuple(atari_state(ram(x, 0, paddle, 0, 0))) for x, paddle in [(0, 55), (0, 191), (200, 60)]} == {(2, 3, 0)}


@pytest.mark.parametrize(
    ("y_before", "before", "y", "after", "hit"),
    [
        (179, DOWN, 175, UP, True),
        (179, DOWN, 180, UP, True),  # lower than before, but on its way up
        (179, DOWN, 187, DOWN, False),
        (179, UP, 171, UP, False),
        (52, DOWN, 47, UP, False),  # from the top of a brick
        (0, DOWN, 180, UP, False),  # there was none
        (205, DOWN, 0, UP, False),  # there is none
    ],
)
def test_atari_paddle_hits(y_before: int, before: int, y: int, after: int, hit: bool) -> None:
    """A ball that fell rises in the lower half."""
    assert atari_paddle_hit(ram(99, y_before, 90, before), ram(99, y, 90, after)) is hit


@pytest.mark.parametrize(
    ("ball_x", "ball_y", "direction", "paddle_x", "state"),
    [
        (0, 3, 2, 4, (0, 2, 0)),
        (3, 4, 3, 4, (1, 3, 0)),
        (4, 5, 0, 4, (2, 0, 1)),
        (5, 8, 1, 4, (3, 1, 1)),
        (9, 9, 2, 7, (4, 2, 1)),
    ],
)
def test_minatar_states(ball_x: int, ball_y: int, direction: int, paddle_x: int, state: tuple[int, int, int]) -> None:
    """Neighbouring columns are above the paddle's left and right part; rows 5 to 9 are the lower half."""
    assert tuple(minatar_state(ball_x, ball_y, direction, paddle_x)) == state


def test_minatar_paddle_hits() -> None:
    """From one of both falling directions to one of both rising ones, in row 8: not from a brick below the ball."""
    for before, after, ball_y in product(range(4), range(4), range(10)):
        assert minatar_paddle_hit(before, after, ball_y) is (before >= 2 and after < 2 and ball_y == 8)
