"""Breakout of the Atari 2600, preprocessed as in OpenAI Baselines (§4.2).

Needs ``ale_py``, which brings the game, and ``cv2``: ``pip install 'apel[atari]'``.

Sources: Mnih et al. 2015, *Human-level control through deep reinforcement learning*, Nature 518; OpenAI Baselines,
``common/atari_wrappers.py`` (commit ea25b9e8).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar, NamedTuple

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.wrappers import AtariPreprocessing
from numpy.typing import NDArray

from apel.environments.breakout.extras import import_extra
from apel.environments.breakout.handcrafted import atari_paddle_hit, atari_state, handcrafted_space
from apel.environments.misuse import NO_EPISODE, check_step

_EXTRA = "atari"
_FIRE, _RIGHT = 1, 2
_LAUNCH = (_FIRE, _RIGHT)
"""Baselines' `FireResetEnv` presses the third button too, which other games need to start."""

_MAX_FRAME_SKIP = 16
"""Frames per step up to which no ball gets lost during a launch, or from the paddle to the upper half in a step."""


class _Press(NamedTuple):
    """What an agent step, or a button pressed for the player, led to."""

    frame: NDArray[np.uint8]
    ram: NDArray[np.uint8]
    reward: float
    terminated: bool
    paddle_hit: bool


class AtariBreakout(gymnasium.Env[Any, Any]):
    """The game of five lives, with three views of it.

    Channels: ``frame`` ``uint8[84, 84]``, the screen in grey, not stacked; ``ram`` ``uint8[128]``; ``handcrafted``
    ``int64[3]`` (see `apel.environments.breakout.handcrafted`). Actions: 0 nothing, 1 fire, 2 right, 3 left. Reward:
    the game's points. Terminated where the last life is lost. Signals: ``clipped``, the sign of the reward;
    ``paddle_hit`` and ``life_lost``, 1.0 for yes.

    A lost life is signalled and the game goes on, as with Baselines' `EpisodicLifeEnv`, for which a life is an
    episode. (With Gymnasium's ``terminal_on_life_loss`` a reset restarts the whole game, so that nothing is ever learnt
    about what comes after the first life.)

    The ball is launched for the player, as by Baselines' `FireResetEnv`: after a reset, and in the very step in which a
    life is lost, ``FIRE`` and ``RIGHT`` are pressed for ``frame_skip`` frames each. The observation of that step is the
    one after the launch, and its reward includes the launch. (Baselines' `EpisodicLifeEnv` does nothing for another
    ``frame_skip`` frames first.)

    Frames are those of Gymnasium's `AtariPreprocessing`, which makes each of the two frames grey before it takes their
    maximum, where Baselines does so after, and with the emulator's palette, where Baselines uses OpenCV. In this game
    none of the 85 million pixels of 12 000 steps differed.

    Parameters
    ----------
    noop_max:
        At the start nothing is done for 1 to ``noop_max`` frames, drawn uniformly; this is all that is random. 0 for
        none.
    frame_skip:
        Frames for which an action is held; the last two of them make an observation.
    max_steps:
        Steps after which a game is truncated, among which each button of a launch counts as one: 27 000 steps of four
        frames are the usual 108 000 frames, or half an hour.
    render_mode:
        ``"rgb_array"`` or None.

    Raises
    ------
    gymnasium.error.DependencyNotInstalled
        If there is no ``ale_py`` or no ``cv2``.
    ValueError
        If an argument makes no sense.
    """

    metadata: ClassVar[dict[str, Any]] = {"render_modes": ["rgb_array"], "render_fps": 15}  # type: ignore[misc]
    signals: tuple[str, ...] = ("clipped", "paddle_hit", "life_lost")

    def __init__(
        self, noop_max: int = 30, frame_skip: int = 4, max_steps: int = 27_000, render_mode: str | None = None
    ) -> None:
        _check(noop_max, frame_skip, max_steps, render_mode)
        self.max_steps = max_steps
        self.render_mode = render_mode
        self._game = AtariPreprocessing(_breakout(), noop_max=noop_max, frame_skip=frame_skip)
        self._emulator: Any = self._game.ale
        self.observation_space = spaces.Dict(
            frame=self._game.observation_space,
            ram=spaces.Box(0, 255, (128,), np.uint8),
            handcrafted=handcrafted_space(),
        )
        self.action_space = spaces.Discrete(4)
        self._steps = NO_EPISODE

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, NDArray[Any]], dict[str, Any]]:
        """Start a game and launch the ball; ``options`` are not used."""
        super().reset(seed=seed, options=options)
        # What is random, Gymnasium draws from here. A seed of its own would make the emulator load the game anew, which
        # takes as long as a hundred steps, for the sake of sticky actions that are never drawn.
        self._game.unwrapped.np_random = self.np_random
        self._game.reset()
        self._ram = self._emulator.getRAM()
        self._steps = 0
        return _observation(self._play(_LAUNCH)[-1]), dict.fromkeys(self.signals, 0.0)

    def step(self, action: Any) -> tuple[dict[str, NDArray[Any]], float, bool, bool, dict[str, Any]]:
        """Play one action, and launch a ball where the last one is lost.

        Raises
        ------
        RuntimeError
            If no episode is under way.
        ValueError
            If there is no such action.
        """
        check_step(action, self.action_space, self._steps)
        lives = self._emulator.lives()
        presses = self._play([int(action)])
        life_lost = self._emulator.lives() < lives
        if life_lost and not presses[-1].terminated:
            presses += self._play(_LAUNCH)
        reward = sum(press.reward for press in presses)
        terminated = presses[-1].terminated
        truncated = not terminated and self._steps >= self.max_steps
        if terminated or truncated:
            self._steps = NO_EPISODE
        info = {
            "clipped": float(np.sign(reward)),
            "paddle_hit": float(any(press.paddle_hit for press in presses)),
            "life_lost": float(life_lost),
        }
        return _observation(presses[-1]), reward, terminated, truncated, info

    def _play(self, actions: Sequence[int]) -> list[_Press]:
        """Press these buttons, as far as the game goes on; no game ends before the first one."""
        presses: list[_Press] = []
        for action in actions:
            if self._steps >= self.max_steps or (presses and presses[-1].terminated):
                break
            presses.append(self._press(action))
        return presses

    def _press(self, action: int) -> _Press:
        frame, reward, terminated, _, _ = self._game.step(action)
        before, self._ram = self._ram, self._emulator.getRAM()
        self._steps += 1
        return _Press(frame, self._ram, float(reward), terminated, atari_paddle_hit(before, self._ram))

    def render(self) -> Any:
        """The screen, ``uint8[210, 160, 3]``."""
        return None if self.render_mode is None else self._emulator.getScreenRGB()


def _observation(press: _Press) -> dict[str, NDArray[Any]]:
    return {"frame": press.frame, "ram": press.ram, "handcrafted": atari_state(press.ram)}


def _breakout() -> gymnasium.Env[Any, Any]:
    """``BreakoutNoFrameskip-v4``, whose own screens are cheap: the preprocessing fetches those that it needs."""
    ale_py = import_extra("ale_py", _EXTRA)
    import_extra("cv2", _EXTRA)
    # Or each process prints a banner.
    ale_py.ALEInterface.setLoggerMode(ale_py.LoggerMode.Error)
    breakout: gymnasium.Env[Any, Any] = ale_py.AtariEnv(
        "breakout", obs_type="grayscale", frameskip=1, repeat_action_probability=0.0, full_action_space=False
    )
    return breakout


def _check(noop_max: int, frame_skip: int, max_steps: int, render_mode: str | None) -> None:
    if not isinstance(noop_max, int) or noop_max < 0:
        message = f"noop_max: found {noop_max!r}, expected a whole number of frames of at least 0"
        raise ValueError(message)
    if not isinstance(frame_skip, int) or not 1 <= frame_skip <= _MAX_FRAME_SKIP:
        message = f"frame_skip: found {frame_skip!r}, expected a whole number of frames from 1 to {_MAX_FRAME_SKIP}"
        raise ValueError(message)
    if not isinstance(max_steps, int) or max_steps <= len(_LAUNCH):
        message = f"max_steps: found {max_steps!r}, expected a whole number above {len(_LAUNCH)}, the steps of a launch"
        raise ValueError(message)
    if render_mode not in (None, "rgb_array"):
        message = f"render_mode: found {render_mode!r}, expected None or 'rgb_array'"
        raise ValueError(message)
