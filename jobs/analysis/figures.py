"""Pictures of the results, from the Parquet files alone: PNG and SVG, legible in print and to the colour-blind."""

from __future__ import annotations

import io
from typing import Any

import matplotlib as mpl
import numpy as np
import pyarrow as pa

from jobs.store import ResultStore

# Okabe & Ito (2008): eight colours that remain distinct to the colour-blind.
_COLOURS = ("#0072B2", "#E69F00", "#009E73", "#D55E00", "#CC79A7", "#56B4E9", "#F0E442", "#000000")
_STYLE: Any = {
    "figure.constrained_layout.use": True,
    "figure.dpi": 150,
    "font.size": 10,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "svg.hashsalt": "apel",
}
_NUM_BINS = 25


def draw_figures(store: ResultStore, title: str, cap: int) -> list[str]:
    """Draw what the results allow; returns where the files are."""
    runs = store.runs()
    if runs["train_time"].null_count == len(runs):
        return []
    mpl.use("Agg")
    from matplotlib import pyplot as plt

    written = []
    with mpl.rc_context(_STYLE):
        for name, figure in (
            ("train_time", _bars(plt, store.summary(), title, cap)),
            ("train_time_distribution", _distributions(plt, runs, title, cap)),
        ):
            written += [_save(store, figure, f"figures/{name}.{kind}", kind) for kind in ("png", "svg")]
            plt.close(figure)
    return written


def _bars(plt: Any, summary: pa.Table, title: str, cap: int) -> Any:
    """Mean train time per arm with its 95 % interval (thick) and standard deviation (thin), as in Fig. 4.7."""
    rows = summary.to_pylist()
    figure, axes = plt.subplots(figsize=(max(5.0, 1.1 * len(rows)), 3.6))
    for position, row in enumerate(rows):
        mean = row["mean_train_time"]
        axes.bar(position, mean, width=0.62, color=_COLOURS[position % len(_COLOURS)], alpha=0.85)
        axes.errorbar(position, mean, yerr=row["standard_deviation"], color="#444444", linewidth=0.9, capsize=5)
        axes.plot([position] * 2, [row["interval_low"], row["interval_high"]], color="black", linewidth=4)
        if row["num_censored"]:
            axes.annotate(
                f"{row['num_censored']} of {row['runs']}\nat the cap",
                (position, 0.03 * cap),
                ha="center",
                color="white",
                fontsize=8,
            )
    axes.axhline(cap, color="#888888", linestyle=":", linewidth=1)
    place = axes.get_yaxis_transform()
    axes.text(0.995, cap, "cap", transform=place, ha="right", va="bottom", color="#666666", fontsize=8)
    axes.set_xticks(range(len(rows)), [_label(row) for row in rows])
    axes.set_ylim(0, None)
    axes.set_ylabel("train time (episodes)")
    axes.set_title(f"{title}\nmean, 95 % interval (thick), standard deviation (thin)", fontsize=10)
    return figure


def _distributions(plt: Any, runs: pa.Table, title: str, cap: int) -> Any:
    """Histogram of train times per arm, as in Fig. 4.8; runs at the cap are hatched."""
    groups = list(runs.to_pandas().groupby(["arm", "sweep"], sort=False))
    figure, all_axes = plt.subplots(
        len(groups), 1, figsize=(6.4, 1.0 + 1.2 * len(groups)), sharex=True, sharey=True, squeeze=False
    )
    edges = np.linspace(0, cap, _NUM_BINS + 1)
    for position, ((arm, sweep), group) in enumerate(groups):
        axes = all_axes[position, 0]
        solved, censored = group[~group["censored"]], group[group["censored"]]
        colour = _COLOURS[position % len(_COLOURS)]
        axes.hist(
            [solved["train_time"], censored["train_time"]],
            bins=edges,
            stacked=True,
            color=[colour, "white"],
            edgecolor=colour,
            hatch=[None, "////"],
        )
        axes.set_ylabel("runs")
        axes.annotate(
            _label({"arm": arm, "sweep": sweep}), (0.01, 0.97), xycoords="axes fraction", va="top", weight="bold"
        )
        if len(censored):
            axes.annotate(
                f"{len(censored)} at the cap", (0.89, 0.97), xycoords="axes fraction", ha="right", va="top", fontsize=8
            )
    all_axes[-1, 0].set_xlabel("train time (episodes)")
    all_axes[0, 0].set_title(f"{title}: distribution over runs", fontsize=10)
    return figure


def _label(row: dict[str, Any]) -> str:
    return f"{row['arm']}\n{row['sweep']}" if row["sweep"] else str(row["arm"])


def _save(store: ResultStore, figure: Any, name: str, kind: str) -> str:
    buffer = io.BytesIO()
    # Without dates and versions, so that the same results give the same file.
    metadata = {"Software": None} if kind == "png" else {"Date": None}
    figure.savefig(buffer, format=kind, metadata=metadata)
    store.folder.write(name, buffer.getvalue())
    return store.folder.location(name)
