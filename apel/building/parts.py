"""Environments, selectors and performance measures from their configurations."""

from __future__ import annotations

from apel import environments
from apel.building.registry import METRICS, SELECTORS, construct, environment_factory, resolve
from apel.configs import EnvironmentConfig, Named, SelectorConfig, name_of
from apel.environments import World
from apel.learners.base import (
    Performance,
)
from apel.run.rule import SelectionRule, as_selector
from apel.run.selection import Selector


def make_world(config: EnvironmentConfig, run_seed: int) -> World:
    """Make the environment of the run with seed ``run_seed``, by whatever name it goes.

    Raises
    ------
    ValueError
        If it is unknown, refuses its options, or cannot be used by an ensemble.
    """
    return environments.make_world(config, run_seed, environment_factory(config.id))


def make_selector(config: SelectorConfig) -> Selector:
    """Make a selector.

    Raises
    ------
    ValueError
        If it is unknown, refuses its options, or is none.
    """
    made = construct(resolve(config.type, SELECTORS, "selector"), config.name, dict(config.options))
    if not isinstance(made, Selector | SelectionRule):
        message = f"{config.name}: found {type(made).__name__}, expected a selector (see apel.SelectionRule)"
        raise ValueError(message)
    return as_selector(made)


def make_performance(what: Named) -> Performance:
    """The performance measure of that name or import path, or the function itself: a function of a trajectory."""
    measure: Performance = resolve(what, METRICS, "performance measure")
    if not callable(measure) and measure not in METRICS:
        message = f"{name_of(what)}: found {measure!r}, expected a function of a trajectory"
        raise ValueError(message)
    return measure
