"""Pictures of the results, from the Parquet files alone: PNG and SVG, legible in print and to the colour-blind."""

from __future__ import annotations

from typing import Any

from jobs.analysis.plotting import arm_plots, curve_plots, line_plots, step_plots, style
from jobs.analysis.plotting.switch_marks import Marks, marks_of
from jobs.analysis.recorded_episodes import IncompleteError
from jobs.analysis.switching.runs import SwitchData
from jobs.analysis.switching.table import switch_table
from jobs.experiment.figures import CurvePlot, LinePlot, Plot
from jobs.experiment.spec import Experiment
from jobs.experiment.yaml_source import SpecError
from jobs.results.store import ResultStore


def draw_figures(store: ResultStore, experiment: Experiment) -> list[str]:
    """Draw the plots of an experiment, or its train times where it names none; returns where the files are.

    A plot of which the results hold nothing (no episodes recorded, arms not yet played) is left out. Beside one that
    marks switches stand two tables: ``…_switch.csv`` of all runs, ``…_switch_runs.csv`` of each.

    Raises
    ------
    SpecError
        If a plot is over environment steps, and not every episode was recorded.
    """
    runs = store.runs()
    written = []
    for plot in experiment.drawn_plots:
        try:
            written += _write_plot(store, runs, plot, experiment)
        except IncompleteError as error:
            message = f"{experiment.name}: figure {plot.name} over steps: {error}"
            raise SpecError(message) from error
    return written


def _write_plot(store: ResultStore, runs: Any, plot: Plot, experiment: Experiment) -> list[str]:
    marks: Marks | None = None
    tables: dict[str, Any] = {}
    if isinstance(plot, CurvePlot) and plot.switch:
        marks, tables = _switches(store, runs, plot, experiment)
    with style.pyplot() as plt:
        figure = _draw(plt, store, runs, plot, experiment, marks)
        if figure is None:
            return []
        written = style.save(store.folder, figure, f"figures/{plot.name}")
    for name, table in tables.items():
        store.folder.write(name, table.to_csv(index=False, float_format="%.10g").encode())
        written.append(store.folder.location(name))
    return written


def _switches(
    store: ResultStore, runs: Any, plot: CurvePlot, experiment: Experiment
) -> tuple[Marks | None, dict[str, Any]]:
    """Marks, and tables by file name; nothing where no run has the learners alone and an ensemble of them."""
    learners = {arm: spec.learner_names for arm, spec in experiment.arms.items()}
    points = step_plots.points_of(runs, plot, experiment)
    data = SwitchData(store.folder, points, learners, plot.switch) if plot.switch else None
    if data is None or (rows := data.rows()).empty:
        return None, {}
    table = switch_table(rows, data)
    tables = {"switch": table, "switch_runs": rows}
    named = {f"figures/{plot.name}_{kind}.csv": each for kind, each in tables.items()}
    return marks_of(data, rows, table, experiment), named


def _draw(
    plt: Any, store: ResultStore, runs: Any, plot: Plot, experiment: Experiment, marks: Marks | None = None
) -> Any:
    if isinstance(plot, CurvePlot):
        if plot.clock == "steps":
            return step_plots.draw(plt, store.folder, runs, plot, experiment, marks)
        return curve_plots.draw(plt, store.folder, runs, plot, experiment)
    if isinstance(plot, LinePlot):
        return line_plots.draw(plt, runs, plot, experiment)
    return arm_plots.draw(plt, runs, plot, experiment)
