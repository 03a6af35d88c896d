"""Draws the picture of the README from the rows of `idea.yaml`.

apel run docs/idea/idea.yaml --results idea-results
python docs/idea/draw.py idea-results/idea/*
"""

import sys
from pathlib import Path

import matplotlib.pyplot as plt
import pandas as pd

COLOURS = {"quick": "#009e73", "late": "#e69f00", "ensemble": "#0072b2"}
PLACES = {"quick": (1750, -6.6), "late": (700, -15.5), "ensemble": (1230, -1.2)}
SMOOTH = 25  # episodes


def main(results: Path) -> None:
    """Above: mean return of each arm. Below: which share of the runs gave an episode to whom."""
    episodes = pd.read_parquet(results / "episodes", columns=["arm", "run_index", "episode", "selected", "return"])
    returns = episodes.pivot_table(index="episode", columns="arm", values="return", observed=True)
    returns = returns.rolling(SMOOTH, min_periods=1).mean()
    share = episodes[episodes["arm"] == "ensemble"].groupby("episode")["selected"].mean()
    share = share.rolling(SMOOTH, min_periods=1).mean()

    plt.rcParams |= {"font.size": 11, "axes.spines.top": False, "axes.spines.right": False, "svg.hashsalt": "idea"}
    figure, (above, below) = plt.subplots(2, sharex=True, figsize=(8, 4.6), height_ratios=(3, 2), layout="constrained")
    for arm, colour in COLOURS.items():
        above.plot(returns.index, returns[arm], color=colour, linewidth=3 if arm == "ensemble" else 2)
        above.text(*PLACES[arm], arm, color=colour, weight="bold")
    above.set(ylim=(-20, 0), ylabel="mean return")
    below.stackplot(share.index, 1 - share, share, colors=[COLOURS["quick"], COLOURS["late"]], alpha=0.8)
    below.text(500, 0.5, "quick acts", color="white", weight="bold", ha="center", va="center")
    below.text(1950, 0.5, "late acts", color="black", weight="bold", ha="center", va="center")
    below.set(xlim=(0, share.index.max()), ylim=(0, 1), xlabel="episode", ylabel="share of the\nensemble's runs")
    figure.align_ylabels()
    figure.savefig(Path(__file__).with_name("idea.png"), dpi=130, facecolor="white", metadata={"Software": None})


if __name__ == "__main__":
    main(Path(sys.argv[1]))
