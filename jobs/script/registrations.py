"""What stands behind an id of Gymnasium's that a script, or a module of the user's, has registered."""

from __future__ import annotations

import functools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import gymnasium
from gymnasium.envs.registration import EnvSpec, find_highest_version, get_env_id, parse_env_id

from jobs.script.local_modules import is_installed, is_local


@dataclass(frozen=True)
class Registration:
    """What a registration says that may change a row.

    Attributes
    ----------
    entry_point:
        What makes the environment, or its import path.
    kwargs:
        The options that it is made with.
    max_episode_steps:
        Truncates episodes.
    wrappers:
        Name, import path and options of each further wrapper.
    """

    entry_point: Any
    kwargs: Mapping[str, Any]
    max_episode_steps: int | None
    wrappers: Sequence[tuple[str, str, Any]]

    @property
    def modules(self) -> list[str]:
        """Of the import paths."""
        paths = [self.entry_point, *(path for _, path, _ in self.wrappers)]
        return [path.partition(":")[0] for path in paths if isinstance(path, str)]


def own_registration(name: str) -> Registration | None:
    """The registration of that id; None where there is none, or one of an installed package's environment."""
    spec = _spec(name)
    if spec is None or _is_installed(spec.entry_point):
        return None
    wrappers = [(one.name, one.entry_point, one.kwargs) for one in spec.additional_wrappers]
    return Registration(spec.entry_point, spec.kwargs, spec.max_episode_steps, wrappers)


def _spec(name: str) -> EnvSpec | None:
    """The registration; of an id without a version, that of the latest one, as Gymnasium has it."""
    name = name.rpartition(":")[2]
    if name in gymnasium.registry:
        return gymnasium.registry[name]
    try:
        space, bare, version = parse_env_id(name)
    except gymnasium.error.Error:
        return None
    version = find_highest_version(space, bare) if version is None else version
    return None if version is None else gymnasium.registry.get(get_env_id(space, bare, version))


def _is_installed(entry_point: Any) -> bool:
    if isinstance(entry_point, str):
        return not is_local(entry_point.partition(":")[0])
    while isinstance(entry_point, functools.partial):
        entry_point = entry_point.func
    module = getattr(entry_point, "__module__", None)
    return module is None or (module != "__main__" and is_installed(module))
