"""The table of `apel design`. Imported where it is needed: the theory takes scipy."""

from __future__ import annotations

from collections.abc import Sequence

from rich import box
from rich.table import Table

from jobs.cli.design import DISSERTATION, DecayPrediction


def design_table(predictions: Sequence[DecayPrediction]) -> Table:
    """The table of `apel design`: the rows to trust are bold where the terminal can."""
    has_performance = any(row.performance is not None for row in predictions)
    table = Table(box=box.SIMPLE_HEAD, padding=(0, 2, 0, 0))
    for heading in ("ν", "ν by", "predicted by"):
        table.add_column(heading, no_wrap=True)
    for heading in ("adaptation", "rise", "exploration", *(["performance"] if has_performance else [])):
        table.add_column(heading, justify="right", no_wrap=True)
    for row in predictions:
        cells = [f"{row.decay:.4g}", row.decay_by, row.predicted_by, f"{row.adaptation_time:,.1f}"]
        cells += [f"{row.rise_time:,.1f}", f"{row.exploration:.4g}"]
        cells += [f"{row.performance:.4g}"] if row.performance is not None else []
        table.add_row(*cells, style=None if row.predicted_by == DISSERTATION else "bold")
    return table
