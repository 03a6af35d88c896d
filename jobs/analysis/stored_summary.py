"""The summary of stored results: as it lies there, or made anew from the runs."""

from __future__ import annotations

import pyarrow as pa

from jobs.results.store import ResultStore, StoreError

_NEEDED = ("episodes", "steps", "censored")


def stored_summary(store: ResultStore) -> pa.Table:
    """One row per arm and sweep point; see `jobs.analysis.statistics.summarise`.

    Raises
    ------
    StoreError
        If there are no runs that can be read.
    """
    try:
        return store.summary()
    except StoreError:
        runs = store.runs()
    missing = [name for name in _NEEDED if name not in runs.column_names]
    if missing:
        place = store.folder.location("runs.parquet")
        message = f"{place}: found no column {', '.join(missing)}, expected the rows that `apel run` stores"
        raise StoreError(message)
    # With scipy's statistics, which take half a second to import.
    from jobs.analysis.statistics import summarise

    return summarise(store.counted_runs())
