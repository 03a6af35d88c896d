"""What theory says, over measured lines: adaptation times (Eq. 3.11) and steady states (Eq. 3.14) by decay."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from apel.theory import closed_forms, selection_aware
from apel.theory.adaptation import adaptation_time_distribution
from jobs.analysis.adaptation_model import NUM_CHAINS, window_criterion
from jobs.analysis.plotting.style import GREY
from jobs.analysis.statistics.bootstrap import Floats
from jobs.experiment.figures import LinePlot
from jobs.experiment.spec import Experiment

_NUM_POINTS = 60

Model = Callable[[float, float, Sequence[float]], float]


def draw(all_axes: Any, runs: Any, frame: Any, plot: LinePlot, experiment: Experiment) -> None:
    """Add the theory that a plot names, over the decays that its rows have."""
    decays = np.unique(frame[plot.x].dropna().astype(float)) if plot.theory else np.empty(0)
    decays = decays[decays > 0]
    if not len(decays):
        return
    fine = np.geomspace(decays[0], decays[-1], _NUM_POINTS)
    for axes in all_axes:
        if "adaptation_formula" in plot.theory:
            times = [closed_forms.adaptation_time(nu) for nu in fine]
            axes.plot(fine, times, color="black", linestyle="--", linewidth=1.3, label="Eq. 3.11")
        if "adaptation_model" in plot.theory:
            _adaptation_model(axes, decays, frame, plot, experiment)
        if {"performance_formula", "performance_model"} & set(plot.theory):
            _performance(axes, fine, runs, frame, plot, experiment)


def _adaptation_model(axes: Any, decays: Floats, frame: Any, plot: LinePlot, experiment: Experiment) -> None:
    """Mean of the simulated chains, cut off where the measured runs are, for the first arm that the axis touches;
    nothing where the experiment does not state the lengths of its learners' episodes.
    """
    arm = frame.loc[frame[plot.x].notna(), "arm"].iloc[0]
    criterion = window_criterion(experiment, arm)
    if criterion is None:
        return
    longest = int(frame["adaptation_time"].max())
    if frame["censored"].any():
        longest = int(frame.loc[frame["censored"].astype(bool), "adaptation_time"].max())
    swept = any("criterion.after" in paths for paths in experiment.sweep.values())
    after = None if swept or experiment.criterion is None else experiment.criterion.after
    after = None if isinstance(after, str) else after  # one for each run
    times = []
    for nu in decays:
        last = min(int(40 / nu) + criterion.window, max(longest, criterion.window))
        found = adaptation_time_distribution(
            float(nu), criterion=criterion, switch_episode=after, num_chains=NUM_CHAINS, max_episodes=last
        )
        times.append(np.minimum(found.episodes, last).mean())
    lengths = ", ".join(f"{float(length):.0f}" for length in criterion.lengths)  # type: ignore[arg-type]
    axes.plot(
        decays,
        times,
        color=GREY,
        linestyle=":",
        linewidth=1.8,
        marker="x",
        label=f"model, measured criterion (lengths {lengths})",
    )


def _performance(axes: Any, fine: Floats, runs: Any, frame: Any, plot: LinePlot, experiment: Experiment) -> None:
    """Eq. 3.14 and its selection-aware counterpart, with measured returns; Eq. 3.14 with the plot's, too."""
    models: list[tuple[str, Model, Any]] = []
    if "performance_formula" in plot.theory:
        models.append(("Eq. 3.14", closed_forms.steady_state_performance, "--"))
        if plot.returns:
            _formula_of(axes, fine, *plot.returns)
    if "performance_model" in plot.theory:
        models.append(("selection-aware", selection_aware.steady_state_performance, ":"))
    for arm in dict.fromkeys(frame.loc[frame[plot.x].notna(), "arm"]):
        returns = _measured(runs, experiment, arm)
        # Learners that end up alike leave nothing to be predicted but their return.
        if returns is None or returns[0] - min(returns[1:]) < 0.1 * abs(returns[0]):
            continue
        for name, model, linestyle in models:
            values = [model(float(nu), returns[0], returns[1:]) for nu in fine]
            label = f"{arm}: {name}, measured returns"
            axes.plot(fine, values, color="black", linestyle=linestyle, linewidth=1.5, label=label)


def _formula_of(axes: Any, fine: Floats, best: float, other: float) -> None:
    values = [closed_forms.steady_state_performance(nu, best, [other]) for nu in fine]
    label = f"Eq. 3.14, returns {best:g} and {other:g}".replace("-", "−")
    axes.plot(fine, values, color=GREY, linestyle="-.", linewidth=1.1, label=label)


def _measured(runs: Any, experiment: Experiment, arm: str) -> list[float] | None:
    """Mean steady state of each of the arm's learners where it is an arm of its own, the best first."""
    frame = runs.select(["arm", "steady_state"]).to_pandas()
    means = frame.groupby("arm")["steady_state"].mean()
    alone = {
        spec.learner_names[0]: means[name]
        for name, spec in experiment.arms.items()
        if len(spec.learner_names) == 1 and name in means
    }
    returns = [alone.get(name, np.nan) for name in experiment.arms[arm].learner_names]
    if len(returns) < 2 or not np.isfinite(returns).all():
        return None
    best, *others = sorted(map(float, returns), reverse=True)
    return [best, *others] if best > others[0] else None
