"""MinAtar's Space Invaders, a held-out task: a quick learner sees a few numbers, a late one all there is.

Source: Young & Tian 2019, see `apel.environments.breakout.minatar`.
"""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from apel.environments.breakout.minatar import Colours, MinAtarGame

_NEAR, _BESIDE = 3, 2
"""Rows in which a bullet above the cannon is near, and one beside it."""


class SpaceInvaders(MinAtarGame):
    """The cannon at the bottom shoots at aliens, who shoot back. See `MinAtarGame` for the options and errors.

    Channels: ``symbols`` ``uint8[6, 10, 10]``; ``handcrafted`` ``int64[5]``, 72 states: whether the nearest alien is
    to the left, above, or to the right; whether a bullet comes down on the cannon, near or far or not at all; whether
    one comes down to its left, and to its right; whether it can shoot. Actions: 0 nothing, 1 left, 2 right, 3 shoot.
    Reward: +1 per alien. Terminated where an alien or a bullet hits the cannon.
    """

    signals: tuple[str, ...] = ()
    colours: ClassVar[Colours] = {
        "alien": (213, 94, 0), "enemy_bullet": (240, 228, 66), "friendly_bullet": (255, 255, 255),
        "cannon": (0, 114, 178),
    }  # fmt: skip

    def __init__(self, sticky_action_prob: float = 0.1, max_steps: int = 5000, render_mode: str | None = None) -> None:
        space = spaces.MultiDiscrete([3, 3, 2, 2, 2])
        super().__init__("space_invaders", space, sticky_action_prob, max_steps, render_mode)

    def _handcrafted(self) -> NDArray[np.int64]:
        game = self._game
        aliens = np.flatnonzero(game.alien_map.any(axis=0)) - game.pos
        side = np.sign(aliens[np.argmin(np.abs(aliens))]) + 1 if len(aliens) else 1
        above = np.flatnonzero(game.e_bullet_map[:, game.pos])
        threat = 0 if not len(above) else 2 if above[-1] >= 9 - _NEAR else 1
        beside = [self._falls(game.pos - 1), self._falls(game.pos + 1)]
        return np.array([side, threat, *beside, game.shot_timer == 0], dtype=np.int64)

    def _falls(self, column: int) -> bool:
        return bool(0 <= column <= 9 and self._game.e_bullet_map[9 - _BESIDE :, column].any())
