"""From what an agent is made of to its learners, and from an environment's observations to what these see."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from apel.agents.content import AgentContent, TrainedFloor, TrainedLearner, TrainedSelector, raw_space_of
from apel.building import make_learner
from apel.building.registry import LEARNERS, SELECTORS, foreign_option, foreign_part
from apel.configs import EnvironmentConfig, LearnerConfig, SelectorConfig, name_of
from apel.environments import World
from apel.environments.nested import converter
from apel.experience.channels import ChannelSpace
from apel.experience.joint_space import JointSpace
from apel.experience.observation_form import ObservationForm
from apel.experience.representations import View
from apel.learners.base import Learner
from apel.learners.starting import STREAMS, with_own
from apel.numerics.views import Row
from apel.run.rule import RuleSelector
from apel.run.selection import Selector, common_blocks
from apel.run.state import RUNNING, Book
from apel.selectors import Fixed


def trained_agent(
    environment: EnvironmentConfig,
    world: World,
    learners: Sequence[TrainedLearner],
    selector: SelectorConfig,
    book: Book,
    run: int,
    origin: Mapping[str, Any],
) -> AgentContent:
    """The agent that a run of a book has come to. The best learner is told by what its selector thinks of each."""
    row, floor = book.selector_state[run].copy(), None
    if book.floor > 0.0 and book.steps[run] >= book.floor_after:
        known = (book.acting_steps[run], book.acting_length[run], book.floor_stream[run])
        floor = TrainedFloor(float(book.floor), *(column.copy() for column in known))
        if book.status[run] == RUNNING:
            row[: len(learners)] = book.wanted[run]  # where those stand that the coming episode is played with
    name, scores = estimates(row, len(learners))
    return AgentContent(
        environment=environment,
        spaces=world.spaces,
        learners=tuple(learners),
        selector=TrainedSelector(selector, row, book.selector_stream[run].copy(), floor),
        raw_space=raw_space_of(world),
        origin={**origin, "episodes": int(book.episode[run]), "steps": int(book.steps[run])},
        scores=tuple(scores.tolist()),
        score_name=name,
    )


def estimates(row: Row, num_learners: int) -> tuple[str, NDArray[np.float64]]:
    """What a selector thinks of each learner (``float64[learners]``, larger is better), and what that is.

    It is the Dirichlet's concentration, which adds up over episodes, where there is one; else the latest performance,
    of learners that have any.
    """
    blocks = common_blocks(row, num_learners)
    if np.isfinite(blocks.concentration).all():
        return "concentration", blocks.concentration.copy()
    if np.isnan(blocks.performance_estimate).all():
        return "probability", blocks.probability.copy()
    # No learner is told to be the best of which nothing is known; JSON has no infinities.
    return "performance", np.nan_to_num(blocks.performance_estimate, nan=-np.finfo(np.float64).max)


def selector_config(selector: Selector) -> SelectorConfig:
    """A selector that was made already, as data."""
    made: Any = selector.rule if isinstance(selector, RuleSelector) else selector
    name = next((key for key, kind in SELECTORS.items() if kind is type(made)), name_of(type(made)))
    return SelectorConfig(
        name, {one.name: getattr(made, one.name) for one in fields(made)} if is_dataclass(made) else {}
    )


def fixed_selector(stream: NDArray[np.uint64]) -> TrainedSelector:
    """That of a learner alone."""
    return TrainedSelector(SelectorConfig("fixed"), Fixed().initial_state(1, 1), stream)


def make_trained(content: AgentContent, index: int, seed: int | None = None) -> tuple[Learner, View]:
    """A learner of an agent with its state, and its view of observations.

    With a ``seed`` its random streams follow from that; else they go on.

    Raises
    ------
    ValueError
        If it cannot be made here, or does not take its state.
    """
    one = content.learners[index]
    made = make_learner(one.config, content.spaces, int(content.origin.get("seed", 0)) if seed is None else seed, index)
    try:
        made[0].restore(one.state if seed is None else with_own(one.state, made[0].state(), STREAMS))
    except (ValueError, LookupError, TypeError, AttributeError, RuntimeError) as error:
        message = (
            f"{one.name}: {one.config.name} does not take the state that is stored: {type(error).__name__}: {error}"
        )
        raise ValueError(message) from error
    return made


def entry_of(content: AgentContent, observation: Any, info: Mapping[str, Any]) -> NDArray[Any]:
    """An observation as an environment gives it, in the form in which learners' views take it."""
    space = content.spaces.observation
    if isinstance(space, ChannelSpace):
        return np.asarray(space.entry(observation, {**dict.fromkeys(space.signals, 0.0), **info}))
    if isinstance(observation, Mapping | tuple):
        if isinstance(space, JointSpace):
            return space.vector(observation)
        if content.raw_space is not None:
            parts: Any = converter(content.raw_space)(observation)
            observation = spaces.flatten(content.raw_space, parts)
    return np.asarray(ObservationForm(space).converted(observation))


def foreign_names(content: AgentContent) -> list[str]:
    """``field: 'module:Name'`` of all code that making its learners, or its selector, would run and is not shipped."""
    named: list[str] = []
    for one in content.learners:
        named += _foreign(f"learners.{one.name}", one.config)
    selector = content.selector.config
    named += foreign_part("selector.type", selector.name, SELECTORS)
    return named + list(foreign_option("selector", dict(selector.options)))


def _foreign(place: str, config: LearnerConfig) -> list[str]:
    named = [*foreign_part(f"{place}.type", config.name, LEARNERS), *foreign_option(place, dict(config.options))]
    for i, member in enumerate(config.members):
        named += _foreign(f"{place}.members.{i}", member)
    return named


def foreign_environment(config: EnvironmentConfig) -> list[str]:
    """The same of an environment."""
    if not isinstance(config.id, str):
        return []
    named = list(foreign_part("environment.id", config.id, ()))
    return named + list(foreign_option("environment.options", dict(config.options)))
