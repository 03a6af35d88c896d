"""Statistics of the ledger computed anew, by code that shares nothing with it: pandas and numpy on the Parquet files.

python -m benchmarks.recomputed RESULTS LEDGER

``RESULTS`` is the folder that the claims were judged from, ``LEDGER`` the ``claims.parquet`` that `apel claims
--output` or `apel reproduce` has written. Values have to agree to nine digits. Of some differences the interval is
computed anew, too, from resamples of its own, to a tenth of its width; Holm's correction from the p-values of the
ledger. Ends with 1 where anything differs.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from scipy import stats

RELATIVE = 1e-9
WIDTHS = 0.1


def runs_of(folder: Path, arm: str, **where: Any) -> pd.DataFrame:
    """The run rows of an arm, by run; with the given values of columns, where the arm has any."""
    rows = pd.read_parquet(folder / "runs.parquet")
    rows = rows[rows["arm"] == arm]
    for column, value in where.items():
        rows = rows[rows[column].isna() | (rows[column] == value)]
    return rows.set_index("run_index").sort_index()


def difference(folder: Path, metric: str, first: str, second: str, **where: Any) -> pd.Series[float]:
    """Run by run."""
    return (runs_of(folder, first, **where)[metric] - runs_of(folder, second, **where)[metric]).dropna()


def means_over(folder: Path, metric: str, arm: str, axis: str, **where: Any) -> pd.Series[float]:
    """Means by the values of a swept column, of the runs that have all of them."""
    table = runs_of(folder, arm, **where).pivot_table(index="run_index", columns=axis, values=metric, dropna=False)
    return table.dropna().mean()


def deviations(folder: Path, metric: str, first: str, second: str, **where: Any) -> float:
    """Ratio of standard deviations."""
    both = pd.concat([runs_of(folder, arm, **where)[metric] for arm in (first, second)], axis=1).dropna()
    one, other = both.std(ddof=1)
    return float(one / other)


def r_squared(means: pd.Series[float]) -> float:
    """Of the line through them."""
    return float(stats.linregress(means.index.to_numpy(float), means.to_numpy()).rvalue ** 2)


def fast_or_never(folder: Path) -> float:
    """Share of the runs below 1000, or at the cap."""
    rows = runs_of(folder, "Q_red")
    return float(((rows["train_time"] < 1000) | rows["censored"]).mean())


def where_red_fails(folder: Path) -> float:
    """Ratio of means in the runs in which Q_red meets the cap."""
    fails = runs_of(folder, "Q_red")["censored"]
    one, other = (runs_of(folder, arm)["train_time"][fails].mean() for arm in ("APEL", "Q_full"))
    return float(one / other)


def excess(means: pd.Series[float], at: float) -> float:
    """Of one mean over the smallest of the others."""
    return float(means[at] - means.drop(at).min())


def widening(folder: Path) -> float:
    """How much more many bad learners cost than many good ones with 20 than with 5."""
    gaps = [difference(folder, "train_time", "many_red", "many_full", decay=0.01, n=count).mean() for count in (20, 5)]
    return float(gaps[0] - gaps[1])


def medians_apart(folder: Path) -> float:
    """Median of SSBAS on normalised returns minus that of APEL."""
    where = {"reading": "moves", "switch_episode": 1000}
    one, other = (runs_of(folder, arm, **where)["adaptation_time"].median() for arm in ("SSBAS_normalised", "APEL"))
    return float(one - other)


def concentration_gap(folder: Path) -> float:
    """Largest of |C / (1 / ν − 2) − 1| over ν, C of the better learner, a mean over the second half of all episodes."""
    episodes = pd.read_parquet(folder / "episodes" / "arm=APEL_bad")
    late = episodes[episodes["episode"].between(10_000, 19_999)]
    found = late.assign(first=late["concentration"].str[0]).groupby(["sweep", "run_index"])["first"].mean()
    decays = runs_of(folder, "APEL_bad").groupby("sweep")["decay"].first()
    by_decay = found.groupby("sweep").mean().rename(index=decays)
    return float((by_decay / (1 / by_decay.index.to_numpy(float) - 2) - 1).abs().max())


def growth(means: pd.Series[float], last: float, first: float) -> float:
    """One mean over another."""
    return float(means[last] / means[first])


VALUES: dict[str, Callable[[Path], float]] = {
    "train-time-apel-below-ssbas": lambda at: float(difference(at, "train_time", "APEL", "SSBAS").mean()),
    "train-time-apel-below-q_red": lambda at: float(difference(at, "train_time", "APEL", "Q_red").mean()),
    "full-always-finishes": lambda at: float(runs_of(at, "Q_full")["censored"].mean()),
    "red-fast-or-never": fast_or_never,
    "apel-picks-full-elsewhere": where_red_fails,
    "adaptation-apel-constant": lambda at: (lambda means: float(means.max() / means.min()))(
        means_over(at, "adaptation_time", "APEL", "switch_episode", decay=0.01)
    ),
    "adaptation-ssbas-spread-20000": lambda at: deviations(
        at, "adaptation_time", "SSBAS", "APEL", decay=0.01, switch_episode=20000
    ),
    "decay-tenfold-001": lambda at: growth(means_over(at, "adaptation_time", "APEL", "decay"), 0.001, 0.01),
    "normalised-ssbas-slower-1000-median": medians_apart,
    "bad-learner-linear": lambda at: r_squared(means_over(at, "steady_state", "APEL_bad", "decay")),
    "concentration-as-model": concentration_gap,
    "decay-orders-adaptation-time": lambda at: (lambda means: float(stats.spearmanr(means.index, means).statistic))(
        means_over(at, "adaptation_time", "APEL", "decay")
    ),
    "exploration-best-adaptation-time": lambda at: excess(
        means_over(at, "adaptation_time", "SSBAS", "exploration"), 4.921
    ),
    "many-red-worse-beyond-five": widening,
}
DIFFERENCES: dict[str, Callable[[Path], pd.Series[float]]] = {
    "train-time-apel-below-ssbas": lambda at: difference(at, "train_time", "APEL", "SSBAS"),
    "train-time-apel-below-q_red": lambda at: difference(at, "train_time", "APEL", "Q_red"),
    "many-red-worse-no-decay": lambda at: difference(at, "train_time", "many_red", "many_full", decay=0.0, n=20),
}


def interval(values: pd.Series[float]) -> tuple[float, float]:
    """Expanded percentiles of the mean of runs that are drawn anew."""
    count = len(values)
    means = np.random.default_rng(7).choice(values.to_numpy(), (20_000, count)).mean(axis=1)
    tail = stats.norm.cdf(stats.t.ppf(0.025, count - 1) * np.sqrt(count / (count - 1)))
    low, high = np.quantile(means, [tail, 1 - tail])
    return float(low), float(high)


def holm(levels: pd.Series[float]) -> pd.Series[float]:
    """Corrected p-values."""
    ordered = levels.sort_values()
    return (ordered * np.arange(len(ordered), 0, -1)).cummax().clip(upper=1.0)


def main() -> int:
    """Print both side by side."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("results", type=Path)
    parser.add_argument("ledger", type=Path)
    options = parser.parse_args()
    ledger = pd.read_parquet(options.ledger).set_index("id")
    num_differing = num_compared = 0

    def compare(name: str, here: float, there: float, allowed: float) -> None:
        nonlocal num_differing, num_compared
        agrees = abs(here - there) <= allowed
        num_differing, num_compared = num_differing + (not agrees), num_compared + 1
        print(f"{name:52} {here:>16.9g} {there:>16.9g} {'' if agrees else 'DIFFERS'}")

    print(f"{'':52} {'here':>16} {'ledger':>16}")
    for name, compute in VALUES.items():
        row = ledger.loc[name]
        folder = options.results / row["experiment"] / str(row["identity"])
        if row["verdict"] == "missing":
            print(f"{name:52} no results")
            continue
        compare(name, compute(folder), row["value"], RELATIVE * abs(row["value"]))
    for name, differences in DIFFERENCES.items():
        row = ledger.loc[name]
        if row["verdict"] == "missing":
            continue
        low, high = interval(differences(options.results / row["experiment"] / str(row["identity"])))
        compare(f"{name}, low", low, row["interval_low"], WIDTHS * (high - low))
        compare(f"{name}, high", high, row["interval_high"], WIDTHS * (high - low))
    corrected = holm(ledger["p_value"].dropna())
    theirs = ledger["corrected_p_value"].dropna()
    compare(f"sum of {len(corrected)} p after Holm", corrected.sum(), theirs.sum(), RELATIVE * len(corrected))
    compare("largest difference of one", float((corrected - theirs).abs().max()), 0.0, RELATIVE)
    print(f"{num_compared} compared, {num_differing} differ")
    return 1 if num_differing or not num_compared else 0


if __name__ == "__main__":
    sys.exit(main())
