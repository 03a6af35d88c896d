"""Finite environments as tables: the form in which compiled learners play them.

A finite environment has *cells* (the core state), actions, and for each pair up to K outcomes. It may also show
*distractors*: variables that say nothing, drawn anew and uniformly at every step and at reset. The raw observation is
then numbered ``state = cell · D + distractor`` with D joint distractor values, which keeps the tables D times
smaller.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from apel.numerics.compiled import njit
from apel.numerics.streams import Stream, integer, uniform


@dataclass(frozen=True)
class FiniteModel:
    """The tables of one finite environment: S cells, A actions, at most K outcomes, I start cells.

    Attributes
    ----------
    next_cell:
        ``int32[S, A, K]``.
    cumulative:
        ``float64[S, A, K]``: cumulative outcome probabilities; the last is 1.
    reward:
        ``float64[S, A, K]``.
    terminal:
        ``bool[S, A, K]``: the outcome ends the episode.
    start_cell, start_cumulative:
        ``int32[I]``, ``float64[I]``: the initial distribution.
    max_steps:
        Steps after which an episode is truncated.
    features:
        The names of the variables of an observation, distractors last.
    feature_sizes:
        How many values each of them takes; the product is the number of states.
    num_distractors:
        How many of the features, counted from the end, are distractors.
    info:
        What the environment says of itself, such as the optimal length.
    """

    next_cell: NDArray[np.int32]
    cumulative: NDArray[np.float64]
    reward: NDArray[np.float64]
    terminal: NDArray[np.bool_]
    start_cell: NDArray[np.int32]
    start_cumulative: NDArray[np.float64]
    max_steps: int
    features: tuple[str, ...]
    feature_sizes: tuple[int, ...]
    num_distractors: int = 0
    info: Mapping[str, float] = field(default_factory=dict)

    @property
    def shape(self) -> tuple[tuple[int, ...], tuple[int, ...], int, tuple[int, ...]]:
        """What the tables of runs that are played side by side have in common: the shapes of cells and starts, the step
        limit, and how many values each variable takes.
        """
        return self.next_cell.shape, self.start_cell.shape, self.max_steps, self.feature_sizes

    @property
    def num_actions(self) -> int:
        """A, the number of actions."""
        return int(self.next_cell.shape[1])

    @property
    def num_states(self) -> int:
        """How many different observations there are, distractors included."""
        return int(np.prod(self.feature_sizes))

    @property
    def state_type(self) -> type[np.uint16 | np.int32]:
        """In which state numbers stand in trajectories: in as few bytes as hold them."""
        return np.uint16 if self.num_states <= np.iinfo(np.uint16).max else np.int32

    @property
    def num_distractor_values(self) -> int:
        """D, the joint number of values of all distractors (1 without any)."""
        return self.num_states // int(self.next_cell.shape[0])

    def feature_values(self) -> NDArray[np.int64]:
        """``int64[states, features]``: the observation of each state."""
        return np.stack(np.unravel_index(np.arange(self.num_states), self.feature_sizes), axis=1)


class FiniteTables(NamedTuple):
    """The models of several runs, stacked for compiled code; M models, ``model[r]`` is the one of run r.

    Runs that share one model (every maze run has its own; FrozenLake's runs do not) share its tables.
    """

    next_cell: NDArray[np.int32]
    cumulative: NDArray[np.float64]
    reward_code: NDArray[Any]
    """Positions in ``reward_value``: the rewards of tables take few values, and trajectories travel as codes."""
    reward_value: NDArray[np.float64]
    terminal: NDArray[np.bool_]
    start_cell: NDArray[np.int32]
    start_cumulative: NDArray[np.float64]
    model: NDArray[np.int64]
    num_distractor_values: int
    max_steps: int


def observations_of(states: NDArray[Any], feature_sizes: tuple[int, ...]) -> NDArray[Any]:
    """``[…, features]``: the observations of states ``[…]``; the states themselves where there is only one feature."""
    return states if len(feature_sizes) == 1 else np.stack(np.unravel_index(states, feature_sizes), axis=-1)


def stack_models(models: Sequence[FiniteModel]) -> FiniteTables:
    """The tables of one model per run, of equal shapes; identical objects are stored once.

    Raises
    ------
    ValueError
        If the models differ in shape, features or step limit.
    """
    unique = list({id(model): model for model in models}.values())
    position = {id(model): i for i, model in enumerate(unique)}
    first = unique[0]
    for model in unique:
        if model.shape != first.shape:
            message = (
                f"found tables of the shapes {model.next_cell.shape} and {first.next_cell.shape}, the features "
                f"{model.feature_sizes} and {first.feature_sizes}, the limits {model.max_steps} and {first.max_steps}, "
                "expected those of environments that are played side by side to be the same"
            )
            raise ValueError(message)
    reward_value, codes = np.unique(np.stack([m.reward for m in unique]), return_inverse=True)
    return FiniteTables(
        next_cell=np.stack([m.next_cell for m in unique]),
        cumulative=np.stack([m.cumulative for m in unique]),
        reward_code=codes.reshape(len(unique), *first.reward.shape).astype(np.min_scalar_type(len(reward_value))),
        reward_value=reward_value,
        terminal=np.stack([m.terminal for m in unique]),
        start_cell=np.stack([m.start_cell for m in unique]),
        start_cumulative=np.stack([m.start_cumulative for m in unique]),
        model=np.array([position[id(m)] for m in models], dtype=np.int64),
        num_distractor_values=first.num_distractor_values,
        max_steps=first.max_steps,
    )


@njit(inline="always")
def draw_start(tables: FiniteTables, model: int, stream: Stream) -> tuple[Any, int]:
    """Draw the first cell and the first distractor value of an episode: ``(cell, distractor)``."""
    index = 0
    if tables.start_cell.shape[1] > 1:
        u = uniform(stream)
        while u >= tables.start_cumulative[model, index]:
            index += 1
    return np.int64(tables.start_cell[model, index]), draw_distractor(tables, stream)


@njit(inline="always")
def draw_outcome(tables: FiniteTables, model: int, cell: int, action: int, stream: Stream) -> int:
    """Draw which of the K outcomes of ``(cell, action)`` happens."""
    outcome = 0
    if tables.next_cell.shape[3] > 1:
        u = uniform(stream)
        while u >= tables.cumulative[model, cell, action, outcome]:
            outcome += 1
    return outcome


@njit(inline="always")
def draw_distractor(tables: FiniteTables, stream: Stream) -> int:
    """Draw the joint distractor value of the next observation."""
    if tables.num_distractor_values > 1:
        return integer(stream, tables.num_distractor_values)
    return 0
