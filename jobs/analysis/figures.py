"""Pictures of the results, from the Parquet files alone: PNG and SVG, legible in print and to the colour-blind."""

from __future__ import annotations

from typing import Any

from cluster.storage import Folder
from jobs.analysis.plotting import arm_plots, curve_plots, line_plots, pictures, style
from jobs.plots import ArmPlot, CurvePlot, LinePlot, Plot
from jobs.spec import Experiment, Gallery
from jobs.store import ResultStore

_DEFAULT: tuple[Plot, ...] = (
    ArmPlot(kind="bars", name="train_time"),
    ArmPlot(kind="distributions", name="train_time_distribution"),
)


def draw_figures(store: ResultStore, experiment: Experiment) -> list[str]:
    """Draw the plots of an experiment, or its train times where it names none; returns where the files are.

    A plot of which the results hold nothing (no episodes recorded, arms not yet played) is left out.
    """
    runs = store.runs()
    plots = experiment.plots or (list(_DEFAULT) if experiment.criterion else [])
    written = []
    for plot in plots:
        with style.pyplot() as plt:
            figure = _draw(plt, store, runs, plot, experiment)
            if figure is not None:
                written += style.save(store.folder, figure, f"figures/{plot.name}")
    return written


def draw_gallery(gallery: Gallery, folder: Folder) -> list[str]:
    """Draw the pictures of a gallery into a folder; returns where the files are."""
    written = []
    for picture in gallery.pictures:
        with style.pyplot() as plt:
            written += style.save(folder, pictures.draw(plt, picture, gallery), picture.name)
    return written


def _draw(plt: Any, store: ResultStore, runs: Any, plot: Plot, experiment: Experiment) -> Any:
    if isinstance(plot, CurvePlot):
        return curve_plots.draw(plt, store.folder, runs, plot, experiment)
    if isinstance(plot, LinePlot):
        return line_plots.draw(plt, runs, plot, experiment)
    return arm_plots.draw(plt, runs, plot, experiment)
