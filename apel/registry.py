"""Names of what is shipped, and import paths for what is not."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Mapping
from typing import Any

from apel import selectors
from apel.learners.base import Performance
from apel.learners.dyna_q import DynaQ
from apel.learners.q_learning import QLearning
from apel.learners.voting import Voting

LEARNERS: Mapping[str, Callable[..., Any] | str] = {
    "q_learning": QLearning,
    "dyna_q": DynaQ,
    "voting": Voting,
    # By their import paths: loading PyTorch takes seconds, which only those who name a deep learner should spend.
    "dqn": "apel.learners.deep.dqn:Dqn",
    "acer": "apel.learners.deep.acer:Acer",
    "sac": "apel.learners.deep.sac:DiscreteSac",
    "stable_baselines": "apel.learners.stable_baselines:StableBaselines",
}
SELECTORS: Mapping[str, Callable[..., Any]] = {
    "apel": selectors.Apel,
    "apel_recency": selectors.ApelRecency,
    "apel_margin": selectors.ApelMargin,
    "apel_surprise": selectors.ApelSurprise,
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
METRICS: Mapping[str, Performance] = {"return": "return", "negative_length": "negative_length"}


def resolve(name: str, shipped: Mapping[str, Any], kind: str) -> Any:
    """What ``name`` stands for: a key of ``shipped``, or ``package.module:Name``.

    Raises
    ------
    ValueError
        If there is no such thing; the message says what there is.
    """
    if name in shipped:
        found = shipped[name]
        return load(found) if isinstance(found, str) and ":" in found else found
    if ":" not in name:
        message = (
            f"found the {kind} {name!r}, expected one of {sorted(shipped)} or an import path 'package.module:Name'"
        )
        raise ValueError(message)
    return load(name)


def load(path: str) -> Any:
    """The object at an import path ``package.module:Name``.

    Raises
    ------
    ValueError
        If it cannot be imported.
    """
    module_name, _, attribute = path.partition(":")
    try:
        module = importlib.import_module(module_name)
    except Exception as error:
        message = (
            f"found the import path {path!r}, but importing {module_name!r} failed: {type(error).__name__}: {error}"
        )
        raise ValueError(message) from error
    try:
        return getattr(module, attribute)
    except AttributeError:
        message = f"found the import path {path!r}, but module {module_name!r} has no {attribute!r}"
        raise ValueError(message) from None
