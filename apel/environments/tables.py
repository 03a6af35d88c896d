"""Which environments may be played by their tables.

Only those of which it is certain that they play the same: of classes that are known here, with nothing changed and
nothing around them that changes what is seen, paid or ended, and of a user's that declare tables and play them value
for value. All others are played step by step, which is right whatever they do.
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import gymnasium
from gymnasium.envs.toy_text import CliffWalkingEnv, FrozenLakeEnv, TaxiEnv
from gymnasium.wrappers import OrderEnforcing, PassiveEnvChecker, TimeLimit

from apel.dynamics.finite_model import FiniteModel
from apel.environments.comparison import plays_otherwise, steps_beside_its_tables
from apel.environments.finite_environment import (
    FiniteEnvironment,
    HasFiniteModel,
    HasTransitionTable,
    fault_of_toy_text,
    toy_text_model,
)
from apel.environments.maze import Maze
from apel.environments.unchanged import override_in, replacement_in

_NEUTRAL = (TimeLimit, OrderEnforcing, PassiveEnvChecker)
_TOY_TEXT: tuple[Any, ...] = (FrozenLakeEnv, CliffWalkingEnv, TaxiEnv)
_OURS = (Maze, FiniteEnvironment)
_BEYOND_TABLES: Mapping[type, str] = {TaxiEnv: "fickle_passenger"}
"""Options that change what happens, but not the tables."""
_NO_LIMIT = sys.maxsize
_compared_already: dict[Any, str | None] = {}
"""What was found where something was compared in this process before."""


class TablesWarning(UserWarning):
    """An environment does not do what its tables say, and is played without them."""


@dataclass(frozen=True)
class Tables:
    """The tables of an environment, if it may be played by them.

    Attributes
    ----------
    model:
        None where it is played step by step.
    reason:
        Why it is, or may not be, in words.
    features:
        Names of the variables of its observations, where tables that it offers name them.
    """

    model: FiniteModel | None
    reason: str
    features: tuple[str, ...] | None = None


def tables_of(environment: gymnasium.Env[Any, Any], name: str) -> Tables:
    """The tables by which ``environment``, called ``name``, may be played.

    Raises
    ------
    ValueError
        If tables of Gymnasium's have no limit to an episode.
    """
    base: Any = environment
    limit, around = _NO_LIMIT, None
    while isinstance(base, gymnasium.Wrapper):
        kind = type(base)
        around = around or (replacement_in(base, kind) if kind in _NEUTRAL else f"wrapped by {kind.__name__}")
        if isinstance(base, TimeLimit):
            limit = min(limit, base._max_episode_steps)
        base = base.env
    if isinstance(base, HasFiniteModel):
        return _declared(environment, base, limit, name, around)
    if not isinstance(base, HasTransitionTable):
        return Tables(None, "it has no tables")
    if around is not None:
        return Tables(None, around)
    return _toy_text(environment, base, limit, name)


def _toy_text(environment: gymnasium.Env[Any, Any], base: Any, limit: int, name: str) -> Tables:
    """Of Gymnasium's toy-text family, which draws its outcomes from the tables ``P``."""
    known = _lineage(base, _TOY_TEXT)
    if known is None:
        return Tables(None, f"nothing is known of how {type(base).__name__} plays its tables")
    option = _BEYOND_TABLES.get(known)
    if option is not None and getattr(base, option, False):
        return Tables(None, f"its option {option} is not in its tables")
    if obstacle := override_in(type(base), known) or replacement_in(base, known) or fault_of_toy_text(base):
        return Tables(None, obstacle)
    if limit == _NO_LIMIT:
        message = f"{name} sets no limit to an episode: give max_episode_steps"
        raise ValueError(message)
    model = toy_text_model(base, limit)
    key = (type(base), limit, *(part.tobytes() for part in (model.next_cell, model.cumulative, model.reward)))
    if obstacle := _compared(key, name, lambda: steps_beside_its_tables(environment, base, model)):
        return Tables(None, obstacle)
    return Tables(model, f"Gymnasium's {_called(base, known)}", model.features)


def _declared(environment: gymnasium.Env[Any, Any], base: Any, limit: int, name: str, around: str | None) -> Tables:
    """Of a class that offers its `FiniteModel`: ours, or a user's."""
    model = base.finite_model
    if not isinstance(model, FiniteModel):
        return Tables(None, f"its finite_model is no FiniteModel, but {type(model).__name__}")
    model = replace(model, max_steps=limit) if limit < model.max_steps else model
    shown = FiniteEnvironment(model)
    features = model.features if environment.observation_space == shown.observation_space else None
    known = _lineage(base, _OURS)
    if known is not None and any("finite_model" in vars(kind) for kind in type(base).__mro__):
        known = None  # a subclass that says itself what its tables are
    if known is not None:
        of_class = override_in(type(base), known) or replacement_in(base, known)
    else:
        of_class = _played_by_another(base)
    if obstacle := around or of_class or _difference_of_spaces(environment, shown):
        return Tables(None, obstacle, features)
    # Mazes differ from run to run, but not in how they are played; how a user's do is known of none.
    key = (type(base), model.max_steps) if type(base) in _OURS else None
    if obstacle := _compared(key, name, lambda: plays_otherwise(environment, model)):
        return Tables(None, obstacle, features)
    return Tables(model, _called(base, known) if known else f"those that {type(base).__name__} declares", features)


def _lineage(base: object, known: tuple[type, ...]) -> type | None:
    return next((kind for kind in known if isinstance(base, kind)), None)


def _called(base: object, known: type) -> str:
    kind = type(base)
    return f"{known.__name__}, unchanged" if kind is known else f"{known.__name__} as {kind.__name__} makes it"


def _declaring(base: object) -> type:
    """The class that says which tables there are: by a property, or where the environment is made."""
    kinds = type(base).__mro__
    return next((kind for kind in kinds if "finite_model" in vars(kind)), None) or _defining(base, "__init__")


def _defining(base: object, name: str) -> type:
    return next(kind for kind in type(base).__mro__ if name in vars(kind))


def _played_by_another(base: object) -> str | None:
    """Who declares tables must be the one that steps, or come after it."""
    kinds, declaring = type(base).__mro__, _declaring(base)
    for name in ("step", "reset"):
        if name in vars(base):
            return f"its {name} was replaced"
        playing = _defining(base, name)
        if kinds.index(playing) < kinds.index(declaring):
            return f"{playing.__name__} overrides {name}, and declares no tables"
    return None


def _difference_of_spaces(environment: gymnasium.Env[Any, Any], shown: gymnasium.Env[Any, Any]) -> str | None:
    if environment.observation_space != shown.observation_space:
        return (
            f"its observations {environment.observation_space} are not those of its tables, {shown.observation_space}"
        )
    if environment.action_space != shown.action_space:
        return f"its actions {environment.action_space} are not those of its tables, {shown.action_space}"
    return None


def _compared(key: Any, name: str, compare: Callable[[], str | None]) -> str | None:
    """What `compare` finds, once for each key but None; a difference is told, for somebody declares what is not so."""
    if key in _compared_already:
        return _compared_already[key]
    try:
        difference = compare()
    except Exception as error:  # noqa: BLE001 - whatever a user's code raises, it raises again where it is played
        difference = f"{type(error).__name__}: {error}"
    if difference is not None:
        difference = f"it differs from its tables: found {difference}"
        warnings.warn(f"{name} is played step by step, for {difference}", TablesWarning, stacklevel=2)
    if key is not None:
        _compared_already[key] = difference
    return difference
