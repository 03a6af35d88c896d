"""One metric over an axis of the sweep (Figures 4.11, 4.13 to 4.15, 4.20), with what theory says."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from jobs.analysis.plotting import style, theory_overlays
from jobs.analysis.plotting.samples import NAMES, Sample, count_of_runs, sample, selected
from jobs.analysis.statistics.bootstrap import Floats
from jobs.experiment.figures import LinePlot
from jobs.experiment.spec import Experiment

_MOST_IN_A_PANEL = 6
_MOST_NAMED_TICKS = 10


@dataclass(frozen=True)
class _Series:
    """A line: an arm, with one value on each other axis."""

    arm: str
    variant: str
    places: Floats | None
    """Along the axis; None for an arm that it does not touch, which is drawn level."""
    samples: list[Sample]

    @property
    def label(self) -> str:
        return f"{self.arm}, {self.variant}" if self.variant else self.arm


def draw(plt: Any, runs: Any, plot: LinePlot, experiment: Experiment) -> Any:
    """The figure; None where no run has the metric."""
    frame = selected(runs, plot, experiment)
    frame = frame[frame[plot.metric].notna()]
    if plot.x not in frame or frame[plot.x].isna().all():
        return None
    frame = _with_nulls_named(frame, plot.x)
    names = _names(frame[plot.x])
    series = _series(frame, plot, experiment, names)
    variants = list(dict.fromkeys(one.variant for one in series))
    is_split = len(series) > _MOST_IN_A_PANEL and len({one.arm for one in series}) > 1 and len(variants) > 1
    panels = [[one for one in series if one.variant == variant] for variant in variants] if is_split else [series]
    width = 6.6 if len(panels) == 1 else 3.4 * len(panels)
    figure, all_axes = plt.subplots(1, len(panels), figsize=(width, 4.5), sharex=True, sharey=True, squeeze=False)
    for axes, panel in zip(all_axes[0], panels, strict=True):
        _panel(axes, panel, plot, experiment, names, is_split=is_split)
    all_axes[0, 0].set_ylabel(NAMES[plot.metric])
    if not names:
        theory_overlays.draw(all_axes[0], runs, frame, plot, experiment)
    _finish(figure, all_axes[0], series, plot, experiment)
    return figure


def _with_nulls_named(frame: Any, axis: str) -> Any:
    """Null among the values of an arm that the axis touches is one of them, and has a name, as all have then."""
    is_touched = frame.groupby("arm")[axis].transform("count") > 0
    if not (is_touched & frame[axis].isna()).any():
        return frame
    # A column with nulls holds whole numbers as floats.
    names = frame[axis].convert_dtypes().map(_name)
    return frame.assign(**{axis: names.where(is_touched, None)})


def _name(value: Any) -> str:
    return "None" if pd.isna(value) else str(value)


def _names(column: Any) -> list[str] | None:
    """What places are called on an axis that has no numbers."""
    known = column.dropna()
    return list(dict.fromkeys(map(str, known))) if pd.to_numeric(known, errors="coerce").isna().any() else None


def _series(frame: Any, plot: LinePlot, experiment: Experiment, names: list[str] | None) -> list[_Series]:
    others = [axis for axis in experiment.sweep if axis != plot.x and axis in frame]
    found = []
    for arm, rows in frame.groupby("arm", sort=False):
        varied = [axis for axis in others if rows[axis].nunique(dropna=False) > 1]
        groups = rows.groupby(varied, sort=False, dropna=False) if varied else [((), rows)]
        for values, group in groups:
            variant = ", ".join(f"{_short(axis)} = {_name(value)}" for axis, value in zip(varied, values, strict=True))
            found.append(_one_series(str(arm), variant, group, plot, names))
    return found


def _one_series(arm: str, variant: str, rows: Any, plot: LinePlot, names: list[str] | None) -> _Series:
    if rows[plot.x].isna().all():
        return _Series(arm, variant, None, [sample(rows, plot.metric)])
    column = rows[plot.x].map(lambda value: float(names.index(str(value))) if names else float(value))
    groups = sorted(rows.groupby(column), key=lambda pair: pair[0])
    return _Series(arm, variant, np.array([place for place, _ in groups]), [sample(g, plot.metric) for _, g in groups])


def _short(axis: str) -> str:
    return {"decay": "ν", "exploration": "ξ"}.get(axis, axis.replace("_", " "))


def _panel(
    axes: Any, panel: list[_Series], plot: LinePlot, experiment: Experiment, names: list[str] | None, *, is_split: bool
) -> None:
    _scales(axes, panel, plot, names)
    arms = list(dict.fromkeys(one.arm for one in panel))
    variants = list(dict.fromkeys(one.variant for one in panel))
    palette = style.colours(experiment)
    for number, one in enumerate(panel):
        place = variants.index(one.variant)
        colour = palette[one.arm]
        if len(arms) == 1 and len(panel) > 1:
            colour = ("#0072B2", *style.COLOURS)[number % 7]
        look = arms.index(one.arm) if len(variants) == 1 or is_split else place + 2 * arms.index(one.arm)
        _line(axes, one, colour, look, label=one.arm if is_split else one.label)
    if is_split:
        axes.set_title(panel[0].variant, fontsize=9)


def _scales(axes: Any, panel: list[_Series], plot: LinePlot, names: list[str] | None) -> None:
    placed = [one.places for one in panel if one.places is not None]
    places = np.unique(np.concatenate(placed)) if placed else np.array([0.0])
    axes.set_yscale(plot.y_scale)
    if names:
        axes.set_xticks(range(len(names)), names)
    elif plot.x_scale != "linear":
        positive = places[places > 0]
        if (places <= 0).any() and len(positive):
            axes.set_xscale("symlog", linthresh=positive.min())
        else:
            axes.set_xscale("log")
        if len(places) <= _MOST_NAMED_TICKS:
            axes.set_xticks(places, [f"{place:g}" for place in places])
            axes.minorticks_off()
    elif len(places) <= _MOST_NAMED_TICKS and np.diff(places).min(initial=np.inf) >= np.ptp(places) / 20:
        axes.set_xticks(places, [f"{place:g}" for place in places])
    axes.set_xlabel({"decay": "decay ν", "exploration": "exploration ξ"}.get(plot.x, plot.x.replace("_", " ")))


def _line(axes: Any, one: _Series, colour: str, look: int, label: str) -> None:
    """Mean and interval; the standard deviation as thin whiskers; open markers where runs are at the cap."""
    linestyle = style.LINESTYLES[look % len(style.LINESTYLES)]
    means = np.array([each.mean for each in one.samples])
    low, high = np.array([each.interval for each in one.samples]).T
    if one.places is None:
        axes.axhline(means[0], color=colour, linestyle=linestyle, linewidth=1.4, label=f"{label} alone")
        axes.axhspan(low[0], high[0], color=colour, alpha=0.15, linewidth=0)
        return
    below, above = np.array([each.spread for each in one.samples]).T
    marker = style.MARKERS[look % len(style.MARKERS)]
    axes.fill_between(one.places, low, high, color=colour, alpha=0.25, linewidth=0)
    axes.vlines(one.places, below, above, color=colour, linewidth=0.8, alpha=0.7)
    axes.plot(one.places, means, color=colour, linestyle=linestyle, linewidth=1.6, marker=marker, ms=5.5, label=label)
    capped = np.array([each.num_censored > 0 for each in one.samples])
    if capped.any():
        axes.plot(
            one.places[capped], means[capped], linestyle="", marker=marker, ms=5.5, markerfacecolor="white",
            markeredgecolor=colour, markeredgewidth=1.3, zorder=4,
        )  # fmt: skip


def _finish(figure: Any, axes: Any, series: list[_Series], plot: LinePlot, experiment: Experiment) -> None:
    every = [one for each in series for one in each.samples]
    if plot.y_scale == "linear" and plot.metric != "steady_state":
        axes[0].set_ylim(0, None)
    note = "; open markers: some runs at the cap" if any(one.num_censored for one in every) else ""
    how = f"mean of {count_of_runs(every)}, 95 % interval (shaded), SD within the runs' range (thin lines){note}"
    style.title(figure, plot.title or experiment.title or experiment.name, how)
    style.legend(figure, axes)
