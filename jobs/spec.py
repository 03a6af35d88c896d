"""The experiment file: what may stand in it, and what it means."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from typing import Annotated, Any

import yaml
from pydantic import BaseModel, ConfigDict, Field, PrivateAttr, ValidationError, field_validator, model_validator

from apel.metrics import Criterion
from apel.representations import Representation
from cluster.shard import Recording
from jobs.plots import Picture, Plot, check_plots
from jobs.spec_errors import describe
from jobs.yaml_source import Source, SpecError

Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.+-]*$", max_length=80)]
Count = Annotated[int, Field(ge=1, strict=True)]


_NOT_SWEPT = {"name", "runs", "seed", "sweep", "arms", "hindsight", "plots"}
_NO_PART_OF_IDENTITY: dict[str, Any] = {
    **dict.fromkeys(("runs", "title", "figures", "hindsight", "plots"), True),
    "learners": {"__all__": {"num_gpus"}},
}
LABEL = "label"
"""In an axis of the sweep: no path, but what its places are called."""
_FORMAT = 2
"""To be raised whenever a default, or the meaning of a field, changes what an experiment gives."""


class _Model(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class _Open(BaseModel):
    """Fields that are not named here are options of what ``type`` names."""

    model_config = ConfigDict(extra="allow", frozen=True)

    @property
    def options(self) -> dict[str, Any]:
        """The options."""
        return dict(self.model_extra or {})


class EnvironmentSpec(_Model):
    """Which environment; see `apel.EnvironmentConfig`."""

    id: str
    options: dict[str, Any] = {}
    run_seed: str | None = None
    max_episode_steps: Count | None = None


class LearnerSpec(_Open):
    """A learner by registry key or import path, what it sees, its options; ``members`` are learners that it holds.

    ``num_gpus`` is the share of GPUs that its process gets; like all that says where to run it changes no result.
    """

    type: str
    representation: dict[str, Any] = {}
    members: list[Name] = []
    num_gpus: Annotated[float, Field(ge=0.0)] = 0.0


class SelectorSpec(_Open):
    """A selector by registry key or import path, and its options."""

    type: str


class ArmSpec(_Model):
    """One line in a figure: some learners (a list of names, or how many of each), and the selector of several."""

    learners: Annotated[list[Name] | dict[Name, Count], Field(min_length=1)]
    selector: SelectorSpec | None = None

    @property
    def learner_names(self) -> list[str]:
        """Every learner of the arm, in order; one that is there several times is named as often."""
        if isinstance(self.learners, list):
            return list(self.learners)
        return [name for name, count in self.learners.items() for _ in range(count)]

    @model_validator(mode="after")
    def _has_selector(self) -> ArmSpec:
        count = len(self.learner_names)
        if count > 1 and self.selector is None:
            message = f"found {count} learners and no selector, expected a selector that picks among them"
            raise ValueError(message)
        return self


class Gallery(_Model):
    """Figures that need no runs."""

    name: Name
    title: str = ""
    figures: list[str] = []
    seed: Annotated[int, Field(ge=0, strict=True)] = 1234
    environment: EnvironmentSpec | None = None
    pictures: Annotated[list[Picture], Field(min_length=1)]

    @model_validator(mode="after")
    def _has_environment(self) -> Gallery:
        if self.environment is None and any(picture.kind == "mazes" for picture in self.pictures):
            message = "found pictures of mazes and no environment, expected the environment that they are of"
            raise ValueError(message)
        return self


class Experiment(_Model):
    """An experiment: arms × sweep points × runs.

    Attributes
    ----------
    seed:
        From which the seeds of all runs follow (§4.1.4).
    runs:
        Number of runs; no part of the experiment's identity, so that more can be added later.
    episodes:
        Cap on the episodes of a run.
    steps:
        A run ends also with the episode in which its environment steps reach this number.
    variables:
        Values of which one is drawn uniformly per run; ``$name`` stands for it wherever an option may.
    sweep:
        Axes of a grid; every combination of their values is a sweep point, with the same run seeds as all others. An
        axis is a field's dotted path with its values, or a name with several paths whose values go together (and a
        ``label`` for each, where the first path's values say too little). An arm that an axis does not touch is played
        once, not once per value.
    stop_when_met:
        A run ends when the criterion holds.
    steady_state_episodes:
        Over how many episodes before the cap the mean return is taken as the steady state.
    hindsight:
        Arms that are not played: of each run, the best of the arms that they list.
    plots:
        The figures that are drawn of the results.
    """

    name: Name
    title: str = ""
    figures: list[str] = []
    seed: Annotated[int, Field(ge=0, strict=True)] = 1234
    runs: Count = 100
    episodes: Count
    steps: Count | None = None
    environment: EnvironmentSpec
    variables: dict[Name, Annotated[list[Any], Field(min_length=1)]] = {}
    learners: Annotated[dict[Name, LearnerSpec], Field(min_length=1)]
    arms: Annotated[dict[Name, ArmSpec], Field(min_length=1)]
    sweep: dict[str, Annotated[list[Any] | dict[str, list[Any]], Field(min_length=1)]] = {}
    performance: str = "return"
    criterion: Criterion | None = None
    stop_when_met: bool = True
    steady_state_episodes: Count | None = None
    hindsight: dict[Name, Annotated[list[Name], Field(min_length=1)]] = {}
    record: Recording = "log"
    plots: list[Plot] = []
    _source: Source | None = PrivateAttr(default=None)

    @field_validator("sweep")
    @classmethod
    def _sweepable(cls, sweep: dict[str, Any]) -> dict[str, Any]:
        for axis, values in sweep.items():
            columns = {axis: values} if isinstance(values, list) else values
            for path in set(columns) - {LABEL}:
                if path.split(".")[0] in _NOT_SWEPT and not path.startswith("arms."):
                    message = f"found the path {path!r}, expected a field that may differ between sweep points"
                    raise ValueError(message)
            lengths = [len(column) for column in columns.values()]
            labels = list(map(str, columns.get(LABEL) or next(iter(columns.values()))))
            if len(set(lengths)) != 1 or not lengths[0]:
                message = f"{axis}: found {lengths} values, expected equally many, and at least one"
                raise ValueError(message)
            if len(set(labels)) != len(labels):
                message = f"{axis}: found {labels} as labels, expected the values of its first path to differ"
                raise ValueError(message)
        return sweep

    @model_validator(mode="after")
    def _enough_episodes(self) -> Experiment:
        if self.steady_state_episodes and self.steps:
            message = "steady_state_episodes: found it beside steps, expected a number of episodes that all runs play"
            raise ValueError(message)
        if (self.steady_state_episodes or 0) > self.episodes:
            found = f"found {self.steady_state_episodes}, expected at most the {self.episodes} episodes of a run"
            message = f"steady_state_episodes: {found}"
            raise ValueError(message)
        return self

    @model_validator(mode="after")
    def _known_names(self) -> Experiment:
        for arm, spec in self.arms.items():
            self._expect_known(f"arms.{arm}.learners", spec.learner_names, self.learners)
        for name, learner in self.learners.items():
            self._expect_known(f"learners.{name}.members", learner.members, self.learners)
            for member in learner.members:
                if self.learners[member].members:
                    message = f"learners.{name}.members: found {member!r}, expected learners without members"
                    raise ValueError(message)
        for arm, sources in self.hindsight.items():
            self._expect_known(f"hindsight.{arm}", sources, self.arms)
            if arm in self.arms:
                message = f"hindsight.{arm}: found the name of an arm that is played, expected another one"
                raise ValueError(message)
        return self

    @model_validator(mode="after")
    def _drawable(self) -> Experiment:
        check_plots(self.plots, [*self.arms, *self.hindsight], self.sweep, {*self.sweep, *self.variables})
        return self

    def _expect_known(self, place: str, names: Sequence[str], known: Mapping[str, Any]) -> None:
        for name in names:
            if name not in known:
                message = f"{place}: found {name!r}, expected one of {sorted(known)}"
                raise ValueError(message)

    @property
    def identity(self) -> str:
        """Twelve hexadecimal digits that change with everything that changes a row; the number of runs does not.

        Fields at their defaults do not count, so that a field that is added later changes no identity. The order of
        fields counts only where it means something.
        """
        content = self.model_dump(mode="json", exclude=_NO_PART_OF_IDENTITY, exclude_defaults=True)
        content["format"] = _FORMAT
        if orders := self._meaningful_orders():
            content["order"] = orders
        return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:12]

    def _meaningful_orders(self) -> dict[str, list[str]]:
        """Orders of names on which streams and labels depend, and which sorted keys would forget."""
        orders = {"variables": list(self.variables), "sweep": list(self.sweep)}
        orders |= {f"sweep.{axis}": list(paths) for axis, paths in self.sweep.items() if isinstance(paths, dict)}
        orders |= {
            f"arms.{arm}": list(spec.learners) for arm, spec in self.arms.items() if isinstance(spec.learners, dict)
        }
        return {place: names for place, names in orders.items() if len(names) > 1}

    def where(self, *place: str) -> str:
        """``file:line: field`` of one of its fields, as errors name it."""
        path = ".".join(place)
        return f"{self._source.where(place)}: {path}" if self._source else path

    def to_yaml(self) -> str:
        """The experiment as a file."""
        return yaml.safe_dump(self.model_dump(mode="json", exclude_none=True), sort_keys=False, allow_unicode=True)


def validate(source: Source) -> Experiment:
    """The experiment of a parsed document.

    Raises
    ------
    SpecError
        If it is not valid; one line per error.
    """
    try:
        experiment = Experiment.model_validate(source.content)
    except ValidationError as error:
        raise SpecError(describe(source, error)) from error
    experiment._source = source
    return experiment


def set_path(content: dict[str, Any], path: str, value: Any) -> None:
    """Set a field by its dotted path (``arms.APEL.selector.decay``); list positions are numbers.

    Raises
    ------
    KeyError
        If the path leads through something that has no fields.
    """
    *parents, last = path.split(".")
    node: Any = content
    for part in parents:
        if isinstance(node, list) and part.isdigit() and int(part) < len(node):
            node = node[int(part)]
        elif isinstance(node, dict):
            node = node.setdefault(part, {})
        else:
            message = f"{path}: found {type(node).__name__} before {part!r}, expected a mapping"
            raise KeyError(message)
    if isinstance(node, list) and last.isdigit() and int(last) < len(node):
        node[int(last)] = value
    elif isinstance(node, dict):
        node[last] = value
    else:
        message = f"{path}: found {type(node).__name__} before {last!r}, expected a mapping"
        raise KeyError(message)


def representation_of(spec: LearnerSpec, substituted: Mapping[str, Any]) -> Representation:
    """The representation of a learner after its variables were filled in.

    Raises
    ------
    ValueError
        If it is not valid.
    """
    try:
        return Representation(**substituted)
    except (ValidationError, TypeError) as error:
        found = error.errors()[0] if isinstance(error, ValidationError) else None
        detail = f"{'.'.join(map(str, found['loc']))}: {found['msg']}" if found else str(error)
        message = f"{spec.type}: representation: {detail}"
        raise ValueError(message) from error
