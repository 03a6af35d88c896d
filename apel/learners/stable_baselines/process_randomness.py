"""Random states of one learner that draws from the process's own streams (``random``, ``numpy``, ``torch``)."""

from __future__ import annotations

import copy
import random
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

import numpy as np

from apel.learners.base import State
from apel.learners.stable_baselines.torch_trees import arrays_of, tensors_of


class RandomStates(NamedTuple):
    """States of the random streams of a process."""

    python: tuple[Any, ...]
    numpy: Any
    torch: Any
    cuda: list[Any]


class ProcessRandomness:
    """The random states of one learner, the process's only while `active` (in a process with one thread)."""

    def __init__(self, device: str) -> None:
        from stable_baselines3.common.utils import get_device

        try:
            # Elsewhere CUDA is left alone: to ask for its states would claim memory on it.
            self._uses_cuda = get_device(device).type == "cuda"
        except RuntimeError as error:
            message = f"device: found {device!r}, expected one that torch knows: {error}"
            raise ValueError(message) from error
        self._own = self._states_of_process()

    @contextmanager
    def active(self) -> Iterator[None]:
        """Within, the process draws from these states."""
        outside = self._states_of_process()
        self._enter(self._own)
        try:
            yield
        finally:
            self._own = self._states_of_process()
            self._enter(outside)

    def state(self) -> State:
        """The states as arrays and numbers."""
        version, words, gauss = self._own.python
        return {
            "python": [version, np.array(words), gauss],
            "numpy": copy.deepcopy(self._own.numpy),
            "torch": arrays_of(self._own.torch),
            "cuda": arrays_of(self._own.cuda),
        }

    def restore(self, state: State) -> None:
        """Go back to what `state` returned."""
        version, words, gauss = state["python"]
        python = (version, tuple(words.tolist()), gauss)
        self._own = RandomStates(python, state["numpy"], tensors_of(state["torch"]), tensors_of(state["cuda"]))

    def _states_of_process(self) -> RandomStates:
        import torch

        cuda = torch.cuda.get_rng_state_all() if self._uses_cuda else []
        numpy_state = np.random.get_state(legacy=False)  # noqa: NPY002 - it is the stream that SB3 draws from
        return RandomStates(random.getstate(), numpy_state, torch.get_rng_state(), cuda)

    def _enter(self, states: RandomStates) -> None:
        import torch

        random.setstate(states.python)
        np.random.set_state(states.numpy)  # noqa: NPY002 - as above
        torch.set_rng_state(states.torch)
        if self._uses_cuda:
            torch.cuda.set_rng_state_all(states.cuda)
