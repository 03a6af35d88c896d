"""What to build, as data: the parts of an experiment by name and options, before anything is made."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from apel.representations import Representation


@dataclass(frozen=True)
class EnvironmentConfig:
    """An environment by Gymnasium id, or by import path (``package.module:Name``).

    Attributes
    ----------
    run_seed:
        Name of the option that receives a seed drawn once per run, for environments that differ from run to run.
    max_episode_steps:
        Truncates episodes; None leaves it to the environment.
    """

    id: str
    options: Mapping[str, Any] = field(default_factory=dict)
    run_seed: str | None = None
    max_episode_steps: int | None = None


@dataclass(frozen=True)
class LearnerConfig:
    """A learner by registry key or import path, with what it sees and its options.

    A learner that holds others, such as a vote, has ``members``; each of them sees the raw observation in its own way.
    """

    type: str
    options: Mapping[str, Any] = field(default_factory=dict)
    representation: Representation = field(default_factory=Representation)
    members: tuple[LearnerConfig, ...] = ()


@dataclass(frozen=True)
class SelectorConfig:
    """A selector by registry key or import path, with its options."""

    type: str
    options: Mapping[str, Any] = field(default_factory=dict)
