"""What an environment carries over from one episode to the next, so that a checkpoint can hold it; and how it is found
out that one carries something that no checkpoint holds.

A run is gone on with in environments that have just been made. That is the same run only where an episode follows from
its seed and its actions. Of unknown environments the beginning of the last episode is kept, and played again in the new
ones: where it goes another way, something was carried over.
"""

from __future__ import annotations

import hashlib
import struct
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import gymnasium
import numpy as np
from gymnasium.wrappers import NormalizeObservation, NormalizeReward
from numpy.typing import NDArray

from apel.environments.layers import is_known_layer, layers
from apel.experience.action_form import ActionForm

_MOST_STEPS, _MOST_BYTES = 100, 2**16
"""Of the last episode's beginning that is kept of each run."""

State = dict[str, Any]


class CarriedStateError(ValueError):
    """An environment carries something from one episode to the next that no checkpoint holds."""


class Tape:
    """The beginning of an episode: its seed and actions, and what the environment answered.

    ``before`` is what the environment carried before it.
    """

    def __init__(self, seed: int, before: Sequence[State]) -> None:
        self.seed, self.before = seed, list(before)
        self.actions: list[Any] = []
        self._told: list[tuple[bytes, float, bool, bool]] = []
        self._room = _MOST_BYTES

    def begin(self, entry: NDArray[Any]) -> None:
        """The first answer."""
        self._told.append((entry.tobytes(), 0.0, False, False))

    def add(self, action: Any, entry: NDArray[Any], *numbers: Any) -> None:
        """An action, and the answer: entry, reward, terminated, truncated."""
        self.actions.append(action)
        self._told.append((entry.tobytes(), *numbers))
        self._room -= entry.nbytes

    @property
    def is_full(self) -> bool:
        """Whether enough is kept."""
        return len(self.actions) >= _MOST_STEPS or self._room <= 0

    @property
    def digest(self) -> str:
        """Of all answers."""
        digest = hashlib.sha256()
        for entry, reward, terminated, truncated in self._told:
            digest.update(entry + struct.pack("<d??", reward, terminated, truncated))
        return digest.hexdigest()


class Carried:
    """What one environment carries, as far as it can be known.

    Attributes
    ----------
    is_taped:
        Whether it may carry more than its layers say that they do, so that its episodes are kept in part.
    tape:
        Of its last episode; None before the first.
    """

    def __init__(self, environment: gymnasium.Env[Any, Any]) -> None:
        self._actions = ActionForm(environment.action_space)
        self._carriers = list(_carriers(environment))
        self.is_taped = any(not (is_known_layer(one) or _is_carrier(one)) for one in layers(environment))
        self.tape: Tape | None = None

    def begin(self, seed: int) -> Tape:
        """An episode begins."""
        self.tape = Tape(seed, self._states())
        return self.tape

    def state(self) -> State:
        """What is carried; and the last episode's beginning, from which is seen whether that is all."""
        tape = self.tape
        if tape is None:
            return {"carried": self._states(), "tape": None}
        actions = self._actions.column(tape.actions)
        kept = {"seed": tape.seed, "before": tape.before, "actions": actions, "digest": tape.digest}
        return {"carried": self._states(), "tape": kept}

    def check(self, state: State, replay: Callable[[int, Sequence[Any]], str]) -> None:
        """Hold an environment that has just been made against the one whose `state` this was.

        ``replay`` plays a seed and actions, and answers with their digest.

        Raises
        ------
        CarriedStateError
            If they are not alike.
        """
        stored = state["tape"]
        if not self.is_taped or stored is None:
            return
        self._restore(stored["before"])
        if replay(int(stored["seed"]), self._actions.rows(np.asarray(stored["actions"]))) != stored["digest"]:
            message = (
                "the environment carries something over from one episode to the next, or draws without its seed: "
                "played again in a new one, its last episode goes another way, so that no run can resume exactly from "
                "what is stored of it. Give it the methods state() and restore(state), which say what it carries"
            )
            raise CarriedStateError(message)

    def restore(self, state: State) -> None:
        """Go back to what `state` returned."""
        self._restore(state["carried"])
        self.tape = None

    def _states(self) -> list[State]:
        return [_state_of(one) for one in self._carriers]

    def _restore(self, states: Sequence[State]) -> None:
        for one, stored in zip(self._carriers, states, strict=True):
            _restore(one, stored)


def _carriers(environment: gymnasium.Env[Any, Any]) -> Iterator[Any]:
    """The layers of which it is known what they carry; the outermost first."""
    return (layer for layer in layers(environment) if _is_carrier(layer))


def _is_carrier(layer: Any) -> bool:
    """Whether it says what it carries, or is one of Gymnasium's that normalise: a subclass may carry more."""
    says = all(callable(getattr(type(layer), name, None)) for name in ("state", "restore"))
    return says or type(layer) in (NormalizeObservation, NormalizeReward)


def _state_of(layer: Any) -> State:
    if type(layer) is NormalizeObservation:
        return _moments(layer.obs_rms)
    if type(layer) is NormalizeReward:
        return {**_moments(layer.return_rms), "discounted_reward": np.array(layer.discounted_reward)}
    state: State = layer.state()
    return state


def _restore(layer: Any, state: State) -> None:
    if type(layer) is NormalizeObservation:
        _set_moments(layer.obs_rms, state)
    elif type(layer) is NormalizeReward:
        _set_moments(layer.return_rms, state)
        layer.discounted_reward = np.array(state["discounted_reward"])
    else:
        layer.restore(state)


def _moments(running: Any) -> State:
    return {"mean": np.array(running.mean), "var": np.array(running.var), "count": float(running.count)}


def _set_moments(running: Any, state: State) -> None:
    running.mean, running.var, running.count = np.array(state["mean"]), np.array(state["var"]), float(state["count"])
