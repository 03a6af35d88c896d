"""What an experiment file may say of the figures that are drawn of its results."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

from apel.numerics.near_names import did_you_mean
from jobs.experiment.names import RUN_COLUMNS, Text
from jobs.experiment.yaml_schema import Plain

Metric = Literal["train_time", "adaptation_time", "steady_state"]
"""What is measured of every run: a column of the run rows."""
Theory = Literal["adaptation_formula", "adaptation_model", "performance_formula", "performance_model", "growth_formula"]
"""``…_formula`` is the dissertation's (Eq. 3.7, 3.11, 3.14), ``…_model`` the one that heeds selection."""


class _Figure(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, use_attribute_docstrings=True)

    name: Annotated[str, Field(pattern=r"^[a-z0-9][a-z0-9_-]*$", max_length=60)]
    """Name of its files below ``figures/``."""
    title: Text = ""
    """What stands above it."""


class _Plot(_Figure):
    arms: list[Text] = []
    """Only these, in this order; by default all."""
    where: dict[Text, list[Plain]] = {}
    """Only rows with these values in these columns; rows without a value stay."""


class ArmPlot(_Plot):
    """One metric, arm by arm: means with intervals; histograms; the share of runs that are done by an episode."""

    kind: Literal["bars", "distributions", "survival"]
    """Means with intervals, histograms, or the share of runs that are done by an episode."""
    metric: Metric = "train_time"
    """What is measured of every run."""


class LinePlot(_Plot):
    """One metric over an axis of the sweep, a line with its spread for each arm (and value of the other axes)."""

    kind: Literal["lines"]
    """A line for each arm."""
    metric: Metric
    """What is measured of every run."""
    x: Text
    """The axis of the sweep that is drawn from left to right."""
    x_scale: Literal["linear", "log", "symlog"] = "linear"
    """Scale of that axis; ``symlog`` is logarithmic, and shows 0."""
    y_scale: Literal["linear", "log"] = "linear"
    """Scale of the metric."""
    theory: list[Theory] = []
    """Predictions to draw beside it; ``adaptation_model`` only where the file states how long episodes are, see
    `jobs.analysis.adaptation_model`.
    """
    returns: tuple[float, float] | None = None
    """Returns of the best learner and of the other one, from which ``performance_formula`` is drawn, beside the
    measured ones.
    """


class SwitchRoles(BaseModel):
    """Which learner is better early and which late, by the arms that play each of them alone; see
    `jobs.analysis.switching.delay`.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, use_attribute_docstrings=True)

    early: Text
    """The arm that plays the learner which is better early."""
    late: Text
    """The arm that plays the learner which is better late."""
    window: Annotated[int, Field(ge=1)] = 100
    """Episodes over which returns are averaged and selections counted."""


class CurvePlot(_Plot):
    """What happens from episode to episode, or over environment steps: mean and spread over runs, one panel per
    quantity.
    """

    kind: Literal["curves"]
    """Curves over episodes or steps."""
    panels: Annotated[list[Literal["return", "length", "concentration", "probability"]], Field(min_length=1)]
    """A panel for each of these. Concentration and probability have a line for each learner, return and length one for
    each arm.
    """
    clock: Literal["episodes", "steps"] = "episodes"
    """What the axis counts. Over environment steps every episode must be recorded (``record: all``)."""
    learners_of: list[Text] = []
    """Arms whose learners are shown, a panel each, where several arms are drawn over steps."""
    switch: SwitchRoles | None = None
    """Over steps: mark where the learners alone cross and where ensembles of both switch, and tell the delay."""
    switch_episode: int | None = None
    """An episode to mark by a dashed line."""
    smooth: Annotated[int, Field(ge=1)] = 1
    """Number of recorded episodes in the moving mean that is drawn."""
    theory: list[Theory] = []
    """Predictions to draw beside it: ``growth_formula`` alone."""


Plot = Annotated[ArmPlot | LinePlot | CurvePlot, Field(discriminator="kind")]

TRAIN_TIMES: tuple[Plot, ...] = (
    ArmPlot(kind="bars", name="train_time"),
    ArmPlot(kind="distributions", name="train_time_distribution"),
)


class Picture(_Figure):
    """A figure that needs no runs: of the theory (§3.5, §3.6), or of the mazes that runs are played in."""

    kind: Literal["growth", "adaptation", "design", "mazes"]
    decays: list[Annotated[float, Field(ge=0.0, lt=1.0)]] = []
    shown_decay: Annotated[float, Field(gt=0.0, lt=1.0)] | None = None
    """Of ``growth`` and ``adaptation``: the decay whose selection probabilities are shown."""
    episodes: Annotated[int, Field(ge=1)] = 500
    count: Annotated[int, Field(ge=1)] = 6

    @model_validator(mode="after")
    def _has_decays(self) -> Picture:
        if self.kind != "mazes" and not self.decays:
            message = f"{self.kind}: found no decays, expected at least one"
            raise ValueError(message)
        if self.kind in ("growth", "adaptation") and self.shown_decay is None:
            message = f"{self.kind}: found no shown_decay, expected the decay whose selection probabilities are shown"
            raise ValueError(message)
        return self


def check_plots(
    plots: Sequence[ArmPlot | LinePlot | CurvePlot],
    arms: Collection[str],
    sweep: Mapping[str, Any],
    columns: Collection[str],
) -> None:
    """Refuse what could never be drawn.

    Parameters
    ----------
    plots:
        Of one experiment.
    arms:
        Its arms, and those of its hindsight.
    sweep:
        Its axes.
    columns:
        By which rows can be told apart: its axes and variables.

    Raises
    ------
    ValueError
        The message opens with the field to be changed.
    """
    for number, plot in enumerate(plots):
        place = f"plots.{number}"
        for arm in plot.arms:
            _expect(f"{place}.arms", arm, sorted(arms))
        for column in plot.where:
            _expect(f"{place}.where", column, sorted(columns))
            _expect_column(f"{place}.where", column)
        if isinstance(plot, LinePlot):
            _check_lines(place, plot, sweep)
        if isinstance(plot, CurvePlot):
            _check_curves(place, plot, plot.arms or list(arms))
    names = [plot.name for plot in plots]
    for number, name in enumerate(names):
        if name in names[:number]:
            message = f"plots.{number}.name: found {name!r} for a second time, expected a name of its own"
            raise ValueError(message)


def _check_lines(place: str, plot: LinePlot, sweep: Mapping[str, Any]) -> None:
    _expect(f"{place}.x", plot.x, sorted(sweep))
    _expect_column(f"{place}.x", plot.x)
    paths = sweep[plot.x] if isinstance(sweep[plot.x], dict) else [plot.x]
    if plot.theory and not any(path.endswith(".decay") for path in paths):
        message = f"{place}.theory: found {plot.theory[0]} over {plot.x!r}, expected an axis of decays"
        raise ValueError(message)
    for theory in plot.theory:
        kind = "adaptation_" if plot.metric == "adaptation_time" else "performance_"
        if plot.metric == "train_time" or not theory.startswith(kind):
            message = f"{place}.theory: found {theory} for {plot.metric}, expected theory of what is drawn"
            raise ValueError(message)


def _check_curves(place: str, plot: CurvePlot, arms: Sequence[str]) -> None:
    for arm in plot.learners_of:
        _expect(f"{place}.learners_of", arm, sorted(arms))
    for panel in plot.panels:
        if panel in ("concentration", "probability") and len(arms) != 1 and not plot.learners_of:
            message = f"{place}.panels: found {panel} of {len(arms)} arms, expected exactly one arm"
            raise ValueError(message)
    for theory in plot.theory:
        _expect(f"{place}.theory", theory, ["growth_formula"])
    _check_clock(place, plot)
    if plot.switch:
        _check_switch(f"{place}.switch", plot.switch, arms)


def _check_clock(place: str, plot: CurvePlot) -> None:
    of_steps = {"learners_of": plot.learners_of, "switch": plot.switch}
    of_episodes = {"switch_episode": plot.switch_episode is not None, "theory": plot.theory}
    wrong = of_episodes if plot.clock == "steps" else of_steps
    for field, value in wrong.items():
        if value:
            other = "episodes" if plot.clock == "steps" else "steps"
            message = f"{place}.{field}: found with clock: {plot.clock}, expected only with clock: {other}"
            raise ValueError(message)


def _check_switch(place: str, roles: SwitchRoles, arms: Sequence[str]) -> None:
    for role, arm in (("early", roles.early), ("late", roles.late)):
        _expect(f"{place}.{role}", arm, sorted(arms))
    if roles.early == roles.late:
        message = f"{place}.late: found {roles.late!r} in both roles, expected two different arms"
        raise ValueError(message)


def check_against_runs(
    plots: Sequence[ArmPlot | LinePlot | CurvePlot], learners: Mapping[str, Sequence[str]], *, records_all: bool
) -> None:
    """Refuse curves over steps whose episodes are not all recorded, and switches between what are no single learners.

    Parameters
    ----------
    plots:
        Of one experiment, which are valid by themselves.
    learners:
        Of each arm that is played.
    records_all:
        Whether every episode is recorded.

    Raises
    ------
    ValueError
        The message opens with the field to be changed.
    """
    for number, plot in enumerate(plots):
        if not isinstance(plot, CurvePlot):
            continue
        if plot.clock == "steps" and not records_all:
            message = (
                f"plots.{number}.clock: found steps where not every episode is recorded, expected record: all, "
                "or clock: episodes"
            )
            raise ValueError(message)
        if plot.switch:
            check_roles(f"plots.{number}.switch", plot.switch, learners)


def check_roles(place: str, roles: SwitchRoles, learners: Mapping[str, Sequence[str]]) -> None:
    """Refuse roles of arms that are not there, or are no single learner, or that no ensemble holds together.

    Raises
    ------
    ValueError
        The message opens with ``place``.
    """
    for role, arm in (("early", roles.early), ("late", roles.late)):
        _expect(f"{place}.{role}", arm, sorted(learners))
        if len(learners[arm]) != 1:
            message = f"{place}.{role}: found {arm!r} of {len(learners[arm])} learners, expected an arm of a single one"
            raise ValueError(message)
    both = {learners[roles.early][0], learners[roles.late][0]}
    if len(both) < 2 or not any(both <= set(names) for names in learners.values()):
        message = f"{place}: found no ensemble of {' and '.join(sorted(both))}, expected one with both learners"
        raise ValueError(message)


def _expect_column(place: str, axis: str) -> None:
    """An axis that is called as what a run came to, such as ``episodes``, has no column of its own."""
    if axis in RUN_COLUMNS:
        message = f"{place}: found {axis!r}, expected an axis with another name, such as cap: {{{axis}: [...]}}"
        raise ValueError(message)


def _expect(place: str, name: str, known: Sequence[str]) -> None:
    if name not in known:
        message = f"{place}: found {name!r}, expected one of {list(known)}{did_you_mean(name, known)}"
        raise ValueError(message)
