"""Names of what is shipped, and import paths for what is not."""

from __future__ import annotations

import importlib
import re
from collections.abc import Callable, Collection, Iterator, Mapping
from typing import Any

import gymnasium
from pydantic import ValidationError

from apel import selectors
from apel.configs import Named
from apel.learners.base import Performance
from apel.learners.tabular.dyna_q import DynaQ, DynaQOptions
from apel.learners.tabular.q_learning import QLearning, QLearningOptions
from apel.learners.tabular.voting import Voting, VotingOptions
from apel.numerics.near_names import did_you_mean, keyword_meant, names_at
from apel.run.user_code import faults_of, in_a_line

LEARNERS: Mapping[str, Callable[..., Any] | str] = {
    "q_learning": QLearning,
    "dyna_q": DynaQ,
    "voting": Voting,
    # By their import paths: only those who name one of them should spend the time to load it.
    "dqn": "apel.learners.deep.dqn:Dqn",
    "acer": "apel.learners.deep.acer:Acer",
    "sac": "apel.learners.deep.sac:DiscreteSac",
    "stable_baselines": "apel.learners.stable_baselines.adapter:StableBaselines",
    "stable_baselines_on_policy": "apel.learners.stable_baselines.on_policy:StableBaselinesOnPolicy",
}
SELECTORS: Mapping[str, Callable[..., Any]] = {
    "apel": selectors.Apel,
    "apel_recency": selectors.ApelRecency,
    "apel_margin": selectors.ApelMargin,
    "apel_surprise": selectors.ApelSurprise,
    "incumbent": selectors.Incumbent,
    "ssbas": selectors.Ssbas,
    "esbas": selectors.Esbas,
    "ucb1": selectors.Ucb1,
    "sw_ucb": selectors.SwUcb,
    "d_ucb": selectors.DUcb,
    "discounted_ts": selectors.DiscountedTs,
    "dynamic_ts": selectors.DynamicTs,
    "exp3": selectors.Exp3,
    "exp3s": selectors.Exp3S,
    "agent57": selectors.Agent57,
    "corral": selectors.Corral,
    "d3rb": selectors.D3rb,
    "ed2rb": selectors.Ed2rb,
    "epsilon_greedy": selectors.EpsilonGreedy,
    "uniform": selectors.Uniform,
    "fixed": selectors.Fixed,
}
_IMPORT_PATH = re.compile(r"[^\W\d]\w*(\.\w+)*:")
_NO_CODE = re.compile(r"(cpu|cuda|mps)(:\d+)?|stable_baselines3:[A-Z]\w*")
"""Devices, and what the extra ``sb3`` brings along."""
OPTIONS: Mapping[str, type | str] = {
    "q_learning": QLearningOptions,
    "dyna_q": DynaQOptions,
    "voting": VotingOptions,
    "dqn": "apel.learners.deep.dqn_options:DqnOptions",
    "acer": "apel.learners.deep.acer_options:AcerOptions",
    "sac": "apel.learners.deep.sac_options:SacOptions",
}
"""What a shipped learner may be told: dataclasses of pydantic's. A selector is its own."""
METRICS: Mapping[str, Performance] = {"return": "return", "negative_length": "negative_length"}


def resolve(name: Named, shipped: Mapping[str, Any], kind: str) -> Any:
    """What ``name`` stands for: a key of ``shipped``, or ``package.module:Name``; what is no text stands for itself.

    Raises
    ------
    ValueError
        If there is no such thing; the message says what there is.
    """
    if not isinstance(name, str) and callable(name):
        return name
    if isinstance(name, str) and name in shipped:
        found = shipped[name]
        return load(found) if isinstance(found, str) and ":" in found else found
    if not isinstance(name, str) or ":" not in name:
        expected = f"one of {sorted(shipped)} or an import path 'package.module:Name'{did_you_mean(name, shipped)}"
        message = f"found the {kind} {name!r}, expected {expected}"
        raise ValueError(message)
    return load(name)


def environment_factory(what: Named) -> Callable[..., Any] | None:
    """What makes the environment of that import path; None for a Gymnasium id, which may name a module, too.

    A name after the colon that can be no attribute of a module (``minigrid:MiniGrid-Empty-5x5-v0``) is one that the
    module registers with Gymnasium. Of others (``module:Name``) the attribute is meant where there is one.

    Raises
    ------
    ValueError
        If there is neither.
    """
    if not isinstance(what, str):
        return what
    _, colon, name = what.partition(":")
    if not colon or (name and not name.isidentifier()):
        return None
    try:
        found: Callable[..., Any] = load(what)
    except ValueError:
        if name not in gymnasium.registry:
            raise
        return None
    return found


def load(path: str) -> Any:
    """The object at an import path ``package.module:Name``.

    Raises
    ------
    ValueError
        If it cannot be imported.
    """
    module_name, _, attribute = path.partition(":")
    try:
        with faults_of(""):
            module = importlib.import_module(module_name)
    except Exception as error:
        message = f"found the import path {path!r}, but importing {module_name!r} failed: {in_a_line(error)}"
        raise ValueError(message) from error
    try:
        return getattr(module, attribute)
    except AttributeError:
        meant = did_you_mean(attribute, [name for name in vars(module) if not name.startswith("_")])
        meant = "; what a script held can be had within that script alone" if module_name == "__main__" else meant
        message = f"found the import path {path!r}, but module {module_name!r} has no {attribute!r}{meant}"
        raise ValueError(message) from None


def foreign_part(place: str, name: str, shipped: Collection[str]) -> Iterator[str]:
    """``place: 'module:Name'`` if that is the name of a part that is not ``shipped``: code that may be anybody's."""
    if name not in shipped and ":" in name:
        yield f"{place}: {name!r}"


def foreign_option(place: str, value: Any) -> Iterator[str]:
    """The same of all import paths within the value of an option."""
    if isinstance(value, Mapping):
        for key, inner in value.items():
            yield from foreign_option(place, key)
            yield from foreign_option(f"{place}.{key}", inner)
    elif isinstance(value, list | tuple):
        for inner in value:
            yield from foreign_option(place, inner)
    elif isinstance(value, str) and _IMPORT_PATH.match(value) and not _NO_CODE.fullmatch(value):
        yield f"{place}: {value!r}"


def construct(constructor: Any, name: str, options: Mapping[str, Any], *arguments: Any) -> Any:
    """Call a constructor of ours or of the user's; whatever it refuses becomes one clear `ValueError`."""
    try:
        return constructor(*arguments, **options)
    except ValidationError as error:
        model = OPTIONS.get(name)
        known = (load(model) if isinstance(model, str) else model) or constructor
        raise ValueError("; ".join(_describe(name, one, known) for one in error.errors())) from error
    except (TypeError, ValueError) as error:
        message = f"{name}: {error}{keyword_meant(error, constructor)}"
        raise ValueError(message) from error


def _describe(name: str, error: Any, model: Any) -> str:
    place = ".".join(str(part) for part in error["loc"])
    if error["type"] in ("unexpected_keyword_argument", "extra_forbidden"):
        meant = did_you_mean(error["loc"][-1], names_at(error["loc"][:-1], model))
        return f"{name}: found the option {place!r}, which it does not have{meant}"
    if error["type"] == "value_error":  # our own words
        return f"{name}: {place}{': ' if place else ''}{error['msg'].removeprefix('Value error, ')}"
    return f"{name}: {place}: found {error['input']!r}, expected {error['msg'].removeprefix('Input should be ')}"
