"""What happens over environment steps (Figure 4.6): mean and 95 % interval over runs of episodes of unequal length."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from jobs.analysis.plotting import style
from jobs.analysis.plotting.curve_plots import PER_LEARNER, Y_LABELS, numbered
from jobs.analysis.plotting.samples import selected
from jobs.analysis.plotting.switch_marks import Marks
from jobs.analysis.recorded_episodes import Curves, at_steps, moving_mean, read_curves
from jobs.analysis.statistics.bootstrap import Estimate, Floats, bootstrap_curve
from jobs.experiment.figures import CurvePlot
from jobs.experiment.spec import Experiment
from jobs.results.storage import Folder

_POINTS = 300
# A band is drawn some pixels wide; more resamples would change less than one.
_NUM_RESAMPLES = 2000
_UNITS = ((1e6, 1e6, "million "), (1e4, 1e3, "thousand "), (0.0, 1.0, ""))

_Panel = tuple[str, str | None]
"""Quantity, and the arm whose learners are shown; None where arms are."""


def draw(
    plt: Any, folder: Folder, runs: Any, plot: CurvePlot, experiment: Experiment, marks: Marks | None = None
) -> Any:
    """The figure; None where no episodes were recorded, or nothing is known of what is to be shown.

    Raises
    ------
    IncompleteError
        If not every episode was recorded.
    """
    points = points_of(runs, plot, experiment)
    read = {point: read_curves(folder, *point, columns=[*plot.panels, "length"]) for point in points}
    curves = {point: found for point, found in read.items() if found}
    panels = panels_of(plot, curves)
    if not curves or not panels:
        return None
    size = 7.4, 1.9 + 1.9 * len(panels)
    figure, all_axes = plt.subplots(len(panels), 1, figsize=size, sharex=True, squeeze=False)
    last = max(float(each.num_steps.max()) for each in curves.values())
    unit, name = next((unit, name) for least, unit, name in _UNITS if last >= least)
    for axes, panel in zip(all_axes[:, 0], panels, strict=True):
        _draw_panel(axes, panel, curves, plot, experiment, unit)
        if marks:
            marks.draw(axes, unit, None if panel[1] is None else [panel[1]])
    all_axes[-1, 0].set_xlabel(f"{name}environment steps")
    all_axes[-1, 0].set_xlim(0, last / unit)
    if marks:
        figure.legend(*marks.legend(unit, name), loc="outside lower center", ncols=1)
    smooth = f", trailing means of {plot.smooth} episodes" if plot.smooth > 1 else ""
    num_runs = max(each.num_runs for each in curves.values())
    mean = f"mean of {num_runs} runs, 95 % interval (shaded)" if num_runs > 1 else "a single run"
    style.title(figure, plot.title or experiment.title or experiment.name, f"{mean}{smooth}")
    return figure


def points_of(runs: Any, plot: CurvePlot, experiment: Experiment) -> list[tuple[str, str]]:
    """Arms and sweep points that a plot shows, in the order of its arms."""
    frame = selected(runs, plot, experiment)[["arm", "sweep"]].drop_duplicates()
    return [(str(arm), str(sweep)) for arm, sweep in frame.itertuples(index=False)]


def panels_of(plot: CurvePlot, curves: Mapping[tuple[str, str], Curves]) -> list[_Panel]:
    """Panels in the order of the plot; quantities that are a learner's once for each arm whose learners are to be shown
    and whose selector has them: SSBAS knows no concentration.
    """
    arms = list(dict.fromkeys(arm for arm, _ in curves))
    found: list[_Panel] = []
    for quantity in plot.panels:
        if quantity not in PER_LEARNER:
            found.append((quantity, None))
            continue
        known = {arm for (arm, _), each in curves.items() if np.isfinite(each.values(quantity)).any()}
        found += [(quantity, arm) for arm in plot.learners_of or arms[:1] if arm in known]
    return found


_Line = tuple[str, str, Curves, Floats]
"""Label, colour, and ``float64[runs, episodes]`` of the arm."""


def _draw_panel(
    axes: Any, panel: _Panel, curves: Mapping[Any, Curves], plot: CurvePlot, experiment: Experiment, unit: float
) -> None:
    quantity, arm = panel
    if arm is None:
        lines = _of_arms(curves, quantity, experiment)
    else:
        own = {point: each for point, each in curves.items() if point[0] == arm}
        lines = _of_learners(own, quantity, experiment)
    _draw_lines(axes, lines, plot.smooth, unit)
    axes.set_ylabel(f"{Y_LABELS[quantity]}\nof {arm}" if arm else Y_LABELS[quantity])
    if quantity == "probability":
        axes.set_ylim(-0.02, 1.02)
    axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))


def _of_arms(curves: Mapping[Any, Curves], quantity: str, experiment: Experiment) -> list[_Line]:
    palette = style.colours(experiment)
    return [
        (f"{arm}, {sweep}" if sweep else arm, palette[arm], each, each.values(quantity))
        for (arm, sweep), each in curves.items()
    ]


def _of_learners(curves: Mapping[Any, Curves], quantity: str, experiment: Experiment) -> list[_Line]:
    lines = []
    for (arm, sweep), each in curves.items():
        names, values = experiment.arms[arm].learner_names, each.values(quantity)
        palette = style.learner_colours(experiment, arm)
        for place, (label, colour) in enumerate(zip(numbered(names), palette, strict=True)):
            lines.append((f"{label}, {sweep}" if sweep else label, colour, each, values[..., place]))
    return lines


def _draw_lines(axes: Any, lines: Sequence[_Line], smooth: int, unit: float) -> None:
    for number, (label, colour, each, values) in enumerate(lines):
        steps, band = mean_curve(moving_mean(values, smooth), each)
        marker = style.MARKERS[number % len(style.MARKERS)]
        linestyle = style.LINESTYLES[number % len(style.LINESTYLES)]
        every = max(1, len(steps) // 8)
        axes.fill_between(steps / unit, band.low, band.high, color=colour, alpha=0.2, linewidth=0)
        axes.plot(
            steps / unit, band.value, color=colour, linestyle=linestyle, linewidth=1.5, marker=marker, ms=4.5,
            markevery=(number * every // 8, every), label=label,
        )  # fmt: skip


def mean_curve(values: Floats, curves: Curves) -> tuple[Floats, Estimate[Floats]]:
    """Mean over the runs on a common grid of steps, with its interval.

    The grid goes from where every run has a finished episode (and a known value) to where the first run ends: a mean
    over fewer runs further on would be one over others.

    Parameters
    ----------
    values:
        ``float64[runs, episodes]``.
    curves:
        What they are of.

    Returns
    -------
    ``float64[points]``, environment steps, and three arrays of that shape.
    """
    steps = np.linspace(0.0, curves.num_steps.min(), _POINTS + 1)[1:]
    found = at_steps(values, curves.ends, steps)
    known = np.isfinite(found).all(axis=0)
    if not known.any():
        empty = np.empty(0)
        return empty, Estimate(empty, empty, empty)
    return steps[known], bootstrap_curve(found[:, known], num_resamples=_NUM_RESAMPLES)
