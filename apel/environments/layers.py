"""An environment as it is wrapped, and what can be known of it without playing it."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import gymnasium
from gymnasium.wrappers import FlattenObservation, OrderEnforcing, PassiveEnvChecker, TimeLimit

from apel.environments.nested import ConvertedParts
from apel.experience.channels import ChannelledEnvironment

_WIDE_SEED_BITS = 63
_NEUTRAL_WRAPPERS = (
    TimeLimit, OrderEnforcing, PassiveEnvChecker, FlattenObservation, ChannelledEnvironment, ConvertedParts,
)  # fmt: skip
_KNOWN_ENVIRONMENTS = ("gymnasium.envs.", "apel.environments.", "ale_py.")
_KNOWN_TO_PASS_SEEDS = ("gymnasium.", "apel.", "ale_py.")


def layers(environment: gymnasium.Env[Any, Any]) -> Iterator[gymnasium.Env[Any, Any]]:
    """The wrappers from the outermost to the innermost, then what they wrap."""
    while isinstance(environment, gymnasium.Wrapper):
        yield environment
        environment = environment.env
    yield environment


def is_known(environment: gymnasium.Env[Any, Any]) -> bool:
    """Whether it is one of Gymnasium's, of the Arcade Learning Environment's or of ours, with no wrapper that does more
    than to limit, check or flatten.

    These keep to their observation space, and carry nothing over from one episode to the next.
    """
    return all(is_known_layer(one) for one in layers(environment))


def is_known_layer(layer: gymnasium.Env[Any, Any]) -> bool:
    """The same of an environment or a wrapper alone."""
    if isinstance(layer, gymnasium.Wrapper):
        return type(layer) in _NEUTRAL_WRAPPERS
    return _is_of(type(layer), _KNOWN_ENVIRONMENTS)


def takes_wide_seeds(environment: gymnasium.Env[Any, Any]) -> bool:
    """Whether it may be seeded with 63 bits: each of its layers leaves seeding to what is known to take as many, or
    says in its attribute ``seed_bits`` that it does.
    """
    return all(_is_of(type(one).reset, _KNOWN_TO_PASS_SEEDS) or declares_wide_seeds(one) for one in layers(environment))


def declares_wide_seeds(made: Any) -> bool:
    """Whether an environment, or what makes one, says that it takes seeds of 63 bits."""
    bits = getattr(made, "seed_bits", 0)
    return isinstance(bits, int) and bits >= _WIDE_SEED_BITS


def is_known_maker(made: Any) -> bool:
    """Whether what makes an environment, an object or an entry point's text, is known as in `is_known`."""
    return str(made).startswith(_KNOWN_ENVIRONMENTS) if isinstance(made, str) else _is_of(made, _KNOWN_ENVIRONMENTS)


def _is_of(one: Any, modules: tuple[str, ...]) -> bool:
    return str(getattr(one, "__module__", "")).startswith(modules)
