"""What a checkpoint holds of an algorithm of stable-baselines3 and of its replay buffer."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from apel.learners.base import State
from apel.learners.stable_baselines.parts import constructor_options
from apel.learners.stable_baselines.torch_trees import arrays_of, state_dict_of, tensors_of

_OF_PARTS = ("observations", "next_observations")
"""Columns of a buffer that are dictionaries where observations have parts."""
_CONSTANTS = frozenset({"ent_coef_tensor"})
"""Tensors that SB3 stores, but that say what the constructor was told: of SAC and its kin an entropy coefficient that
is not learned.
"""
_GROUPS = "param_groups"
"""Under this name the state of an optimiser of torch has its options."""


def numbers_of(owner: Any) -> State:
    """The attributes that are numbers or texts."""
    return {name: value for name, value in vars(owner).items() if isinstance(value, bool | int | float | str)}


def with_own_options(numbers: State, own: State, kind: type) -> State:
    """The ``numbers`` of another one (`numbers_of`), but of all that a constructor of this kind is told the ``own``."""
    told = {name: own[name] for name in constructor_options(kind) if name in own}
    return {**numbers, **told}


def learned_variables(variables: Mapping[str, Any], own: Mapping[str, Any]) -> dict[str, Any]:
    """The ``variables`` of another one (`variables_of`, as arrays), with the ``own`` constants."""
    return {**variables, **{name: tensor for name, tensor in own.items() if name in _CONSTANTS}}


def learned_modules(modules: Mapping[str, Any], own: Mapping[str, Any]) -> dict[str, Any]:
    """The ``modules`` of another one (an algorithm's parameters, as arrays), with the ``own`` options of optimisers.

    An optimiser of another kind cannot go on with what that one remembers of gradients, and begins afresh.
    """
    return {name: _learned_module(module, own.get(name)) for name, module in modules.items()}


def _learned_module(module: Any, own: Any) -> Any:
    if not (_is_optimiser(module) and _is_optimiser(own)):
        return module
    kinds = [[sorted(group) for group in one[_GROUPS]] for one in (module, own)]
    return {**module, _GROUPS: own[_GROUPS]} if kinds[0] == kinds[1] else own


def _is_optimiser(module: Any) -> bool:
    return isinstance(module, dict) and _GROUPS in module


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
    return {name: _first(value, rows, replay.buffer_size) for name, value in _columns(replay).items()}


def whole(buffer: Any) -> State:
    """Copies of the arrays of a rollout buffer."""
    return {name: copied(value) for name, value in _columns(buffer).items()}


def copied(column: Any) -> Any:
    """A column of a buffer with arrays of its own."""
    if isinstance(column, dict):
        return {part: copied(array) for part, array in column.items()}
    return np.array(column)


def _columns(buffer: Any) -> dict[str, Any]:
    return {
        name: value
        for name, value in vars(buffer).items()
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
