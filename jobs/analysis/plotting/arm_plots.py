"""One metric, arm by arm: bars (Figures 4.7, 4.18), distributions (4.8, 4.12), survival."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from jobs.analysis.plotting import style
from jobs.analysis.plotting.samples import NAMES, Sample, cap, count_of_runs, samples, selected
from jobs.analysis.statistics.survival import share_solved
from jobs.experiment.figures import ArmPlot
from jobs.experiment.spec import Experiment

_MOST_UPRIGHT = 8
_LEAST_BINS, _MOST_BINS = 5, 25
_LEAST_RUNS_OF_A_BAND = 10
_WIDE = 20
_HOW_TO_READ = "mean, 95 % interval (thick), SD within the runs' range (thin)"


def draw(plt: Any, runs: Any, plot: ArmPlot, experiment: Experiment) -> Any:
    """The figure; None where no run has the metric."""
    shown = samples(selected(runs, plot, experiment), plot.metric)
    if not shown:
        return None
    kinds = {"bars": _bars, "distributions": _distributions, "survival": _survival}
    return kinds[plot.kind](plt, shown, plot, experiment)


def _bars(plt: Any, shown: list[Sample], plot: ArmPlot, experiment: Experiment) -> Any:
    if len(shown) > _MOST_UPRIGHT:
        return _lying_bars(plt, shown, plot, experiment)
    figure, axes = plt.subplots(figsize=(max(5.0, 1.15 * len(shown) + 0.8), 3.8))
    palette, limit = style.colours(experiment), cap(experiment, plot.metric)
    for position, one in enumerate(shown):
        axes.bar(position, one.mean, width=0.62, color=palette[one.arm], alpha=0.75)
        axes.errorbar(position, one.mean, yerr=_whiskers(one), color="#333333", linewidth=0.9, capsize=5)
        axes.plot([position] * 2, one.interval, color="black", linewidth=4, solid_capstyle="butt")
    labels = [_with_cap(one) for one in shown]
    axes.set_xticks(range(len(shown)), labels)
    axes.axhline(0, color="black", linewidth=0.8)
    if limit is not None:
        axes.axhline(limit, color=style.GREY, linestyle=":", linewidth=1)
        place = axes.get_yaxis_transform()
        axes.text(1.0, limit, "cap", transform=place, ha="right", va="bottom", color=style.GREY, fontsize=8.5)
    if plot.metric != "steady_state":
        axes.set_ylim(0, None)
    axes.set_ylabel(NAMES[plot.metric])
    _title(figure, plot, experiment, f"{count_of_runs(shown)}: {_HOW_TO_READ}")
    return figure


def _with_cap(one: Sample) -> str:
    capped = f"\n({one.num_censored} of {len(one.values)}\nat the cap)" if one.num_censored else ""
    return one.label + capped


def _lying_bars(plt: Any, shown: list[Sample], plot: ArmPlot, experiment: Experiment) -> Any:
    """Many bars, the best on top; a panel for each sweep point where several arms are compared at each."""
    panels = _panels(shown)
    keys = [_key(one, panels) for one in _ranked(panels[0], plot)]
    keys += [key for key in dict.fromkeys(_key(one, panels) for panel in panels for one in panel) if key not in keys]
    height = 1.3 + 0.235 * len(keys)
    width = 6.8 if len(panels) == 1 else 2.2 + 2.5 * len(panels)
    figure, all_axes = plt.subplots(
        1, len(panels), figsize=(width, height), sharey=True, sharex=cap(experiment, plot.metric) is not None or None,
        squeeze=False,
    )  # fmt: skip
    for axes, panel in zip(all_axes[0], panels, strict=True):
        _lying_panel(axes, panel, [keys.index(_key(one, panels)) for one in panel], plot, experiment)
        if len(panels) > 1:
            axes.set_title(panel[0].sweep, fontsize=9)
    all_axes[0, 0].set_yticks(range(len(keys)), keys)
    all_axes[0, 0].set_ylim(len(keys) - 0.4, -0.6)
    censored = any(one.num_censored for one in shown)
    note = "; right: runs at the cap" if censored else ""
    note += " (dotted)" if censored and cap(experiment, plot.metric) is not None else ""
    _title(figure, plot, experiment, f"{count_of_runs(shown)}: {_HOW_TO_READ}{note}")
    for axes in all_axes[0]:
        axes.set_xlabel(NAMES[plot.metric])
    _explain_colours(figure, experiment)
    return figure


def _lying_panel(axes: Any, panel: list[Sample], places: list[int], plot: ArmPlot, experiment: Experiment) -> None:
    palette = style.colours(experiment)
    is_wide = _is_wide(panel, plot)
    axes.set_xscale("log" if is_wide else "linear")
    for place, one in zip(places, panel, strict=True):
        if is_wide:  # a bar's length means nothing on such a scale
            axes.plot(one.mean, place, "o", ms=7, color=palette[one.arm], markeredgecolor="black", zorder=4)
        else:
            axes.barh(place, one.mean, height=0.68, color=palette[one.arm], alpha=0.75)
        axes.errorbar(one.mean, place, xerr=_whiskers(one), color="#333333", linewidth=0.8, capsize=2)
        axes.plot(one.interval, [place] * 2, color="black", linewidth=3, solid_capstyle="butt")
        if one.num_censored:
            axes.text(
                1.01, place, f"{one.num_censored}/{len(one.values)}", transform=axes.get_yaxis_transform(),
                va="center", fontsize=8, color=style.GREY,
            )  # fmt: skip
    limit = cap(experiment, plot.metric)
    if limit is not None:
        axes.axvline(limit, color=style.GREY, linestyle=":", linewidth=1)
    if is_wide:
        axes.grid(visible=True, axis="both", color="#DDDDDD", linewidth=0.6)
        axes.set_axisbelow(True)
        return
    axes.axvline(0, color="black", linewidth=0.8)
    if plot.metric != "steady_state":
        axes.set_xlim(0, None)
    axes.locator_params(axis="x", nbins=5)


def _whiskers(one: Sample) -> list[list[float]]:
    """How far the spread reaches below and above the mean, as matplotlib takes it."""
    low, high = one.spread
    return [[one.mean - low], [high - one.mean]]


def _is_wide(panel: list[Sample], plot: ArmPlot) -> bool:
    """Whether the longest time would leave the shortest ones no visible bar."""
    means = [one.mean for one in panel]
    return plot.metric != "steady_state" and 0 < _WIDE * min(means) < max(means)


def _explain_colours(figure: Any, experiment: Experiment) -> None:
    from matplotlib.patches import Patch

    kinds = style.kinds(experiment)
    if kinds:
        handles = [Patch(color=colour, alpha=0.75, label=name) for name, colour in kinds.items()]
        figure.legend(
            handles=handles, loc="outside lower center", ncols=2 if figure.get_figwidth() < 8 else len(handles)
        )


def _panels(shown: list[Sample]) -> list[list[Sample]]:
    """By sweep point where each has several arms; otherwise all in one."""
    by_sweep: dict[str, list[Sample]] = {}
    for one in shown:
        by_sweep.setdefault(one.sweep, []).append(one)
    separate = 1 < len(by_sweep) <= _MOST_UPRIGHT and all(len(panel) > 1 for panel in by_sweep.values())
    return list(by_sweep.values()) if separate else [shown]


def _key(one: Sample, panels: list[list[Sample]]) -> str:
    return one.arm if len(panels) > 1 or not one.sweep else f"{one.arm}, {one.sweep}"


def _ranked(panel: list[Sample], plot: ArmPlot) -> list[Sample]:
    return sorted(panel, key=lambda one: one.mean, reverse=plot.metric == "steady_state")


def _distributions(plt: Any, shown: list[Sample], plot: ArmPlot, experiment: Experiment) -> Any:
    """Histogram of each arm and sweep point on the same axes; runs at the cap are hatched."""
    figure, all_axes = plt.subplots(
        len(shown), 1, figsize=(6.4, 1.2 + 1.15 * len(shown)), sharex=True, sharey=True, squeeze=False
    )
    every = np.concatenate([one.values for one in shown])
    lowest = every.min() if plot.metric == "steady_state" else 0.0
    # With fewer runs fewer bins, 20 for a hundred: otherwise a handful of them is a comb.
    num_bins = int(np.clip(2.0 * np.sqrt(max(len(one.values) for one in shown)), _LEAST_BINS, _MOST_BINS))
    edges = np.linspace(lowest, max(cap(experiment, plot.metric) or 0.0, every.max(), lowest + 1e-9), num_bins + 1)
    palette = style.colours(experiment)
    for axes, one in zip(all_axes[:, 0], shown, strict=True):
        colour = palette[one.arm]
        axes.hist(
            [one.values[~one.censored], one.values[one.censored]], bins=edges, stacked=True, color=[colour, "white"],
            edgecolor=colour, hatch=[None, "////"],
        )  # fmt: skip
        axes.set_ylabel("runs")
        label = one.label.replace("\n", ", ")
        capped = f"  ({one.num_censored} of {len(one.values)} at the cap, hatched)" if one.num_censored else ""
        axes.set_title(f"{label}{capped}", fontsize=9, loc="left", pad=3)
    all_axes[-1, 0].set_xlabel(NAMES[plot.metric])
    all_axes[-1, 0].set_xlim(edges[0], edges[-1] + 0.01 * (edges[-1] - edges[0]))
    _title(figure, plot, experiment, f"distribution over {count_of_runs(shown)}")
    return figure


def _survival(plt: Any, shown: list[Sample], plot: ArmPlot, experiment: Experiment) -> Any:
    """Share of the runs that are done by an episode, with its 95 % band."""
    figure, axes = plt.subplots(figsize=(6.4, 4.2))
    palette = style.colours(experiment)
    last = max(cap(experiment, plot.metric) or 0.0, *(one.values.max() for one in shown))
    variants = {arm: [one.sweep for one in shown if one.arm == arm] for arm in dict.fromkeys(one.arm for one in shown)}
    arms = list(variants)
    # The bands of a few runs cover nearly everything.
    has_bands = min(len(one.values) for one in shown) >= _LEAST_RUNS_OF_A_BAND
    for one in shown:
        curve = share_solved(one.values, one.censored)
        episodes, share, low, high = (np.append(values, values[-1]) for values in _steps(curve))
        episodes[-1] = last
        number = arms.index(one.arm) + variants[one.arm].index(one.sweep)
        axes.step(
            episodes, share, where="post", color=palette[one.arm], linewidth=1.8,
            linestyle=style.LINESTYLES[number % len(style.LINESTYLES)], label=one.label.replace("\n", ", "),
        )  # fmt: skip
        if has_bands:
            axes.fill_between(episodes, low, high, step="post", color=palette[one.arm], alpha=0.15, linewidth=0)
    axes.set_xlim(0, last)
    axes.set_ylim(0, 1.02)
    axes.set_xlabel("episode" if plot.metric == "train_time" else "episodes after the switch")
    axes.set_ylabel("share of runs that are done")
    style.legend(figure, [axes])
    band = ", 95 % band" if has_bands else ""
    _title(figure, plot, experiment, f"{count_of_runs(shown)}: share that meets the criterion{band}")
    return figure


def _steps(curve: Any) -> Sequence[Any]:
    return curve.episodes, curve.share, curve.low, curve.high


def _title(figure: Any, plot: ArmPlot, experiment: Experiment, second: str) -> None:
    style.title(figure, plot.title or experiment.title or experiment.name, second)
