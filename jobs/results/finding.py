"""The results that a reader means: those in a folder, or the only ones below it."""

from __future__ import annotations

from collections.abc import Callable

from jobs.results.sinks import SPEC_FILE
from jobs.results.store import ResultStore, StoreError

_RUNS = "runs.parquet"
_MOST_SHOWN = 5


def results_at(location: str, say: Callable[[str], None]) -> ResultStore:
    """The results in a folder, or, of an experiment's folder or a root of results, the only ones there.

    Parameters
    ----------
    location:
        Path or URI.
    say:
        Is told what was not as it should be.

    Raises
    ------
    StoreError
        If there are the results of several experiments, or of several settings of one.
    """
    store = ResultStore.at(location, say)
    folder = store.folder
    if folder.exists(_RUNS) or folder.exists(SPEC_FILE):
        return store
    near = [name for name in sorted(folder.folder_names()) if name.count("/") < 2]
    below = [name for name in near if folder.sub(name).exists(_RUNS) and not folder.is_link(f"{name}/{_RUNS}")]
    if len(below) > 1:
        shown = ", ".join(folder.location(name) for name in below[:_MOST_SHOWN])
        more = f" and {len(below) - _MOST_SHOWN} more" if len(below) > _MOST_SHOWN else ""
        message = f"{folder.location()}: found {len(below)} results below it, expected one of them: {shown}{more}"
        raise StoreError(message)
    return ResultStore(folder.sub(below[0]), say) if below else store
