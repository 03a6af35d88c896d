"""The parts of an experiment file: its environment, its learners, its arms with their selectors."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, ValidationInfo, field_validator, model_validator

from apel.configs import LearnsFrom, ObservationRule
from apel.run.floor import ActingFloor
from jobs.experiment.limits import MAX_LEARNERS, Copies, Steps
from jobs.experiment.names import Name, Text
from jobs.experiment.yaml_schema import Plain

STRICT = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)
"""Of mappings whose fields are all known."""


class Open(BaseModel):
    """Fields that are not named here are options of what ``type`` names."""

    model_config = ConfigDict(extra="allow", frozen=True, allow_inf_nan=False)
    __pydantic_extra__: dict[str, Plain] = Field(init=False)

    @property
    def options(self) -> dict[str, Any]:
        """The options."""
        return dict(self.model_extra or {})


class EnvironmentSpec(BaseModel):
    """Which environment; see `apel.EnvironmentConfig`.

    Attributes
    ----------
    id:
        A Gymnasium id, or an import path ``module:Name`` of a class or a function that makes one.
    options:
        Keyword arguments with which it is made.
    run_seed:
        The option that gets the run's seed, so that each run has an environment of its own; by default none does.
    max_episode_steps:
        Truncates episodes after this many steps; by default the environment alone ends them.
    observations:
        What happens if an observation lies outside the space: ``check`` ends the run, ``warn`` says so once per run.
    """

    model_config = STRICT

    id: Text
    options: dict[str, Plain] = {}
    run_seed: Text | None = None
    max_episode_steps: Steps | None = None
    observations: ObservationRule = "check"

    @field_validator("run_seed")
    @classmethod
    def _alone(cls, run_seed: str | None, info: ValidationInfo) -> str | None:
        if run_seed in info.data.get("options", {}):
            message = f"found {run_seed!r}, which options sets too, expected one of them"
            raise ValueError(message)
        return run_seed


class LearnerSpec(Open):
    """A learner by registry key or import path, what it sees, and its options.

    Attributes
    ----------
    type:
        A shipped learner, or the import path ``module:Class`` of another one.
    representation:
        What it sees of a step.
    members:
        Learners that it holds, such as those that vote.
    learns_from:
        Whose episodes it learns from: ``all``, its ``own`` alone, or all with a share of its own in every minibatch.
    start_from:
        The folder of an exported agent, with whose learner it begins.
    num_gpus:
        The share of GPUs that its process gets; like everything about where to run, it changes no result.
    """

    type: Text
    representation: dict[str, Plain] = {}
    members: Annotated[list[Name], Field(max_length=MAX_LEARNERS)] = []
    learns_from: LearnsFrom = "all"
    start_from: Text | None = None
    num_gpus: Annotated[float, Field(ge=0.0, le=1000.0)] = 0.0


class SelectorSpec(Open):
    """A selector by registry key or import path, and its options.

    Attributes
    ----------
    type:
        A shipped selector, or the import path ``module:Class`` of another one.
    acting_floor:
        How much each learner plays at least, whatever the selector says.
    """

    type: Text
    acting_floor: ActingFloor | None = None


class ArmSpec(BaseModel):
    """What is compared, and one line in a figure: one learner, or several with a selector.

    Attributes
    ----------
    learners:
        Their names as a list, or how many there are of each.
    selector:
        Who picks among several.
    start_from:
        The folder of an exported agent: each learner begins with the one of its name there.
    """

    model_config = STRICT

    learners: Annotated[list[Name] | dict[Name, Copies], Field(min_length=1, max_length=MAX_LEARNERS)]
    selector: SelectorSpec | None = None
    start_from: Text | None = None

    @property
    def learner_names(self) -> list[str]:
        """Every learner of the arm, in order; one that is there several times is named as often."""
        if isinstance(self.learners, list):
            return list(self.learners)
        return [name for name, count in self.learners.items() for _ in range(count)]

    @model_validator(mode="after")
    def _has_selector(self) -> ArmSpec:
        count = len(self.learners) if isinstance(self.learners, list) else sum(self.learners.values())
        if count > MAX_LEARNERS:
            message = f"found {count:,} learners, expected at most {MAX_LEARNERS:,}"
            raise ValueError(message)
        if count > 1 and self.selector is None:
            message = f"found {count} learners and no selector, expected a selector that picks among them"
            raise ValueError(message)
        return self
