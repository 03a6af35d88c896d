"""What a checkpoint holds of an algorithm of stable-baselines3 and of its replay buffer."""

from __future__ import annotations

from typing import Any

import numpy as np

from apel.learners.base import State
from apel.learners.stable_baselines.torch_trees import arrays_of, state_dict_of, tensors_of

_OF_PARTS = ("observations", "next_observations")
"""Columns of a replay buffer that are dictionaries where observations have parts."""


def numbers_of(owner: Any) -> State:
    """The attributes that are numbers or texts."""
    return {name: value for name, value in vars(owner).items() if isinstance(value, bool | int | float | str)}


def variables_of(algorithm: Any) -> dict[str, Any]:
    """The tensors that the algorithm declares beside its modules and optimisers."""
    from stable_baselines3.common.save_util import recursive_getattr

    _, names = algorithm._get_torch_save_params()
    tensors = {name: recursive_getattr(algorithm, name) for name in names}
    return {name: tensor for name, tensor in tensors.items() if tensor is not None}


def filled(replay: Any) -> State:
    """Copies of the arrays of a replay buffer, without the rows that were never written."""
    # One row more than there are steps: with optimize_memory_usage it holds the last next observation.
    rows = min(replay.size() + 1, replay.buffer_size)
    return {
        name: _first(value, rows, replay.buffer_size)
        for name, value in vars(replay).items()
        if isinstance(value, np.ndarray) or (isinstance(value, dict) and name in _OF_PARTS)
    }


def _first(column: Any, rows: int, room: int) -> Any:
    if isinstance(column, dict):
        return {part: _first(array, rows, room) for part, array in column.items()}
    return (column[:rows] if len(column) == room else column).copy()


def refill(column: Any, stored: Any) -> None:
    """Write what `filled` gave into a column."""
    if isinstance(column, dict):
        for part, array in column.items():
            refill(array, stored[part])
    else:
        column[: len(stored)] = stored


def algorithm_state(algorithm: Any) -> State:
    """Networks, optimisers, the filled part of the replay buffer, counters, noise and the stream of random actions.

    Of an off-policy algorithm and of its replay buffer: what SB3 itself would save as tensors, and all attributes that
    are numbers, texts or (of the buffer) arrays.
    """
    return {
        "numbers": numbers_of(algorithm),
        "modules": arrays_of(algorithm.get_parameters()),
        "variables": arrays_of(variables_of(algorithm)),
        "replay_numbers": numbers_of(algorithm.replay_buffer),
        "replay_arrays": filled(algorithm.replay_buffer),
        "noise": arrays_of(getattr(algorithm.action_noise, "noise_prev", None)),
        "random_actions": algorithm.action_space.np_random.bit_generator.state,
    }


def restore_algorithm(algorithm: Any, state: State) -> None:
    """Go back to what `algorithm_state` returned."""
    vars(algorithm).update(state["numbers"])
    algorithm.set_parameters({name: state_dict_of(stored) for name, stored in state["modules"].items()})
    for name, tensor in variables_of(algorithm).items():
        tensor.data = tensors_of(state["variables"][name]).to(tensor.device)
    replay = vars(algorithm.replay_buffer)
    replay.update(state["replay_numbers"])
    for name, stored in state["replay_arrays"].items():
        refill(replay[name], stored)
    if hasattr(algorithm.action_noise, "noise_prev"):
        algorithm.action_noise.noise_prev = np.array(state["noise"])
    algorithm.action_space.np_random.bit_generator.state = state["random_actions"]
