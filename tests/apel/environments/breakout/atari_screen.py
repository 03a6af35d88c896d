"""Breakout played by hand: the emulator, Baselines' preprocessing as it stands there, and a reader of the pixels."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, NamedTuple

import ale_py
import cv2
import numpy as np
from gymnasium.utils.seeding import np_random
from numpy.typing import NDArray

NOOP, FIRE, RIGHT, LEFT = range(4)
BUTTONS = (ale_py.Action.NOOP, ale_py.Action.FIRE, ale_py.Action.RIGHT, ale_py.Action.LEFT)
FIRST_COLUMN, END_COLUMN = 8, 152  # between the walls
RED = 200  # the red part of the colour of ball, paddle and the bricks of the uppermost row, and of nothing else
PADDLE_TOP, PADDLE_END = 189, 193


class Raw(NamedTuple):
    """One of the emulator's frames: what it looks like, and what the RAM says."""

    ball: tuple[int, int] | None  # column of the left edge, row of the top edge
    ball_row: int | None  # the latter, below the bricks and as long as it is above the paddle's upper edge
    paddle: int | None  # column of the left edge
    ram: NDArray[np.uint8]


class HandPlayed:
    """A game on the bare emulator, with the pixels read in every frame."""

    def __init__(self, frame_skip: int = 4, noop_max: int = 30) -> None:
        ale_py.ALEInterface.setLoggerMode(ale_py.LoggerMode.Error)
        self.ale = ale_py.ALEInterface()
        self.ale.setFloat("repeat_action_probability", 0.0)
        self.ale.setInt("frame_skip", 1)
        rom = ale_py.roms.get_rom_path("breakout")
        assert rom is not None
        self.ale.loadROM(rom)
        self.frame_skip, self.noop_max = frame_skip, noop_max
        self.raw: list[Raw] = []
        self.frame = np.zeros((84, 84), dtype=np.uint8)

    def reset(self, seed: int) -> None:
        self.ale.reset_game()
        self.raw = []
        for _ in range(int(np_random(seed)[0].integers(1, self.noop_max + 1))):
            self.ale.act(ale_py.Action.NOOP)
        self._hold([FIRE, RIGHT])

    def step(self, action: int) -> tuple[float, bool]:
        """The points of an agent step, and whether a life was lost; then the ball is launched again."""
        self.raw = []
        lives = self.ale.lives()
        reward = self._hold([action])
        lost = self.ale.lives() < lives
        if lost and not self.ale.game_over():
            reward += self._hold([FIRE, RIGHT])
        return reward, lost

    def _hold(self, actions: Iterable[int]) -> float:
        reward = 0.0
        for action in actions:
            screens: list[NDArray[np.uint8]] = []
            for _ in range(self.frame_skip):
                reward += self.ale.act(BUTTONS[action])
                screens.append(self.ale.getScreenRGB())
                self.raw.append(read(screens[-1], self.ale.getRAM()))
                if self.ale.game_over():
                    break
            self.frame = warped(screens)
        return reward


def warped(screens: list[NDArray[np.uint8]]) -> NDArray[np.uint8]:
    """Baselines' MaxAndSkipEnv and WarpFrame, with the last two screens of a step."""
    grey = cv2.cvtColor(np.max(screens[-2:], axis=0), cv2.COLOR_RGB2GRAY)
    return np.asarray(cv2.resize(grey, (84, 84), interpolation=cv2.INTER_AREA))


def read(screen: NDArray[np.uint8], ram: NDArray[np.uint8]) -> Raw:
    red = screen[:, FIRST_COLUMN:END_COLUMN, 0] == RED
    return Raw(_ball(red), _ball_row(red), _paddle(red), ram)


def _ball(red: NDArray[np.bool_]) -> tuple[int, int] | None:
    """A red block of 2 × 4 pixels, above the red bricks or between them and the paddle."""
    for first, end in ((32, 57), (63, PADDLE_TOP)):
        rows, columns = np.nonzero(red[first:end])
        if len(rows) == 8 and np.ptp(rows) == 3 and np.ptp(columns) == 1:
            return int(columns.min()) + FIRST_COLUMN, int(rows.min()) + first
    return None


def _ball_row(red: NDArray[np.bool_]) -> int | None:
    """Between the bricks and the paddle there is nothing else that is red."""
    rows = np.flatnonzero(red[93:PADDLE_TOP].any(axis=1)) + 93
    return int(rows[0]) if len(rows) else None


def _paddle(red: NDArray[np.bool_]) -> int | None:
    columns = np.flatnonzero(red[PADDLE_TOP:PADDLE_END].all(axis=0))
    return int(columns[0]) + FIRST_COLUMN if len(columns) == 16 and np.ptp(columns) == 15 else None


def lapsing_player(seed: int) -> Any:
    """Follows the ball by RAM, with its paddle's aim and its attention changing now and then."""
    rng = np.random.default_rng(seed)
    aim, asleep = 0, False

    def act(ram: NDArray[np.uint8]) -> int:
        nonlocal aim, asleep
        if rng.random() < 0.05:
            aim, asleep = int(rng.integers(-7, 8)), bool(rng.random() < 0.18)
        if asleep:
            return int(rng.integers(4))
        offset = int(ram[99]) - int(ram[72]) - 9 + aim
        return RIGHT if offset > 2 else LEFT if offset < -2 else NOOP

    return act
