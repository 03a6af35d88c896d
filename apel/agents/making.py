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
from apel.experience.channels import ChannelSpace, form_of
from apel.experience.joint_space import JointSpace
from apel.experience.observation_form import BorderError, shown
from apel.experience.parts import FlattenedSpace
from apel.experience.representations import View
from apel.experience.spaces import Spaces
from apel.learners.base import Learner
from apel.learners.starting import STREAMS, with_own
from apel.numerics.views import Row
from apel.run.rule import RuleSelector
from apel.run.selection import Selector, common_blocks
from apel.run.state import RUNNING, Book
from apel.run.user_code import in_a_line
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
    """The agent that a run of a book has come to. The best learner is told by what its selector thinks of each.

    Raises
    ------
    ValueError
        If two learners have the same name.
    """
    _check_names([one.name for one in learners])
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


def _check_names(names: Sequence[str]) -> None:
    if twice := [name for i, name in enumerate(names) if name in names[:i]]:
        message = f"names: found {twice[0]!r} twice in {list(names)}, expected a name of its own for each learner"
        raise ValueError(message)


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
    one, known = content.learners[index], _known_spaces(content)
    made = make_learner(one.config, known, int(content.origin.get("seed", 0)) if seed is None else seed, index)
    try:
        made[0].restore(one.state if seed is None else with_own(one.state, made[0].state(), STREAMS))
    except (ValueError, LookupError, TypeError, AttributeError, RuntimeError) as error:
        message = (
            f"{one.name}: {one.config.name} does not take the state that is stored: {type(error).__name__}: {error}"
        )
        raise ValueError(message) from error
    return made


def _known_spaces(content: AgentContent) -> Spaces:
    """As its learners know them, some of whom see parts whole. Agents of before hold only vectors of these there."""
    known, raw = content.spaces, content.raw_space
    if type(known.observation) is not spaces.Box or not isinstance(raw, spaces.Dict | spaces.Tuple):
        return known
    return known._replace(observation=FlattenedSpace(raw, known.observation))


def entry_of(content: AgentContent, observation: Any, info: Mapping[str, Any]) -> NDArray[Any]:
    """An observation as an environment gives it, as runs have it: an entry ``[1, …]`` of its own, in the form of the
    space (`apel.experience.channels.form_of`).

    It may be given as learners' views take it, too: as the vector that is made of its parts.

    Raises
    ------
    BorderError
        If it cannot be converted, as in a run, holds NaN, or a counted value that is none of the space's; but not the
        latter two where the environment is one whose observations need not lie in its space.
    """
    space = content.spaces.observation
    form = form_of(space)
    entry = np.zeros((1, *form.shape), dtype=form.dtype)
    form.write(_converted(content, observation, info), entry, 0)
    # Beyond the bounds of a Box may lie what an environment of Gymnasium's shows in a run, too: nobody checks these.
    if content.environment.observations == "check" and len(form.outside(entry, terminal=[True])):
        raise form.error_of(entry[0])
    return entry


def _converted(content: AgentContent, observation: Any, info: Mapping[str, Any]) -> Any:
    """What the layers around an environment make of its observation (`apel.environments.layers`)."""
    space, raw = content.spaces.observation, content.raw_space
    if isinstance(space, ChannelSpace):
        return _channels(space, observation, info)
    if isinstance(observation, np.ndarray) and observation.shape == space.shape:
        return observation
    if isinstance(space, JointSpace):
        return space.vector(observation)
    if raw is None or (isinstance(raw, spaces.Dict) and not isinstance(observation, Mapping)):
        return observation
    parts: Any = converter(raw)(observation)
    return spaces.flatten(raw, parts)


def _channels(space: ChannelSpace, observation: Any, info: Mapping[str, Any]) -> NDArray[Any]:
    """Signals that nobody has told are 0."""
    try:
        return space.entry(observation, {**dict.fromkeys(space.signals, 0.0), **info})
    except (KeyError, IndexError, TypeError) as error:
        message = f"found the observation {shown(observation)}, expected the channels {list(space)}: {in_a_line(error)}"
        raise BorderError(message) from error


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
