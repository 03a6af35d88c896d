"""Games of MinAtar, on 10 × 10 cells: Breakout, a hundred times as fast as Atari's.

Source: Young & Tian 2019, *MinAtar: An Atari-Inspired Testbed for Thorough and Reproducible Reinforcement Learning
Experiments*; the package ``minatar`` (GPL-3), which is an extra of this project: ``pip install 'apel[minatar]'``.
"""

from __future__ import annotations

import sys
from importlib.util import find_spec, module_from_spec, spec_from_file_location
from pathlib import Path
from typing import Any, ClassVar

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from apel.environments.breakout.extras import missing
from apel.environments.breakout.handcrafted import handcrafted_space, minatar_paddle_hit, minatar_state
from apel.environments.misuse import NO_EPISODE, check_step

_EXTRA = _PACKAGE = "minatar"
_NOT_INSTALLED = "there is none"
_PIXELS_PER_CELL = 16
_BACKGROUND = (30, 30, 30)
Colours = dict[str, tuple[int, int, int]]


class MinAtarGame(gymnasium.Env[Any, Any]):
    """A game of MinAtar, one life per episode, with two views of it: what it shows, and a few numbers made of that.

    An episode follows from the seed of its reset and its actions. MinAtar's own class would also carry the last action
    over from the episode before, to which sticky actions may return, and starts unseeded.

    Parameters
    ----------
    game:
        The name of its module in ``minatar.environments``.
    handcrafted:
        The space of what `_handcrafted` makes of the game.
    sticky_action_prob:
        How probable it is, in each step, that the action before is played instead (nothing, in the first step).
    max_steps:
        Steps after which an episode is truncated; MinAtar has no limit.
    render_mode:
        ``"rgb_array"`` or None.

    Raises
    ------
    gymnasium.error.DependencyNotInstalled
        If there is no ``minatar``.
    ValueError
        If an argument makes no sense.
    """

    metadata: ClassVar[dict[str, Any]] = {"render_modes": ["rgb_array"], "render_fps": 10}  # type: ignore[misc]
    colours: ClassVar[Colours]
    """Of the game's channels; later ones cover earlier ones."""

    def __init__(
        self,
        game: str,
        handcrafted: spaces.Space[Any],
        sticky_action_prob: float = 0.1,
        max_steps: int = 5000,
        render_mode: str | None = None,
    ) -> None:
        _check(sticky_action_prob, max_steps, render_mode)
        self.sticky_action_prob = sticky_action_prob
        self.max_steps = max_steps
        self.render_mode = render_mode
        self._game = _game_module(game).Env()
        self._actions = self._game.minimal_action_set()
        symbols = spaces.Box(0, 1, (len(self._game.channels), 10, 10), np.uint8)
        self.observation_space = spaces.Dict(symbols=symbols, handcrafted=handcrafted)
        self.action_space = spaces.Discrete(len(self._actions))
        self._steps = NO_EPISODE
        self._last_action = 0

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, NDArray[Any]], dict[str, Any]]:
        """Start an episode; ``options`` are not used."""
        super().reset(seed=seed, options=options)
        # The game wants a RandomState; this one draws from the stream that Gymnasium has seeded.
        self._random = self._game.random = np.random.RandomState(self.np_random.bit_generator)
        self._game.reset()
        self._last_action = 0
        self._steps = 0
        return self._observation(), {}

    def step(self, action: Any) -> tuple[dict[str, NDArray[Any]], float, bool, bool, dict[str, Any]]:
        """Play one action.

        Raises
        ------
        RuntimeError
            If no episode is under way.
        ValueError
            If there is no such action.
        """
        check_step(action, self.action_space, self._steps)
        reward, terminated = self._game.act(self._actions[self._stick(int(action))])
        self._steps += 1
        truncated = not terminated and self._steps >= self.max_steps
        if terminated or truncated:
            self._steps = NO_EPISODE
        return self._observation(), float(reward), terminated, truncated, {}

    def _stick(self, action: int) -> int:
        """As `minatar.Environment.act`: a draw in every step, and what was played sticks, not what was asked for."""
        if self._random.rand() < self.sticky_action_prob:
            return self._last_action
        self._last_action = action
        return action

    def _handcrafted(self) -> NDArray[Any]:
        raise NotImplementedError

    def _observation(self) -> dict[str, NDArray[Any]]:
        symbols = np.ascontiguousarray(self._game.state().transpose(2, 0, 1)).view(np.uint8)
        return {"symbols": symbols, "handcrafted": self._handcrafted()}

    def render(self) -> Any:
        """The game as ``uint8[160, 160, 3]``."""
        if self.render_mode is None:
            return None
        state = self._game.state()
        image = np.full((*state.shape[:2], 3), _BACKGROUND, dtype=np.uint8)
        for name, colour in self.colours.items():
            image[state[:, :, self._game.channels[name]]] = colour
        return image.repeat(_PIXELS_PER_CELL, axis=0).repeat(_PIXELS_PER_CELL, axis=1)


class MinAtarBreakout(MinAtarGame):
    """Breakout. See `MinAtarGame` for the options and errors.

    Channels: ``symbols`` ``uint8[4, 10, 10]``, where paddle, ball, trail (the ball one step ago) and bricks are;
    ``handcrafted`` ``int64[3]`` (see `apel.environments.breakout.handcrafted`). Actions: 0 nothing, 1 left, 2 right.
    Reward: +1 per brick. Terminated where the paddle misses the ball. Signals: ``paddle_hit`` and ``life_lost``, 1.0
    for yes. In pictures bricks are orange, the ball is white, its trail grey, the paddle blue.
    """

    signals: tuple[str, ...] = ("paddle_hit", "life_lost")
    # The paddle lies over the trail of a ball that it missed.
    colours: ClassVar[Colours] = {
        "brick": (213, 94, 0),
        "trail": (90, 90, 90),
        "ball": (255, 255, 255),
        "paddle": (0, 114, 178),
    }

    def __init__(self, sticky_action_prob: float = 0.1, max_steps: int = 5000, render_mode: str | None = None) -> None:
        super().__init__("breakout", handcrafted_space(), sticky_action_prob, max_steps, render_mode)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, NDArray[Any]], dict[str, Any]]:
        """Start an episode; ``options`` are not used."""
        observation, _ = super().reset(seed=seed, options=options)
        return observation, {"paddle_hit": 0.0, "life_lost": 0.0}

    def step(self, action: Any) -> tuple[dict[str, NDArray[Any]], float, bool, bool, dict[str, Any]]:
        """See `MinAtarGame`."""
        direction = self._game.ball_dir
        observation, reward, terminated, truncated, _ = super().step(action)
        hit = minatar_paddle_hit(direction, self._game.ball_dir, self._game.ball_y)
        return observation, reward, terminated, truncated, {"paddle_hit": float(hit), "life_lost": float(terminated)}

    def _handcrafted(self) -> NDArray[Any]:
        game = self._game
        return minatar_state(game.ball_x, game.ball_y, game.ball_dir, game.pos)


def _check(sticky_action_prob: float, max_steps: int, render_mode: str | None) -> None:
    if not isinstance(sticky_action_prob, int | float) or not 0 <= sticky_action_prob <= 1:
        message = f"sticky_action_prob: found {sticky_action_prob!r}, expected a number from 0 to 1"
        raise ValueError(message)
    if not isinstance(max_steps, int) or max_steps < 1:
        message = f"max_steps: found {max_steps!r}, expected a whole number of at least 1"
        raise ValueError(message)
    if render_mode not in (None, "rgb_array"):
        message = f"render_mode: found {render_mode!r}, expected None or 'rgb_array'"
        raise ValueError(message)


def _game_module(game: str) -> Any:
    """The module of a game, without the package around it, which imports Matplotlib and Seaborn (seconds).

    It is entered under its real name, so that whoever imports the package as usual gets the same module, and games can
    be pickled.
    """
    name = f"minatar.environments.{game}"
    if name in sys.modules:
        return sys.modules[name]
    package = find_spec(_PACKAGE)
    if package is None or not package.submodule_search_locations:
        raise missing(_PACKAGE, _EXTRA, _NOT_INSTALLED)
    path = Path(package.submodule_search_locations[0], "environments", f"{game}.py")
    spec = spec_from_file_location(name, path)
    if spec is None or spec.loader is None or not path.exists():
        raise missing(name, _EXTRA, f"no {path}")
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    sys.modules[name] = module
    return module
