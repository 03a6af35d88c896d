"""What is to be played, as data: a shard is some runs of one arm at one sweep point."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import ConfigDict, Field
from pydantic.dataclasses import dataclass as checked_dataclass

from apel.configs import EnvironmentConfig, LearnerConfig, Named, SelectorConfig
from apel.run.criterion import Criterion

_LOG_STEPS = (1.0, 1.2, 1.4, 1.7, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0)


@checked_dataclass(frozen=True, config=ConfigDict(extra="forbid"))
class Every:
    """Record every n-th episode, from 0 on."""

    every: int = Field(ge=1)


RecordingRule = Literal["all", "log", "none"] | Every
"""Which episodes get a row: all; log-spaced ones (thirteen a decade); none; every n-th."""


@checked_dataclass(frozen=True, config=ConfigDict(extra="forbid"))
class EverySteps:
    """Keep a run's model with the episode in which its steps reach a multiple of ``every_steps``, and at its end."""

    every_steps: int = Field(ge=1)


ModelRule = Literal["none", "final"] | EverySteps
"""Which models of a run are kept: none; that of its end; those on the way too."""


def recorded_episodes(recording: RecordingRule, num_episodes: int) -> NDArray[np.bool_]:
    """``bool[episodes]``: which episodes get a row.

    >>> np.flatnonzero(recorded_episodes("log", 40)).tolist()
    [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 12, 14, 17, 20, 25, 30]
    """
    mask = np.zeros(num_episodes, dtype=np.bool_)
    match recording:
        case Every(every):
            mask[::every] = True
        case "all":
            mask[:] = True
        case "log":
            decades = 10.0 ** np.arange(len(str(num_episodes)))
            episodes = np.outer(decades, _LOG_STEPS).round().astype(np.int64).ravel()
            mask[episodes[episodes < num_episodes]] = True
            mask[0] = True
    return mask


@dataclass(frozen=True)
class RunPlan:
    """One run: its seed, and what is to be built in it.

    Attributes
    ----------
    index:
        Its number in the experiment, from 0.
    variables:
        What was drawn for it, such as the feature that a learner does not see.
    learners:
        One configuration per learner of the arm.
    """

    index: int
    seed: int
    environment: EnvironmentConfig
    learners: tuple[LearnerConfig, ...]
    variables: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class ArmPlan:
    """What all runs of an arm at one sweep point share."""

    experiment: str
    arm: str
    sweep: str
    learner_names: tuple[str, ...]
    selector: SelectorConfig
    performance: Named
    num_episodes: int
    num_steps: int | None = None
    """A run ends also with the episode in which its steps reach this number."""
    criterion: Criterion | None = None
    stops_when_met: bool = True
    steady_state_episodes: int = 0
    """The steady state is the mean return of so many episodes before the cap; 0 where nobody asks for it."""
    recording: RecordingRule = "none"
    models: ModelRule = "none"
    """Which trained learners are kept beside the rows."""
    sweep_values: Mapping[str, Any] = field(default_factory=dict)
    """What the sweep point stands for, by the name of each axis."""
    learner_gpus: tuple[float, ...] = ()
    """The share of GPUs that each learner's process gets; empty where none gets any."""
    identity: str = ""
    """Of the experiment: it changes with everything that changes a row."""


@dataclass(frozen=True)
class Shard:
    """Some runs of one arm, played side by side."""

    arm: ArmPlan
    runs: tuple[RunPlan, ...]

    @property
    def key(self) -> tuple[str, str, int]:
        """Arm, sweep point and first run: no two shards of a job have the same."""
        return self.arm.arm, self.arm.sweep, self.runs[0].index

    @property
    def pause_every(self) -> int:
        """See `apel.run.state.Book`."""
        return self.arm.models.every_steps if isinstance(self.arm.models, EverySteps) else 0

    @property
    def label(self) -> str:
        """For people: ``APEL · runs 0-49``."""
        sweep = f" [{self.arm.sweep}]" if self.arm.sweep else ""
        return f"{self.arm.arm}{sweep} · runs {self.runs[0].index}-{self.runs[-1].index}"

    @property
    def binding(self) -> dict[str, str]:
        """What any stored state of this very shard says of itself."""
        runs = json.dumps([[run.index, run.seed] for run in self.runs])
        return {
            "identity": self.arm.identity,
            "arm": self.arm.arm,
            "sweep point": self.arm.sweep,
            "runs": f"{self.runs[0].index}-{self.runs[-1].index}" if self.runs else "",
            "seeds": hashlib.sha256(runs.encode()).hexdigest()[:16],
        }

    def only(self, positions: Sequence[int]) -> Self:
        """The shard of the runs at some positions, in their order."""
        return replace(self, runs=tuple(self.runs[i] for i in positions))

    def without(self, positions: Sequence[int]) -> Self:
        """The shard without the runs at some positions."""
        return replace(self, runs=tuple(run for i, run in enumerate(self.runs) if i not in set(positions)))


@dataclass(frozen=True)
class Execution:
    """How to play, none of which changes a result.

    Attributes
    ----------
    streak_episodes:
        Episodes that a learner's host plays of one run before it reports back.
    streak_steps:
        Environment steps per host and round; bounds the size of a message.
    checkpoint_seconds:
        Time between two checkpoints of a shard.
    checkpoint_episodes:
        A checkpoint also after so many episodes, over all runs of the shard; None: by time alone.
    checkpoint_share:
        Largest share of a shard's time that checkpoints may take: after a costly one the next comes later.
    round_seconds:
        How long a host may play before it reports back; bounds how long a stop, or a checkpoint, has to wait.
    progress_seconds:
        Least time between two reports of its progress.
    raises:
        What users' code raises is raised, and not only told of: for a debugger.
    """

    streak_episodes: int = 200
    streak_steps: int = 1_000_000
    checkpoint_seconds: float = 30.0
    checkpoint_episodes: int | None = None
    checkpoint_share: float = 0.05
    round_seconds: float = 2.0
    progress_seconds: float = 0.25
    raises: bool = False
