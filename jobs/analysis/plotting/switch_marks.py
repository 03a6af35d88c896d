"""Where learners alone cross and ensembles switch, as vertical lines over a figure, with the delay in its legend."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from typing import Any

import numpy as np

from jobs.analysis.plotting import style
from jobs.analysis.switching.runs import Point, SwitchData
from jobs.analysis.switching.table import crossing_of_means
from jobs.experiment.spec import Experiment


@dataclass(frozen=True)
class Marks:
    """What is marked.

    Attributes
    ----------
    crossing:
        Where the mean curves of the learners alone cross, in environment steps; None where they do not.
    switches:
        Median step of each ensemble's switch; None where half of the runs never do.
    texts:
        What the legend says of each ensemble.
    colours:
        Of each ensemble.
    learners:
        The late and the early one.
    """

    crossing: float | None
    switches: dict[str, float | None]
    texts: dict[str, str]
    colours: dict[str, str]
    learners: tuple[str, str]

    def draw(self, axes: Any, unit: float, arms: Collection[str] | None) -> None:
        """Mark the crossing, and the switches of these ensembles, or of all."""
        if self.crossing is not None:
            axes.axvline(self.crossing / unit, **_CROSSING)
        for arm, step in self.switches.items():
            if step is not None and (arms is None or arm in arms):
                axes.axvline(step / unit, color=self.colours[arm], **_SWITCH)

    def legend(self, unit: float, name: str) -> tuple[list[Any], list[str]]:
        """Handles and labels."""
        from matplotlib.lines import Line2D

        late, early = self.learners
        crossed = "do not cross for good"
        if self.crossing is not None:
            crossed = f"cross for the last time at {_number(self.crossing / unit)} {name}steps"
        handles, labels = [Line2D([], [], **_CROSSING)], [f"mean returns of {late} and {early} {crossed}"]
        for arm, text in self.texts.items():
            handles.append(Line2D([], [], color=self.colours[arm], **_SWITCH))
            labels.append(text)
        return handles, labels


_CROSSING: dict[str, Any] = {"color": style.GREY, "linestyle": "--", "linewidth": 1.1}
_SWITCH: dict[str, Any] = {"linestyle": ":", "linewidth": 1.8}


def marks_of(data: SwitchData, rows: Any, table: Any, experiment: Experiment) -> Marks:
    """The marks of a figure without a sweep: those of the first sweep point where there are several.

    ``rows`` are those of ``data``, ``table`` what `switch_table` makes of them.
    """
    points: dict[str, Point] = {}
    for arm, sweep in data.ensembles:
        points.setdefault(arm, (arm, sweep))
    steps, gaps, _ = data.gaps_and_shares(next(iter(points.values())))
    switches, texts = {}, {}
    estimates = table.to_dict("records")
    for point in points.values():
        own = rows[(rows["arm"] == point[0]) & (rows["sweep"] == point[1]) & rows["delay"].notna()]
        middle = float(np.median(own["switch_step"].fillna(np.inf))) if len(own) else np.inf
        switches[point[0]] = middle if np.isfinite(middle) else None
        (row,) = [
            row for row in estimates
            if (row["arm"], row["sweep"], row["minus"], row["unit"]) == (*point, "", "episodes")
        ]  # fmt: skip
        texts[point[0]] = _text(row)
    palette = style.colours(experiment)
    colours = {arm: palette[arm] for arm in points}
    return Marks(crossing_of_means(steps, gaps), switches, texts, colours, (data.roles.late, data.roles.early))


def _text(row: dict[str, Any]) -> str:
    """Of one row of the switch table, in episodes."""
    if not row["runs"]:
        return f"{row['arm']}: no run in which the late learner stays ahead"
    low, high = _number(row["median_low"]), _number(row["median_high"])
    text = f"{row['arm']} switches (median): delay {_number(row['median'])} episodes, 95 % interval {low} to {high}"
    notes = [f"{row['censored']} of {row['runs']} runs never do"] if row["censored"] else []
    notes += [f"{row['without_crossover']} without crossover"] if row["without_crossover"] else []
    return f"{text} ({', '.join(notes)})" if notes else text


def _number(value: float) -> str:
    return (f"{value:,.0f}" if abs(value) >= 100 else f"{value:.3g}").replace("-", "−")
