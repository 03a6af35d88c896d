"""What an agent is made of, as data: configurations, the states of its learners, and where all that comes from."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from gymnasium import Space
from gymnasium.spaces import Discrete
from gymnasium.wrappers import FlattenObservation
from numpy.typing import NDArray
from pydantic import TypeAdapter, ValidationError

from apel.configs import EnvironmentConfig, LearnerConfig, LearnsFrom, SelectorConfig, Start, name_of
from apel.environments import World
from apel.experience.representations import Representation
from apel.experience.spaces import Spaces, spaces_of, spaces_tree
from apel.learners.base import State
from apel.numerics.state_trees import StateError, digest, pack, unpack

FORMAT = 1
"""To be raised whenever older agents cannot be read any more."""
BEST, SELECTOR = "best", "selector"
"""Who acts, beside the learners by their names."""

_REPRESENTATIONS: TypeAdapter[Representation] = TypeAdapter(Representation)
_LEARNS_FROM: TypeAdapter[LearnsFrom] = TypeAdapter(LearnsFrom)


@dataclass(frozen=True)
class TrainedLearner:
    """A learner of an agent: what it is, and its state (`apel.Learner.state`)."""

    name: str
    config: LearnerConfig
    state: State


class TrainedFloor(NamedTuple):
    """A floor under acting, and what it knows of the run; see `apel.run.floor`."""

    share: float
    """ρ."""
    played: NDArray[np.int64]
    """``int64[learners]``: environment steps that each learner played."""
    length: NDArray[np.float64]
    """``float64[learners + 1]``: mean lengths of their episodes, and of all."""
    stream: NDArray[np.uint64]

    def copy(self) -> TrainedFloor:
        """With arrays of its own, that can be written to."""
        return TrainedFloor(self.share, self.played.copy(), self.length.copy(), self.stream.copy())


@dataclass(frozen=True)
class TrainedSelector:
    """A selector, and its state for the coming episode; see `apel.run.selection`. Without a floor its word counts."""

    config: SelectorConfig
    row: NDArray[np.float64]
    stream: NDArray[np.uint64]
    floor: TrainedFloor | None = None


@dataclass(frozen=True)
class AgentContent:
    """All that an agent is.

    Attributes
    ----------
    environment:
        In which it was trained.
    spaces:
        Of that, as its learners know it.
    raw_space:
        What that environment itself says that its observations are, where it is made a vector for learners.
    acting:
        Who acts: ``best``, ``selector``, or the name of a learner.
    origin:
        Which run it comes from: ``experiment``, ``identity``, ``arm``, ``sweep``, ``run``, ``seed``, ``episodes``,
        ``steps``, as far as they are known.
    scores:
        By which the best learner is told, larger is better; and what they are (`score_name`).
    """

    environment: EnvironmentConfig
    spaces: Spaces
    learners: tuple[TrainedLearner, ...]
    selector: TrainedSelector
    raw_space: Space[Any] | None = None
    acting: str = BEST
    origin: Mapping[str, Any] = field(default_factory=dict)
    scores: tuple[float, ...] = ()
    score_name: str = ""

    @property
    def names(self) -> list[str]:
        """Of the learners."""
        return [learner.name for learner in self.learners]

    def start(self, name: str, content_digest: str) -> Start:
        """What a learner begins with that is to begin with this one."""
        learner = self.learners[self.names.index(name)]
        config = learner.config
        seen = tuple(member.representation for member in (config.members or (config,)))
        return Start(content_digest, name, config.name, self.spaces, seen, learner.state)


def raw_space_of(world: World) -> Space[Any] | None:
    """What `AgentContent.raw_space` is in such a world."""
    outer = world.environment
    return outer.env.observation_space if isinstance(outer, FlattenObservation) else None


def pack_agent(content: AgentContent) -> bytes:
    """The agent as the bytes of one ``npz`` file, which is the same for the same agent.

    Raises
    ------
    StateError
        If a learner's state, or an option, cannot be stored; the message names the place.
    """
    return pack(agent_tree(content))


def unpack_agent(stored: bytes) -> AgentContent:
    """What `pack_agent` was given; no code of the agent's is run.

    Raises
    ------
    StateError
        If the bytes are no agent of this version.
    """
    return content_of(unpack(stored))


def agent_digest(content: AgentContent) -> str:
    """What an agent is known by: it changes with everything but who acts and how the best one was told."""
    tree = agent_tree(content)
    return digest(pack({name: tree[name] for name in ("environment", "spaces", "learners", "selector", "origin")}))


def agent_tree(content: AgentContent) -> dict[str, Any]:
    """The agent as a state tree."""
    environment, selector = content.environment, content.selector
    learners = [
        {"name": one.name, "config": _config_tree(one.config), "state": dict(one.state)} for one in content.learners
    ]
    return {
        "format": FORMAT,
        "environment": {
            "id": name_of(environment.id),
            "options": dict(environment.options),
            "run_seed": environment.run_seed,
            "max_episode_steps": environment.max_episode_steps,
            "observations": environment.observations,
        },
        "spaces": spaces_tree(content.spaces),
        "raw_space": _raw_tree(content.raw_space),
        "learners": learners,
        "selector": {
            "type": selector.config.name,
            "options": dict(selector.config.options),
            "row": selector.row,
            "stream": selector.stream,
            # Most have none, so that the agents of before keep their digests.
            **({} if selector.floor is None else {"floor": selector.floor._asdict()}),
        },
        "acting": content.acting,
        "origin": dict(content.origin),
        "scores": list(content.scores),
        "score_name": content.score_name,
    }


def content_of(tree: Any) -> AgentContent:
    """What `agent_tree` was given.

    Raises
    ------
    StateError
        If the tree is no agent of this version.
    """
    if not isinstance(tree, dict) or "learners" not in tree:
        message = "found a state that is no agent, expected one that `apel export` or Agent.save wrote"
        raise StateError(message)
    if tree.get("format") != FORMAT:
        message = f"found an agent of the format {tree.get('format')!r}, expected {FORMAT}"
        raise StateError(message)
    try:
        selector, raw = tree["selector"], tree["raw_space"]
        learners = tuple(TrainedLearner(one["name"], _config(one["config"]), one["state"]) for one in tree["learners"])
        content = AgentContent(
            environment=EnvironmentConfig(**tree["environment"]),
            spaces=spaces_of(tree["spaces"]),
            learners=learners,
            selector=TrainedSelector(
                SelectorConfig(selector["type"], selector["options"]),
                selector["row"],
                selector["stream"],
                TrainedFloor(**selector["floor"]) if "floor" in selector else None,
            ),
            raw_space=None if raw is None else spaces_of(raw).observation,
            acting=tree["acting"],
            origin=tree["origin"],
            scores=tuple(tree["scores"]),
            score_name=tree["score_name"],
        )
    except (KeyError, TypeError, ValueError, IndexError, ValidationError) as error:
        message = f"found a damaged agent ({type(error).__name__}: {error}), expected one that this program wrote"
        raise StateError(message) from error
    if not learners or not all(isinstance(one.name, str) for one in learners):
        message = "found an agent without learners, expected at least one"
        raise StateError(message)
    return content


def _raw_tree(space: Space[Any] | None) -> dict[str, Any] | None:
    """None also of a space that cannot be stored: then whoever acts has to flatten observations."""
    if space is None:
        return None
    try:
        return spaces_tree(Spaces(space, Discrete(1), None))
    except StateError:
        return None


def _config_tree(config: LearnerConfig) -> dict[str, Any]:
    # What most learners do goes without saying, so that the agents of before keep their digests.
    learns_from = _LEARNS_FROM.dump_python(config.learns_from, mode="json")
    return {
        "type": config.name,
        "options": _plain(config.options),
        "representation": _REPRESENTATIONS.dump_python(config.representation, mode="json", exclude_defaults=True),
        "members": [_config_tree(member) for member in config.members],
        **({} if learns_from == "all" else {"learns_from": learns_from}),
    }


def _config(tree: Mapping[str, Any]) -> LearnerConfig:
    members = tuple(_config(member) for member in tree["members"])
    learns_from = _LEARNS_FROM.validate_python(tree.get("learns_from", "all"))
    return LearnerConfig(tree["type"], tree["options"], Representation(**tree["representation"]), members, learns_from)


def _plain(options: Any) -> Any:
    """Options of a script, in which classes stand for themselves, as a file would have them."""
    if isinstance(options, Mapping):
        return {str(name): _plain(value) for name, value in options.items()}
    if isinstance(options, Sequence) and not isinstance(options, str | bytes):
        return [_plain(value) for value in options]
    return name_of(options) if isinstance(options, type) else options
