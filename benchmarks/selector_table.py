"""The table of selectors, from the results of ``benchmarks/selectors/*.yaml``.

::

    for task in main redundant twenty switch pinned degrading steady frozen-lake taxi; do
        apel run benchmarks/selectors/$task.yaml --seed 20261127
    done
    python -m benchmarks.selector_table results/selectors-*/*

Means with their standard errors: episodes until the criterion held, counted from the switch where there is one, or the
mean return of the steady state. Bold are the best, and who is not told apart from it: where the 95 % interval of the
difference, run by run, holds 0.
"""

from __future__ import annotations

import argparse

import pandas as pd

from jobs.analysis.statistics.bootstrap import bootstrap_interval
from jobs.results.store import ResultStore

_METRICS = ("adaptation_time", "train_time", "steady_state")


def main() -> None:
    """Print the rows as Markdown."""
    parser = argparse.ArgumentParser()
    parser.add_argument("results", nargs="+")
    for folder in parser.parse_args().results:
        store = ResultStore.at(folder)
        runs = store.runs().to_pandas()
        arms = list(store.experiment().arms)
        print(f"| {store.experiment().name} | {' | '.join(arms)} |")
        for sweep, rows in runs.groupby("sweep", sort=False):
            print(f"| {sweep} | {' | '.join(cells(rows, arms))} |")


def cells(rows: pd.DataFrame, arms: list[str]) -> list[str]:
    """Mean and standard error of each arm at a point; bold where nobody is certainly better."""
    metric = next(name for name in _METRICS if name in rows and rows[name].notna().any())
    values = rows.pivot(index="run_index", columns="arm", values=metric)[arms]
    capped = rows.groupby("arm")["censored"].sum()
    is_return = metric == "steady_state"
    best = values.mean().idxmax() if is_return else values.mean().idxmin()
    digits = 2 if is_return else 0
    found = []
    for arm in arms:
        cell = f"{values[arm].mean():,.{digits}f} ± {values[arm].sem():,.{digits}f}"
        low, high = bootstrap_interval((values[arm] - values[best]).to_numpy())
        cell = f"**{cell}**" if low <= 0.0 <= high else cell
        num_capped = 0 if is_return else int(capped[arm])
        found.append(cell + (f" ({num_capped} at the cap)" if num_capped else ""))
    return found


if __name__ == "__main__":
    main()
