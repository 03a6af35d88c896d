"""What to build, as data: the parts of an experiment by name and options, before anything is made."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from pydantic import ConfigDict, Field
from pydantic.dataclasses import dataclass as checked_dataclass

from apel.experience.representations import Representation
from apel.experience.spaces import Spaces
from apel.run.floor import ActingFloor

Named = str | Callable[..., Any]
"""What makes something: its name, or, in a script, the class or function itself."""


def name_of(what: Named) -> str:
    """The name under which messages speak of it: of a class or function, its import path."""
    if isinstance(what, str):
        return what
    kind = what if hasattr(what, "__qualname__") else type(what)
    return f"{kind.__module__}:{kind.__qualname__}"


ObservationRule = Literal["check", "warn"]
"""What is done with an observation outside of its space: it ends its run; or it is told of, once a run."""


@dataclass(frozen=True)
class EnvironmentConfig:
    """An environment by Gymnasium id (``[module:][namespace/]Name-v0``; the module is imported first), by import path
    (``package.module:Name``), or by what makes it.

    Attributes
    ----------
    id:
        An import path stands for a class, or a function, that returns the environment when called with the options.
    run_seed:
        Name of the option that receives a seed drawn once per run, for environments that differ from run to run.
    max_episode_steps:
        Truncates episodes; None leaves it to the environment.
    observations:
        What is done with an observation outside of its space.
    """

    id: Named
    options: Mapping[str, Any] = field(default_factory=dict)
    run_seed: str | None = None
    max_episode_steps: int | None = None
    observations: ObservationRule = "check"

    @property
    def name(self) -> str:
        """Of the environment, in messages."""
        return name_of(self.id)


@checked_dataclass(frozen=True, config=ConfigDict(extra="forbid", allow_inf_nan=False))
class OwnShare:
    """A learner learns from everybody's episodes, and from its own more than from others'.

    Attributes
    ----------
    own_share:
        At least this share of every minibatch comes from episodes that it played itself, see
        `apel.learners.base.HasReplayMemory`.
    """

    own_share: float = Field(gt=0.0, le=1.0, strict=True)


LearnsFrom = Literal["all", "own"] | OwnShare
"""Whose episodes a learner learns from: everybody's (Algorithm 5); those alone that it played itself; or everybody's,
and a share of its own.
"""


@dataclass(frozen=True, eq=False)
class Start:
    """What a learner begins with: the state of another one that was trained (`apel.agents`).

    Two are equal if they come of the same learner of the same agent.

    Attributes
    ----------
    digest:
        Of the agent.
    learner:
        Its name there.
    kind:
        The name of its type.
    spaces:
        Of the environment in which it was trained.
    representations:
        What it saw of it, or, where it has members, each of them.
    state:
        See `apel.learners.Learner`.
    """

    digest: str
    learner: str
    kind: str
    spaces: Spaces
    representations: tuple[Representation, ...]
    state: dict[str, Any] = field(repr=False)

    @property
    def name(self) -> str:
        """For people."""
        return f"the learner {self.learner!r} of the agent {self.digest[:12]}"

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Start) and (self.digest, self.learner) == (other.digest, other.learner)

    def __hash__(self) -> int:
        return hash((self.digest, self.learner))


@dataclass(frozen=True)
class LearnerConfig:
    """A learner by registry key, import path, or class, with what it sees and its options.

    A learner that holds others, such as a vote, has ``members``; each of them sees the raw observation in its own way.

    Attributes
    ----------
    learns_from:
        Whose episodes it learns from. One that is not off-policy can be in an ensemble with ``own`` alone, and a share
        is for those with a replay memory.
    start:
        What it begins with, of what another one has learned; None for nothing.
    """

    type: Named
    options: Mapping[str, Any] = field(default_factory=dict)
    representation: Representation = field(default_factory=Representation)
    members: tuple[LearnerConfig, ...] = ()
    learns_from: LearnsFrom = "all"
    start: Start | None = None

    @property
    def name(self) -> str:
        """Of the kind of learner, in messages."""
        return name_of(self.type)


@dataclass(frozen=True)
class SelectorConfig:
    """A selector by registry key, import path, or class, with its options.

    Attributes
    ----------
    acting_floor:
        The least share of the steps that each learner plays, whatever the selector thinks; None leaves it to this.
    """

    type: Named
    options: Mapping[str, Any] = field(default_factory=dict)
    acting_floor: ActingFloor | None = None

    @property
    def name(self) -> str:
        """Of the kind of selector, in messages."""
        return name_of(self.type)
