"""Results below a folder, and those that a reader means who names it."""

from __future__ import annotations

from collections.abc import Callable

from pyarrow import fs

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
    """All folders with a ``runs.parquet``, at most two levels down, and when that was written."""
    level, found = [location], []
    for _ in range(3):
        below = []
        for place in level:
            store = ResultStore.at(place, say)
            (info,) = store.folder.filesystem.get_file_info([store.folder.path(_RUNS)])
            if info.type == fs.FileType.File and not store.folder.is_link(_RUNS):
                found.append((info.mtime.timestamp() if info.mtime else 0.0, store))
                continue
            selector = fs.FileSelector(store.folder.path(), allow_not_found=True)
            infos = store.folder.filesystem.get_file_info(selector)
            names = [info.base_name for info in infos if info.type == fs.FileType.Directory]
            below += [joined(place, name) for name in names if not store.folder.is_link(name)]
        level = sorted(below)
    return found
