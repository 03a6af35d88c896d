"""Environments as compiled code plays them, one episode of one run at a time: what a learner whose loop is compiled
asks for, step after step, without leaving it.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np
from numba.extending import overload
from numpy.typing import NDArray

from apel.dynamics.finite_model import FiniteTables, draw_distractor, draw_outcome, draw_start
from apel.numerics.compiled import njit


class CartPoleWorld(NamedTuple):
    """The cart pole of one run; names as in Gymnasium, SI units."""

    gravity: float
    masspole: float
    total_mass: float
    length: float
    polemass_length: float
    force_mag: float
    tau: float
    x_threshold: float
    theta_threshold_radians: float
    max_steps: int
    limit_terminates: bool
    state: NDArray[np.float64]
    """``float64[4]``: position, velocity, angle, angular velocity."""


class FiniteWorld(NamedTuple):
    """A finite environment of one run."""

    tables: FiniteTables
    model: int
    max_steps: int
    cell: NDArray[np.int64]
    """``int64[1]``."""
    stream: NDArray[np.uint64]
    """``uint64[2]``: of the episode."""

    @property
    def num_states(self) -> int:
        """How many entries there are."""
        return int(self.tables.next_cell.shape[1]) * self.tables.num_distractor_values


@runtime_checkable
class HasWorlds(Protocol):
    """Batched environments that compiled code may play in their stead."""

    def world(self, run: int) -> Any:
        """That of a run; None where it would not be the same, bit for bit."""
        ...

    def start(self, seed: int) -> NDArray[Any]:
        """What `begin` needs of an episode's seed."""
        ...


def begin(world: Any, start: Any, entries: Any) -> None:
    """Begin an episode; its first entry is written to ``entries[0]``."""
    _begin_cart_pole(world, start, entries) if isinstance(world, CartPoleWorld) else _begin_finite(
        world, start, entries
    )


def advance(world: Any, action: int, step: int, entries: Any) -> tuple[float, bool, bool]:
    """Take ``step``, counted from 1, whose entry is written to ``entries[step]``: its reward, and whether the episode
    was terminated or truncated.
    """
    play = _advance_cart_pole if isinstance(world, CartPoleWorld) else _advance_finite
    return play(world, action, step, entries)


@overload(begin, strict=False)
def _begin(world: Any, start: Any, entries: Any) -> Any:
    return _of_kind(world, _begin_cart_pole, _begin_finite)


@overload(advance, strict=False)
def _advance(world: Any, action: Any, step: Any, entries: Any) -> Any:
    return _of_kind(world, _advance_cart_pole, _advance_finite)


def _of_kind(world: Any, cart_pole: Any, finite: Any) -> Any:
    kind: Any = getattr(world, "instance_class", None)
    return {CartPoleWorld: cart_pole.py_func, FiniteWorld: finite.py_func}.get(kind)


@njit
def _begin_cart_pole(world: CartPoleWorld, start: Any, entries: Any) -> None:
    for i in range(4):
        world.state[i] = start[i]
        entries[0, i] = start[i]


@njit
def _advance_cart_pole(world: CartPoleWorld, action: int, step: int, entries: Any) -> tuple[float, bool, bool]:
    """One Euler step: the operations of `CartPoleEnv.step`, in its order, for any other order rounds differently."""
    state = world.state
    x, x_dot, theta, theta_dot = state[0], state[1], state[2], state[3]
    force = world.force_mag if action == 1 else -world.force_mag
    cosine, sine = math.cos(theta), math.sin(theta)
    temp = (force + world.polemass_length * (theta_dot * theta_dot) * sine) / world.total_mass
    theta_acceleration = (world.gravity * sine - cosine * temp) / (
        world.length * (4.0 / 3.0 - world.masspole * (cosine * cosine) / world.total_mass)
    )
    x_acceleration = temp - world.polemass_length * theta_acceleration * cosine / world.total_mass
    state[0], state[1] = x + world.tau * x_dot, x_dot + world.tau * x_acceleration
    state[2], state[3] = theta + world.tau * theta_dot, theta_dot + world.tau * theta_acceleration
    for i in range(4):
        entries[step, i] = state[i]
    failed = abs(state[0]) > world.x_threshold or abs(state[2]) > world.theta_threshold_radians
    at_limit = not failed and step >= world.max_steps
    return 1.0, failed or (at_limit and world.limit_terminates), at_limit and not world.limit_terminates


@njit
def trigonometry(angles: NDArray[np.float64]) -> NDArray[np.float64]:
    """Sines and cosines as compiled code has them, ``float64[2, N]``."""
    found = np.empty((2, angles.shape[0]))
    for i in range(angles.shape[0]):
        found[0, i], found[1, i] = math.sin(angles[i]), math.cos(angles[i])
    return found


@njit
def _begin_finite(world: FiniteWorld, start: Any, entries: Any) -> None:
    world.stream[:] = start
    cell, distractor = draw_start(world.tables, world.model, world.stream)
    world.cell[0] = cell
    entries[0] = cell * world.tables.num_distractor_values + distractor


@njit
def _advance_finite(world: FiniteWorld, action: int, step: int, entries: Any) -> tuple[float, bool, bool]:
    tables, model, cell = world.tables, world.model, world.cell[0]
    outcome = draw_outcome(tables, model, cell, action, world.stream)
    following = np.int64(tables.next_cell[model, cell, action, outcome])
    world.cell[0] = following
    entries[step] = following * tables.num_distractor_values + draw_distractor(tables, world.stream)
    terminated = tables.terminal[model, cell, action, outcome]
    reward = tables.reward_value[tables.reward_code[model, cell, action, outcome]]
    return reward, terminated, not terminated and step >= world.max_steps
