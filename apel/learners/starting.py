"""How a learner begins with what another one has learned, and how the states of many runs and of one become each other.

The random streams of a run follow from its seed, so a learner that begins with another one's weights draws from its own
streams all the same: otherwise all runs that begin with one agent would explore alike.
"""

from __future__ import annotations

from collections.abc import Sequence, Set
from typing import Any, Protocol, runtime_checkable

import numpy as np

from apel.learners.base import Learner, State

STREAMS = frozenset({"stream", "streams", "random", "random_actions"})
"""By these names the states of learners hold random streams; those of NumPy are known by their form."""
_OWN = STREAMS | {"frozen"}
"""And by this one what they act on while their policy is frozen."""
_NUMPY_STREAM = frozenset({"bit_generator", "state"})


@runtime_checkable
class Beginner(Protocol):
    """A learner that knows itself how to begin with another one's state: what of it is learned, and what is not."""

    def begin_from(self, state: State) -> None:
        """Take over what was learned; options, random streams and the clock of episodes stay its own."""
        ...


def begin(learner: Learner, state: State) -> None:
    """Let a learner that has just been made begin with the state of another one of its kind.

    One that is no `Beginner` takes over everything but what are, by name or by form, random streams: what lies under
    ``stream`` or ``streams``, and the states of NumPy's generators; nor is a policy taken over that was ``frozen``.
    """
    if isinstance(learner, Beginner):
        learner.begin_from(state)
    else:
        learner.restore(with_own(state, learner.state()))


def with_own(state: Any, own: Any, names: Set[str] = _OWN) -> Any:
    """``state`` with what lies under ``names``, and NumPy's streams, out of ``own``, a state of the same form.

    >>> with_own({"weights": [1, 2], "stream": 3}, {"weights": [0, 0], "stream": 4})
    {'weights': [1, 2], 'stream': 4}
    """
    if isinstance(state, dict) and isinstance(own, dict):
        if state.keys() >= _NUMPY_STREAM and own.keys() >= _NUMPY_STREAM:
            return own
        return {
            name: own[name] if name in names and name in own else with_own(part, own.get(name), names)
            for name, part in state.items()
        }
    if isinstance(state, list | tuple) and isinstance(own, list | tuple) and len(state) == len(own):
        return [with_own(*pair, names) for pair in zip(state, own, strict=True)]
    return state


def of_run(state: Any, run: int) -> Any:
    """The state of a batched learner of one run alone, out of that of many (`BatchedLearner.state`)."""
    match state:
        case np.ndarray():
            return state[run : run + 1].copy()
        case dict():
            return {name: of_run(part, run) for name, part in state.items()}
        case list() | tuple():
            return [of_run(part, run) for part in state]
    return state


def of_runs(states: Sequence[Any]) -> Any:
    """The state of a batched learner of many runs, out of those of single ones that are all of one form."""
    match states[0]:
        case np.ndarray():
            return np.concatenate(states)
        case dict():
            return {name: of_runs([one[name] for one in states]) for name in states[0]}
        case list() | tuple():
            return [of_runs(parts) for parts in zip(*states, strict=True)]
    return states[0]
