"""How the cost of a job grows with episodes, runs and learners: ``python -m benchmarks.linear_cost``.

Processor time of one process (the coordinator and its hosts in local placement, from the making of the environments
to the last row), so that other work on the machine disturbs little. What is measured is the distractor maze with APEL
and steps at random only: episodes are then about equally long, early and late, and a job is as large as its numbers
say. A second series of episodes learns as the shipped experiment does; there episodes get shorter, and the time per
step is what counts. The number of learners is varied in ten runs, and in the hundred that a shard has at most: in every
round each learner hears of all others, which costs nearly the same for one run as for many. Written to
benchmarks/results/, drawn to docs/.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import statistics
import time
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np

from cluster.coordinator import Coordinator
from cluster.events import ShardDone
from cluster.local import LocalHosts
from cluster.shard import Execution
from jobs.experiment.plan import Plan
from jobs.experiment.spec_files import load_experiment
from jobs.results.manifest import versions

mpl.use("Agg")
import matplotlib.pyplot as plt

HERE = Path(__file__).parent
LEARN = ("stop_when_met=false", "environment.options.max_steps=300")
RANDOM = (*LEARN, "learners.Q_full.exploration=1.0", "learners.Q_red.exploration=1.0")
SERIES: dict[str, tuple[str, list[int], tuple[str, ...]]] = {
    # The axis, its values, and what else is set.
    "runs": ("runs", [5, 10, 20, 40, 80], ("episodes=1000", *RANDOM)),
    "episodes": ("episodes", [500, 1000, 2000, 4000, 8000], ("runs=10", *RANDOM)),
    "episodes, learning": ("episodes", [500, 1000, 2000, 4000, 8000], ("runs=10", *LEARN)),
    "learners": ("arms.APEL.learners", [1, 2, 4, 8, 16], ("runs=10", "episodes=500", *RANDOM)),
    "learners, 100 runs": ("arms.APEL.learners", [1, 2, 4, 8, 16], ("runs=100", "episodes=100", *RANDOM)),
}
BLUE, ORANGE, GREY = "#0072B2", "#E69F00", "#7f7f7f"


class _Nowhere:
    """Keeps no rows and no checkpoints."""

    def spill(self, *_: Any) -> None:
        pass

    def commit(self, *_: Any) -> None:
        pass

    def read(self, _: Any) -> None:
        pass

    def write(self, *_: Any) -> None:
        pass

    def delete(self, _: Any) -> None:
        pass


def play(overrides: tuple[str, ...]) -> tuple[float, int]:
    """Processor seconds and environment steps of all runs of the arm APEL, side by side."""
    experiment = load_experiment("distractor-maze", overrides)
    (shard,) = Plan.of(experiment).only(["APEL"]).shards(num_cpus=1, shard_size=100)
    nowhere = _Nowhere()
    began = time.process_time()
    for event in Coordinator(LocalHosts(), nowhere, nowhere, Execution()).run(shard):
        if isinstance(event, ShardDone):
            assert not event.failures  # noqa: S101
            return time.process_time() - began, event.steps
    raise AssertionError


def override(path: str, value: int) -> str:
    """The override of one point of a series; a number of learners is so many copies of one."""
    return f"{path}={{Q_full: {value}}}" if path.endswith(".learners") else f"{path}={value}"


def slope(values: list[int], costs: list[float]) -> float:
    """Least-squares slope in logarithms: 1 where the cost grows in proportion."""
    return float(np.polyfit(np.log(values), np.log(costs), 1)[0])


def fixed_and_each(values: list[int], costs: list[float]) -> tuple[float, float]:
    """Of the line with the least relative error: what a job costs whatever its size, and what each unit adds."""
    each, fixed = np.polyfit(values, costs, 1, w=1 / np.array(costs))
    return float(fixed), float(each)


def measure_series(path: str, values: list[int], fixed: tuple[str, ...], repeats: int) -> dict[str, Any]:
    """Medians at every value; the values in turn, since machines have better and worse minutes."""
    seconds: dict[int, list[float]] = {value: [] for value in values}
    steps: dict[int, int] = {}
    for _ in range(repeats):
        for value in values:
            taken, steps[value] = play((*fixed, override(path, value)))
            seconds[value].append(taken)
    medians = [statistics.median(seconds[value]) for value in values]
    counts = [steps[value] for value in values]
    fixed_seconds, each_seconds = fixed_and_each(values, medians)
    num_learners = values if path.endswith(".learners") else [2] * len(values)
    return {
        "fixed": list(fixed),
        "values": values,
        "processor_seconds": [seconds[value] for value in values],
        "median_processor_seconds": medians,
        "environment_steps": counts,
        "nanoseconds_per_step": [s / n * 1e9 for s, n in zip(medians, counts, strict=True)],
        "nanoseconds_per_step_and_learner": [
            s / n / k * 1e9 for s, n, k in zip(medians, counts, num_learners, strict=True)
        ],
        "line": {"fixed_seconds": fixed_seconds, "seconds_each": each_seconds},
        "log_log_slope": slope(values, medians),
        "log_log_slope_by_steps": slope(counts, medians) if len(set(num_learners)) == 1 else None,
    }


def measure(repeats: int) -> dict[str, Any]:
    """Everything, as the record that is written."""
    for _, _, fixed in SERIES.values():  # compiles, or reads what was compiled
        play((*fixed, "runs=2", "episodes=20"))
    play((*RANDOM, "runs=2", "episodes=20", override("arms.APEL.learners", 1)))
    return {
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "machine": {
            "cores": os.cpu_count(),
            "processor": platform.processor() or platform.machine(),
            "load_average": os.getloadavg(),
            "note": "other work ran on the machine; processor time of this process only, not wall time",
        },
        "versions": versions(),
        "repeats": repeats,
        "job": "the arm APEL of distractor-maze, local placement; at most 300 steps an episode",
        "series": {name: measure_series(*series, repeats) for name, series in SERIES.items()},
    }


def draw_series(axes: Any, series: dict[str, Any], colour: str, label: str) -> None:
    """Measured points and the line of slope 1 through their middle, in logarithms."""
    values, seconds = np.array(series["values"], float), np.array(series["median_processor_seconds"])
    level = np.exp(np.mean(np.log(seconds / values)))
    by_steps = series["log_log_slope_by_steps"]
    note = f", {by_steps:.2f} by steps" if by_steps is not None and label == "learning" else ""
    axes.plot(values, level * values, "--", color=colour, alpha=0.6, linewidth=1, zorder=1)
    axes.plot(values, seconds, "o", color=colour, label=f"{label} (slope {series['log_log_slope']:.2f}{note})")


def draw_costs(figure: Any, grid: Any, series: dict[str, Any]) -> None:
    """A panel each for runs, episodes and learners, with a common scale of time."""
    contents = {
        "runs": ("1,000 episodes, 2 learners", [("runs", "steps at random")]),
        "episodes": ("10 runs, 2 learners", [("episodes", "steps at random"), ("episodes, learning", "learning")]),
        "learners": (
            "copies of one learner",
            [("learners", "10 runs × 500 episodes"), ("learners, 100 runs", "100 runs × 100 episodes")],
        ),
    }
    panels: list[Any] = []
    for place, (axis, (title, drawn)) in enumerate(contents.items()):
        axes = figure.add_subplot(grid[0, place], sharey=panels[0] if panels else None)
        panels.append(axes)
        for (name, label), colour in zip(drawn, (BLUE, ORANGE), strict=False):
            draw_series(axes, series[name], colour, label)
        if axis == "runs":
            line, x = series["runs"]["line"], np.geomspace(5, 80)
            label = f"{line['fixed_seconds']:.2f} s + {line['seconds_each'] * 1e3:.0f} ms per run"
            axes.plot(x, line["fixed_seconds"] + line["seconds_each"] * x, color=ORANGE, linewidth=1, label=label)
        axes.plot([], [], "--", color=GREY, linewidth=1, label="in proportion (slope 1)")
        axes.set(xscale="log", yscale="log", xlabel=axis, title=title)
        axes.set_xticks(series[axis]["values"], [f"{value:,}" for value in series[axis]["values"]])
        axes.minorticks_off()
        axes.grid(alpha=0.3)
        axes.legend(fontsize=8, loc="upper left", framealpha=1)
    panels[0].set_ylabel("processor seconds")
    low, high = panels[0].get_ylim()
    panels[0].set_ylim(low, high * 5)  # room for the legends
    panels[0].yaxis.set_major_formatter(lambda value, _: f"{value:g}")


def draw_selectors(axes: Any, selectors: dict[str, Any]) -> None:
    """A bar for every selector, cheapest first."""
    costs = {name: cost["2"] for name, cost in selectors["nanoseconds_per_episode_and_run"].items()}
    names = sorted(costs, key=lambda name: costs[name])
    bars = axes.bar(names, [costs[name] for name in names], color=[ORANGE if "apel" in n else BLUE for n in names])
    axes.bar_label(bars, fmt="%.0f", fontsize=8, padding=2)
    axes.axhline(1000, color="#D55E00", linewidth=1.2)
    axes.text(-0.5, 985, "1 µs", color="#D55E00", va="top", fontsize=9)
    axes.set(ylabel="ns per episode and run", ylim=(0, 1080), title="Cost of the selector, 2 learners (orange: APEL)")
    axes.tick_params(axis="x", labelrotation=35)
    plt.setp(axes.get_xticklabels(), ha="right", rotation_mode="anchor")
    axes.margins(x=0.01)


def draw(record: dict[str, Any], selectors: dict[str, Any], stem: Path) -> None:
    """The figure, as PNG and SVG."""
    with plt.rc_context({"font.size": 10, "axes.titlesize": 10, "svg.hashsalt": "apel"}):
        figure = plt.figure(figsize=(11, 7.6), layout="constrained")
        grid = figure.add_gridspec(2, 3)
        draw_costs(figure, grid, record["series"])
        draw_selectors(figure.add_subplot(grid[1, :]), selectors)
        figure.savefig(stem.with_suffix(".png"), dpi=130)
        figure.savefig(stem.with_suffix(".svg"), metadata={"Date": None})
        plt.close(figure)


def show(record: dict[str, Any]) -> None:
    """Print a record."""
    for name, series in record["series"].items():
        by_steps = series["log_log_slope_by_steps"]
        more = "" if by_steps is None else f", {by_steps:.3f} against steps"
        fixed, each = series["line"]["fixed_seconds"], series["line"]["seconds_each"]
        print(f"{name}: slope {series['log_log_slope']:.3f}{more}; {fixed:.3f} s + {each:.3g} s each")
        print(f"{'':10s}{'seconds':>10s}{'steps':>12s}{'ns/step':>10s}{'ns/step/learner':>17s}")
        columns = (
            "values", "median_processor_seconds", "environment_steps", "nanoseconds_per_step",
            "nanoseconds_per_step_and_learner",
        )  # fmt: skip
        for value, seconds, steps, each, alone in zip(*(series[column] for column in columns), strict=True):
            print(f"{value:10d}{seconds:10.3f}{steps:12d}{each:10.1f}{alone:17.1f}")


def main() -> None:
    """Measure, print, write, draw."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--draw-only", action="store_true", help="draw what was measured before")
    arguments = parser.parse_args()
    path = HERE / "results" / "linear_cost.json"
    if not arguments.draw_only:
        path.write_text(json.dumps(measure(arguments.repeats), indent=2) + "\n")
    record = json.loads(path.read_text())
    show(record)
    selectors = json.loads((HERE / "results" / "selector_cost.json").read_text())
    draw(record, selectors, HERE.parent / "docs" / "linear_cost")
    print(path)


if __name__ == "__main__":
    main()
