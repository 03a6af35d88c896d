"""The experiment file: what may stand in it, and what it means."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from typing import Annotated, Any

from pydantic import BaseModel, Field, PrivateAttr, ValidationError, field_validator, model_validator

from apel.configs import Named
from apel.experience.representations import Representation
from apel.numerics.near_names import did_you_mean
from apel.run.criterion import Criterion
from cluster.shard import ModelRule, RecordingRule
from jobs.experiment.axes import axis_columns, check_axis
from jobs.experiment.figures import TRAIN_TIMES, Picture, Plot, check_plots
from jobs.experiment.limits import MAX_LEARNERS, Episodes, Runs, Seed, Steps, check_sizes, num_values
from jobs.experiment.names import Name, Text, check_arms, check_columns
from jobs.experiment.spec_errors import describe, expectation
from jobs.experiment.spec_parts import STRICT, ArmSpec, EnvironmentSpec, LearnerSpec
from jobs.experiment.swept_values import axis_labels, swept_orders
from jobs.experiment.yaml_schema import Plain, to_yaml
from jobs.experiment.yaml_source import Source, SpecError

_NO_PART_OF_IDENTITY: dict[str, Any] = {
    **dict.fromkeys(("runs", "title", "figures", "hindsight", "plots", "models", "agents"), True),
    "learners": {"__all__": {"num_gpus", "start_from"}},
    "arms": {"__all__": {"start_from"}},
}
_FORMAT = 2
"""To be raised whenever a default, or the meaning of a field, changes what an experiment gives."""


class Gallery(BaseModel):
    """Figures that need no runs."""

    model_config = STRICT

    name: Name
    title: Text = ""
    figures: list[Text] = []
    seed: Seed = 1234
    environment: EnvironmentSpec | None = None
    pictures: Annotated[list[Picture], Field(min_length=1)]

    @model_validator(mode="after")
    def _has_environment(self) -> Gallery:
        if self.environment is None and any(picture.kind == "mazes" for picture in self.pictures):
            message = "found pictures of mazes and no environment, expected the environment that they are of"
            raise ValueError(message)
        return self


class Experiment(BaseModel):
    """An experiment: arms × sweep points × runs.

    Attributes
    ----------
    name:
        Its name, and that of its folder of results.
    title:
        What tables and reports call it.
    figures:
        Numbers of the dissertation's figures that it reproduces.
    seed:
        From which the seeds of all runs follow (§4.1.4).
    runs:
        Number of runs; no part of the experiment's identity, so that more can be added later.
    episodes:
        Cap on the episodes of a run.
    steps:
        A run ends also with the episode in which its environment steps reach this number.
    environment:
        The task.
    variables:
        Values of which one is drawn uniformly per run; ``$name`` stands for it wherever an option may.
    learners:
        The learners by name; arms refer to them.
    arms:
        What is compared, by name: learners alone, and ensembles.
    sweep:
        Axes of a grid; every combination of their values is a sweep point, with the same run seeds as all others. An
        axis is a field's dotted path with its values, or a name with several paths whose values go together (and a
        ``label`` for each, where the first path's values say too little). An arm that an axis does not touch is played
        once, not once per value.
    performance:
        What selectors compare, of a whole episode; larger is better.
    criterion:
        When a run counts as trained; without one, every run plays all its episodes or steps.
    stop_when_met:
        A run ends when the criterion holds.
    steady_state_episodes:
        Over how many episodes before the cap the mean return is taken as the steady state.
    hindsight:
        Arms that are not played: of each run, the best of the arms that they list.
    record:
        Which episodes get a row: ``all``, ever fewer (``log``: thirteen per tenfold), every n-th, or ``none``.
    models:
        Which trained learners are kept with the results: ``none``, ``final``, or ``{every_steps: N}`` and the final
        ones; no part of the identity.
    plots:
        The figures that are drawn of the results.
    sources:
        Digests of the users' files that it rests on (`jobs.experiment.user_modules`), and of the classes and functions
        that a script holds (`jobs.script.code_digests`): filled in where it is loaded to be run, and kept with its
        results.
    agents:
        Digests of the agents in the folders that ``start_from`` names; filled in likewise (`jobs.experiment.starts`).
    """

    model_config = STRICT

    name: Name
    title: Text = ""
    figures: list[Text] = []
    seed: Seed = 1234
    runs: Runs = 100
    episodes: Episodes
    steps: Steps | None = None
    environment: EnvironmentSpec
    variables: dict[Name, Annotated[list[Plain], Field(min_length=1)]] = {}
    learners: Annotated[dict[Name, LearnerSpec], Field(min_length=1, max_length=MAX_LEARNERS)]
    arms: Annotated[dict[Name, ArmSpec], Field(min_length=1)]
    sweep: dict[Text, Annotated[list[Plain] | dict[Text, list[Plain]], Field(min_length=1)]] = {}
    performance: Text = "return"
    criterion: Criterion | None = None
    stop_when_met: bool = True
    steady_state_episodes: Episodes | None = None
    hindsight: dict[Name, Annotated[list[Name], Field(min_length=1)]] = {}
    record: RecordingRule = "log"
    models: ModelRule = "none"
    plots: list[Plot] = []
    sources: dict[str, str] = {}
    agents: dict[str, str] = {}
    _source: Source | None = PrivateAttr(default=None)
    _parts: Mapping[str, Named] = PrivateAttr(default_factory=dict)

    @field_validator("sweep")
    @classmethod
    def _sweepable(cls, sweep: dict[str, Any]) -> dict[str, Any]:
        for axis, values in sweep.items():
            columns = axis_columns(axis, values)
            check_axis(axis, columns, axis_labels(columns))
            for path in columns:
                if path.endswith(".start_from"):
                    message = f"found {path!r}, expected an arm for each agent to begin with"
                    raise ValueError(message)
        return sweep

    @model_validator(mode="after")
    def _bounded(self) -> Experiment:
        content = self.model_dump(exclude={"sweep", "plots", "hindsight"}) if self.sweep else {}
        check_sizes(self.arms, self.runs, self.sweep, num_values(content))
        check_arms(self.arms)
        check_columns(self.variables, self.sweep)
        return self

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
                message = f"{place}: found {name!r}, expected one of {sorted(known)}{did_you_mean(name, known)}"
                raise ValueError(message)

    @property
    def identity(self) -> str:
        """Twelve hexadecimal digits that change with everything that changes a row; the number of runs does not.

        Fields at their defaults do not count, so that a field that is added later changes no identity. The order of
        fields counts only where it means something.
        """
        content = self.model_dump(exclude=_NO_PART_OF_IDENTITY, exclude_defaults=True)
        content["format"] = _FORMAT
        if starts := self._starts():
            content["starts"] = starts
        if orders := self._meaningful_orders():
            content["order"] = orders
        if orders := swept_orders(self.sweep):
            content["swept_order"] = orders
        return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:12]

    @property
    def drawn_plots(self) -> list[Plot]:
        """Its plots or, where it names none and has a criterion, its train times."""
        return self.plots or (list(TRAIN_TIMES) if self.criterion else [])

    def _starts(self) -> dict[str, str]:
        """What learners and arms begin with: agents by what they are, not by where they lie."""
        paths = {f"learners.{name}": learner.start_from for name, learner in self.learners.items()}
        paths |= {f"arms.{name}": arm.start_from for name, arm in self.arms.items()}
        started = {place: path for place, path in paths.items() if path is not None}
        return {place: self.agents.get(path, path) for place, path in started.items()}

    def _meaningful_orders(self) -> dict[str, list[str]]:
        """Orders of names on which streams and labels depend, and which sorted keys would forget."""
        orders = {"variables": list(self.variables), "sweep": list(self.sweep)}
        orders |= {f"sweep.{axis}": list(paths) for axis, paths in self.sweep.items() if isinstance(paths, dict)}
        orders |= {
            f"arms.{arm}": list(spec.learners) for arm, spec in self.arms.items() if isinstance(spec.learners, dict)
        }
        return {place: names for place, names in orders.items() if len(names) > 1}

    def made_by(self, name: str) -> Named:
        """What stands for a name: the class or function that a script has given it, or else the name itself."""
        return self._parts.get(name, name)

    def where(self, *place: str) -> str:
        """``file:line: field`` of one of its fields, as errors name it."""
        path = ".".join(place)
        return f"{self._source.where(place)}: {path}" if self._source else path

    def content(self) -> dict[str, Any]:
        """The experiment as the content of a file, made of copies. What nobody has set is left out where it is null; a
        null that is an option, or a value, is one.
        """
        content = self.model_dump()
        for learner in content["learners"].values():
            if learner["start_from"] is None:
                del learner["start_from"]
        arms, plots, criterion = content["arms"].values(), content["plots"], content["criterion"]
        for fields in (content, content["environment"], *arms, *plots, *([criterion] if criterion else [])):
            for name in [name for name, value in fields.items() if value is None]:
                del fields[name]
        for name in [name for name in ("sources", "agents") if not content[name]]:
            del content[name]
        return content

    def to_yaml(self) -> str:
        """The experiment as a file."""
        return to_yaml(self.content())


def validate(source: Source, parts: Mapping[str, Named] | None = None) -> Experiment:
    """The experiment of a parsed document; ``parts`` are classes and functions of a script by the names used there.

    Raises
    ------
    SpecError
        If it is not valid; one line per error.
    """
    try:
        experiment = Experiment.model_validate(source.content)
    except ValidationError as error:
        raise SpecError(describe(source, error, Experiment)) from error
    experiment._source, experiment._parts = source, parts or {}
    return experiment


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
        detail = f"{'.'.join(map(str, found['loc']))}: {expectation(found, Representation)}" if found else str(error)
        message = f"{spec.type}: representation: {detail}"
        raise ValueError(message) from error
