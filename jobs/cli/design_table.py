"""The table of `apel design`. Imported where it is needed: the theory takes scipy."""

from __future__ import annotations

from collections.abc import Sequence

from rich.text import Text

from jobs.analysis.pages.fitting_table import FittingTable
from jobs.cli.design import DISSERTATION, DecayPrediction


def design_table(predictions: Sequence[DecayPrediction]) -> FittingTable:
    """The table of `apel design`: the rows to trust are bold where the terminal can."""
    has_performance = any(row.performance is not None for row in predictions)
    names = ("ν", "ν by", "predicted by")
    headings = (*names, "adaptation", "rise", "exploration", *(["performance"] if has_performance else []))
    rows = []
    for row in predictions:
        cells = [f"{row.decay:.4g}", row.decay_by, row.predicted_by, f"{row.adaptation_time:,.1f}"]
        cells += [f"{row.rise_time:,.1f}", f"{row.exploration:.4g}"]
        cells += [f"{row.performance:.4g}"] if row.performance is not None else []
        style = "" if row.predicted_by == DISSERTATION else "bold"
        rows.append([Text(cell, style=style) for cell in cells])
    return FittingTable(headings, rows, names=names, first_to_go=("ν by", "rise", "performance"))
