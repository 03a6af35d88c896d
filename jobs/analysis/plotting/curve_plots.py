"""What happens from episode to episode (Figures 4.4, 4.5, 4.19): mean ± standard deviation over runs, of those that
are not over; a line ends where half of them are.
"""

from __future__ import annotations

import math
from collections import Counter
from typing import Any

import numpy as np

from apel.theory import closed_forms
from jobs.analysis.plotting import style
from jobs.analysis.plotting.samples import selected
from jobs.analysis.recorded_episodes import Curves, moving_mean, read_curves
from jobs.analysis.statistics.bootstrap import Floats
from jobs.experiment.figures import CurvePlot
from jobs.experiment.spec import Experiment
from jobs.results.storage import Folder

Y_LABELS = {
    "return": "return",
    "length": "episode length (steps)",
    "concentration": "concentration α",
    "probability": "selection probability",
}
PER_LEARNER = ("concentration", "probability")
_LEAST_SHARE = 0.5
_FEW_POINTS = 30


def draw(plt: Any, folder: Folder, runs: Any, plot: CurvePlot, experiment: Experiment) -> Any:
    """The figure; None where no episodes were recorded."""
    frame = selected(runs, plot, experiment)
    curves = {}
    for (arm, sweep), _ in frame.groupby(["arm", "sweep"], sort=False):
        if found := read_curves(folder, arm, sweep, plot.panels):
            curves[arm, sweep] = found
    if not curves:
        return None
    count = len(plot.panels)
    figure, all_axes = plt.subplots(count, 1, figsize=(6.6, 1.6 + 2.2 * count), sharex=True, squeeze=False)
    for axes, quantity in zip(all_axes[:, 0], plot.panels, strict=True):
        if quantity in PER_LEARNER:
            _learners(axes, curves, quantity, plot, experiment)
        else:
            _arms(axes, curves, quantity, plot, experiment)
        axes.set_ylabel(Y_LABELS[quantity])
        if plot.switch_episode is not None:
            axes.axvline(plot.switch_episode, color=style.GREY, linestyle="--", linewidth=1)
    axes.set_xlabel("episode" if plot.switch_episode is None else f"episode (dashed: switch at {plot.switch_episode})")
    axes.set_xlim(0, max(each.episodes[-1] for each in curves.values()) + 1)
    _finish(figure, all_axes[:, 0], curves, plot, experiment)
    return figure


def _finish(figure: Any, all_axes: Any, curves: dict[Any, Curves], plot: CurvePlot, experiment: Experiment) -> None:
    num_runs = max(each.num_runs for each in curves.values())
    smooth = f", moving mean of {plot.smooth} recorded episodes" if plot.smooth > 1 else ""
    over = "" if not any(each.has_ended_runs for each in curves.values()) else ", of those that are not over"
    mean = f"mean of {num_runs} runs{over} (line) ± SD within their range (shaded)" if num_runs > 1 else "a single run"
    if {"return", "length"} & set(plot.panels) and len(plot.panels) > 1:
        for axes in all_axes:
            if axes.get_legend_handles_labels()[0]:
                axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
    else:
        style.legend(figure, all_axes)
    style.title(figure, plot.title or experiment.title or experiment.name, f"{mean}{smooth}")


def _arms(axes: Any, curves: dict[Any, Curves], quantity: str, plot: CurvePlot, experiment: Experiment) -> None:
    palette = style.colours(experiment)
    centres = []
    for number, ((arm, sweep), each) in enumerate(curves.items()):
        label = f"{arm}, {sweep}" if sweep else arm
        centres.append(_line(axes, each, each.values(quantity), plot, label, palette[arm], number))
    # The first episodes' spread would squeeze all that follows.
    middle = np.concatenate(centres)
    low, high = np.nanquantile(middle, [0.01, 1.0] if quantity == "return" else [0.0, 0.99])
    margin = 0.35 * (high - low)
    axes.set_ylim(low - margin, high + margin)


def _learners(axes: Any, curves: dict[Any, Curves], quantity: str, plot: CurvePlot, experiment: Experiment) -> None:
    (arm, sweep), each = next(iter(curves.items()))
    values = each.values(quantity)
    names = numbered(experiment.arms[arm].learner_names)
    palette = style.learner_colours(experiment, arm)
    for position, (name, colour) in enumerate(zip(names, palette, strict=True)):
        _line(axes, each, values[..., position], plot, name, colour, position)
    if quantity == "probability":
        axes.set_ylim(0, 1)
    elif "growth_formula" in plot.theory and not sweep:
        selector = experiment.arms[arm].selector
        decay = selector.options.get("decay") if selector else None
        if decay is not None:
            _growth(axes, each.episodes, float(decay), plot.switch_episode)


def numbered(names: list[str]) -> list[str]:
    """Learners that are there several times get a number."""
    seen: Counter[str] = Counter()
    numbered = []
    for name in names:
        seen[name] += 1
        numbered.append(f"{name} {seen[name]}" if names.count(name) > 1 else name)
    return numbered


def _growth(axes: Any, episodes: Any, nu: float, switch: int | None) -> None:
    """Eq. 3.7 from 1; after a switch the old best decays (Eq. 3.10) and the new one grows."""
    before = episodes if switch is None else np.minimum(episodes, switch)
    old = closed_forms.incremented_concentration(nu, before)
    look = {"color": "black", "linestyle": "--", "linewidth": 1.2}
    if switch is None:
        axes.plot(episodes, old, label="Eq. 3.7", **look)
        return
    since = np.maximum(episodes - switch, 0)
    axes.plot(episodes, np.maximum(old * (1.0 - nu) ** since, 1.0), label="Eq. 3.7, 3.10", **look)
    axes.plot(episodes, closed_forms.incremented_concentration(nu, since), **look)


def _line(axes: Any, each: Curves, values: Floats, plot: CurvePlot, label: str, colour: str, number: int) -> Floats:
    """Mean and spread where at least half of the runs still go on; returns the means."""
    values = moving_mean(values, plot.smooth)
    known = np.isfinite(values).sum(axis=0)
    shown = known >= max(1, math.ceil(_LEAST_SHARE * each.num_runs))
    values, episodes = values[:, shown], each.episodes[shown]
    mean, spread = np.nanmean(values, axis=0), np.nanstd(values, axis=0)
    linestyle = style.LINESTYLES[number % len(style.LINESTYLES)]
    marker = style.MARKERS[number % len(style.MARKERS)]
    every = max(1, len(episodes) // 8)
    low = np.maximum(mean - spread, np.nanmin(values, axis=0))
    high = np.minimum(mean + spread, np.nanmax(values, axis=0))
    axes.fill_between(episodes, low, high, color=colour, alpha=0.18, linewidth=0)
    axes.plot(
        episodes, mean, color=colour, linestyle=linestyle, linewidth=1.5, marker=marker, ms=4.5,
        markevery=1 if len(episodes) <= _FEW_POINTS else (number * every // 8, every), label=label,
    )  # fmt: skip
    return mean
