"""The oracle: of each run, the best of several arms, as one knows it afterwards."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd
import pyarrow as pa

from jobs.results.tables import LATE_RETURN


def with_hindsight(runs: pa.Table, hindsight: Mapping[str, Sequence[str]]) -> pa.Table:
    """Append one row per run for each arm of ``hindsight``: the best row among those of the arms that it lists.

    Best is the shortest train time, one that is censored after all others; at equal ones the highest steady state, or,
    without a criterion and without that, the highest return of the last tenth; then the first arm. A run counts where
    all of the arms have finished it; the column ``chosen`` names the arm that the row was taken from.
    """
    if not hindsight:
        return runs
    frame = runs.to_pandas(types_mapper=pd.ArrowDtype)
    chosen = [_best(frame, arm, sources) for arm, sources in hindsight.items()]
    joined = pd.concat([frame.assign(chosen=pd.Series(pd.NA, frame.index, pd.ArrowDtype(pa.string()))), *chosen])
    return pa.Table.from_pandas(joined, preserve_index=False).replace_schema_metadata(None)


def _return(rows: pd.DataFrame) -> pd.Series[float]:
    """What runs are compared by besides their train times."""
    steady = rows["steady_state"].astype(float)
    if steady.isna().all() and rows["censored"].isna().all() and LATE_RETURN in rows:
        steady = rows[LATE_RETURN].astype(float)
    return steady.fillna(0.0)


def _best(frame: pd.DataFrame, arm: str, sources: Sequence[str]) -> pd.DataFrame:
    rows = frame[frame["arm"].isin(sources)]
    sweeps = {label: place for place, label in enumerate(dict.fromkeys(rows["sweep"]))}
    order = rows[["sweep", "run_index"]].assign(
        _censored=rows["censored"].astype(float).fillna(0.0),
        _time=rows["train_time"].astype(float).fillna(0.0),
        _return=-_return(rows),
        _sweep=rows["sweep"].map(sweeps).astype(np.int64),
        _place=rows["arm"].map({source: place for place, source in enumerate(sources)}).astype(np.int64),
    )
    key = ["sweep", "run_index"]
    complete = order.groupby(key)["_place"].transform("nunique") == len(set(sources))
    best = order[complete].sort_values(["_censored", "_time", "_return", "_place"]).groupby(key, sort=False).head(1)
    best = rows.loc[best.sort_values(["_sweep", "run_index"]).index]
    taken = best["arm"].astype(pd.ArrowDtype(pa.string()))
    return best.assign(chosen=taken, arm=arm)
