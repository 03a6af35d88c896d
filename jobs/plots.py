"""What an experiment file may say of the figures that are drawn of its results."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

Metric = Literal["train_time", "adaptation_time", "steady_state"]
Theory = Literal["adaptation_formula", "adaptation_model", "performance_formula", "performance_model", "growth_formula"]
"""``…_formula`` is the dissertation's (Eq. 3.7, 3.11, 3.14), ``…_model`` the one that heeds selection."""


class _Figure(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    name: Annotated[str, Field(pattern=r"^[a-z0-9][a-z0-9_-]*$", max_length=60)]
    """Of its files below ``figures/``."""
    title: str = ""


class _Plot(_Figure):
    arms: list[str] = []
    """Only these, in this order; all where empty."""
    where: dict[str, list[Any]] = {}
    """Only rows with these values in these columns; rows without a value stay."""


class ArmPlot(_Plot):
    """One metric, arm by arm: means with intervals; histograms; the share of runs that are done by an episode."""

    kind: Literal["bars", "distributions", "survival"]
    metric: Metric = "train_time"


class LinePlot(_Plot):
    """One metric over an axis of the sweep, a line with its spread for each arm (and value of the other axes)."""

    kind: Literal["lines"]
    metric: Metric
    x: str
    x_scale: Literal["linear", "log", "symlog"] = "linear"
    y_scale: Literal["linear", "log"] = "linear"
    theory: list[Theory] = []


class CurvePlot(_Plot):
    """What happens from episode to episode: mean and spread over runs, one panel per quantity."""

    kind: Literal["curves"]
    panels: Annotated[list[Literal["return", "length", "concentration", "probability"]], Field(min_length=1)]
    """Concentration and probability have a line for each learner, return and length one for each arm."""
    switch_episode: int | None = None
    """Marked by a dashed line."""
    smooth: Annotated[int, Field(ge=1)] = 1
    """Recorded episodes of which a moving mean is drawn."""
    theory: list[Theory] = []


Plot = Annotated[ArmPlot | LinePlot | CurvePlot, Field(discriminator="kind")]


class Picture(_Figure):
    """A figure that needs no runs: of the theory (§3.5, §3.6), or of the mazes that runs are played in."""

    kind: Literal["growth", "adaptation", "design", "mazes"]
    decays: list[Annotated[float, Field(ge=0.0, lt=1.0)]] = []
    episodes: Annotated[int, Field(ge=1)] = 500
    count: Annotated[int, Field(ge=1)] = 6

    @model_validator(mode="after")
    def _has_decays(self) -> Picture:
        if self.kind != "mazes" and not self.decays:
            message = f"{self.kind}: found no decays, expected at least one"
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
        if isinstance(plot, LinePlot):
            _check_lines(place, plot, sweep)
        if isinstance(plot, CurvePlot):
            _check_curves(place, plot, len(plot.arms or arms))
    names = [plot.name for plot in plots]
    for number, name in enumerate(names):
        if name in names[:number]:
            message = f"plots.{number}.name: found {name!r} for a second time, expected a name of its own"
            raise ValueError(message)


def _check_lines(place: str, plot: LinePlot, sweep: Mapping[str, Any]) -> None:
    _expect(f"{place}.x", plot.x, sorted(sweep))
    paths = sweep[plot.x] if isinstance(sweep[plot.x], dict) else [plot.x]
    if plot.theory and not any(path.endswith(".decay") for path in paths):
        message = f"{place}.theory: found {plot.theory[0]} over {plot.x!r}, expected an axis of decays"
        raise ValueError(message)
    for theory in plot.theory:
        kind = "adaptation_" if plot.metric == "adaptation_time" else "performance_"
        if plot.metric == "train_time" or not theory.startswith(kind):
            message = f"{place}.theory: found {theory} for {plot.metric}, expected theory of what is drawn"
            raise ValueError(message)


def _check_curves(place: str, plot: CurvePlot, num_arms: int) -> None:
    for panel in plot.panels:
        if panel in ("concentration", "probability") and num_arms != 1:
            message = f"{place}.panels: found {panel} of {num_arms} arms, expected exactly one arm"
            raise ValueError(message)
    for theory in plot.theory:
        _expect(f"{place}.theory", theory, ["growth_formula"])


def _expect(place: str, name: str, known: Sequence[str]) -> None:
    if name not in known:
        message = f"{place}: found {name!r}, expected one of {list(known)}"
        raise ValueError(message)
