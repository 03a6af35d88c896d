"""Results below a folder, and those that a reader means who names it."""

from __future__ import annotations

from collections.abc import Callable

from jobs.results.places import joined
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
    below = [found for _, found in stores_below(location, say)]
    if len(below) > 1:
        shown = ", ".join(found.folder.location() for found in below[:_MOST_SHOWN])
        more = f" and {len(below) - _MOST_SHOWN} more" if len(below) > _MOST_SHOWN else ""
        message = f"{folder.location()}: found {len(below)} results below it, expected one of them: {shown}{more}"
        raise StoreError(message)
    return below[0] if below else store


def stores_below(location: str, say: Callable[[str], None]) -> list[tuple[float, ResultStore]]:
    """All folders with a ``runs.parquet``, at most two levels down, and when that was written.

    Raises
    ------
    StoreError
        If there is a file in the place of the folder.
    """
    level, found = [location], []
    for _ in range(3):
        below = []
        for place in level:
            store = ResultStore.at(place, say)
            if place == location and store.folder.written() is not None:
                message = f"{store.folder.location()}: found a file, expected a folder with results"
                raise StoreError(message)
            written = None if store.folder.is_link(_RUNS) else store.folder.written(_RUNS)
            if written is not None:
                found.append((written, store))
                continue
            below += [joined(place, name) for name in store.folder.top_folder_names()]
        level = sorted(below)
    return found
