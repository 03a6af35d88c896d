"""Which spaces a learner is for: said by its class, so that whoever names one for another environment is told which
would do.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal

from gymnasium import spaces

from apel.experience.parts import parts_of

ActionSpace = Literal["Discrete", "Box", "MultiDiscrete", "MultiBinary"]
ObservationSpace = Literal["Box", "Discrete", "MultiDiscrete", "MultiBinary", "Dict", "Tuple"]


@dataclass(frozen=True)
class SupportedSpaces:
    """What a learner's class declares as its attribute ``supported_spaces``; where that depends on its options, it is a
    function of them. A class without it is tried with whatever the environment has.

    Attributes
    ----------
    actions:
        Names of Gymnasium's spaces.
    observations:
        The same. ``Dict`` and ``Tuple`` say that it takes such observations whole; others are shown them as a vector
        (`apel.experience.parts`), or one of their channels.
    """

    actions: tuple[ActionSpace, ...]
    observations: tuple[ObservationSpace, ...]
    hint: str = ""
    """What could be done about other observations."""

    def takes_actions(self, space: spaces.Space[Any]) -> bool:
        """Whether actions of this space can be chosen."""
        return _is_named(space, self.actions)

    def takes_observations(self, space: spaces.Space[Any]) -> bool:
        """Whether observations of this space can be seen."""
        return _is_named(space, self.observations)

    def takes_whole(self, space: spaces.Space[Any]) -> bool:
        """Whether observations that trajectories hold as elements of this space are to be shown with their parts."""
        parts = parts_of(space)
        return parts is not None and self.takes_observations(parts)


_COUNTED: tuple[ObservationSpace, ...] = ("Discrete", "MultiDiscrete", "MultiBinary")
_VECTORS: tuple[ObservationSpace, ...] = ("Box", *_COUNTED)

TABLES = SupportedSpaces(
    ("Discrete",), _COUNTED, "a table needs finitely many states; a representation with bins makes some"
)
"""Of learners with a table."""
ANYTHING_SEEN = SupportedSpaces(("Discrete",), (*_VECTORS, "Dict", "Tuple"))
"""Of a vote, whose members see for themselves."""
NETWORKS = SupportedSpaces(("Discrete",), _VECTORS)
"""Of our networks."""

SB3_ALGORITHMS: Mapping[str, ActionSpace] = {
    "stable_baselines3:DQN": "Discrete",
    "stable_baselines3:SAC": "Box",
    "stable_baselines3:TD3": "Box",
    "stable_baselines3:DDPG": "Box",
    "sb3_contrib:QRDQN": "Discrete",
    "sb3_contrib:TQC": "Box",
    "sb3_contrib:CrossQ": "Box",
}
"""The off-policy algorithms of stable-baselines3 and sb3-contrib, with the actions that each is for."""


def sb3_spaces(options: Mapping[str, Any]) -> SupportedSpaces:
    """Of the learner ``stable_baselines`` with these options; an algorithm that is not known here says for itself."""
    action = SB3_ALGORITHMS.get(options.get("algorithm", "stable_baselines3:DQN"))
    whole: tuple[ObservationSpace, ...] = ("Dict",) if options.get("policy") == "MultiInputPolicy" else _VECTORS
    return SupportedSpaces(("Discrete", "Box") if action is None else (action,), whole)


def sb3_on_policy_spaces(options: Mapping[str, Any]) -> SupportedSpaces:
    """Of the learner ``stable_baselines_on_policy`` with these options."""
    whole: tuple[ObservationSpace, ...] = ("Dict",) if options.get("policy") == "MultiInputPolicy" else _VECTORS
    return SupportedSpaces(("Discrete", "Box", "MultiDiscrete", "MultiBinary"), whole)


SHIPPED: Mapping[str, SupportedSpaces] = {
    "q_learning": TABLES,
    "dyna_q": TABLES,
    "voting": ANYTHING_SEEN,
    "dqn": NETWORKS,
    "acer": NETWORKS,
    "sac": NETWORKS,
    **{path: sb3_spaces({"algorithm": path}) for path in SB3_ALGORITHMS},
}
"""The learners that come along, as an experiment names them; import paths are algorithms of ``stable_baselines``."""


def supported_spaces(constructor: Any, options: Mapping[str, Any]) -> SupportedSpaces | None:
    """What a learner's class declares; None for nothing."""
    declared: SupportedSpaces | Callable[[Mapping[str, Any]], SupportedSpaces] | None
    declared = getattr(constructor, "supported_spaces", None)
    return declared if declared is None or isinstance(declared, SupportedSpaces) else declared(options)


def check_spaces(supported: SupportedSpaces, name: str, seen: spaces.Space[Any], action: spaces.Space[Any]) -> None:
    """Refuse a learner for spaces that it does not support.

    Parameters
    ----------
    supported:
        What it declares.
    name:
        Its name, for people.
    seen:
        What it would see of the observations.
    action:
        The environment's actions.

    Raises
    ------
    ValueError
        If it supports one of them not; the message names the learners that would do.
    """
    if not supported.takes_actions(action):
        found, expected = f"the action space {action}", _listed(supported.actions)
    elif not supported.takes_observations(seen):
        found, expected = f"the observation space {seen}", _listed(supported.observations)
        expected += f" ({supported.hint})" if supported.hint else ""
    else:
        return
    message = f"{name}: found {found}, expected {expected}, or another learner, {_fitting(seen, action)}"
    raise ValueError(message)


def _fitting(seen: spaces.Space[Any], action: spaces.Space[Any]) -> str:
    """The learners that come along and would do."""
    if isinstance(action, spaces.MultiDiscrete | spaces.MultiBinary):
        return "which would have to be one of your own, or apel.environments.JointActions around the environment"
    fit = [name for name, one in SHIPPED.items() if one.takes_actions(action) and one.takes_observations(seen)]
    if not fit:
        return "which would have to be your own: no shipped learner supports such actions and observations"
    ours = [name for name in fit if name not in SB3_ALGORITHMS]
    theirs = ", ".join(name for name in fit if name in SB3_ALGORITHMS)
    return f"such as {', '.join([*ours, f'stable_baselines (algorithm: {theirs})'])}"


_NAMED: Mapping[str, type] = {
    "Discrete": spaces.Discrete,
    "Box": spaces.Box,
    "MultiDiscrete": spaces.MultiDiscrete,
    "MultiBinary": spaces.MultiBinary,
    "Dict": spaces.Dict,
    "Tuple": spaces.Tuple,
}


def _is_named(space: spaces.Space[Any], names: tuple[str, ...]) -> bool:
    return any(isinstance(space, _NAMED[name]) for name in names)


def _listed(names: tuple[str, ...]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} or {names[-1]}"
