"""Which folders hold results, and which of them are an experiment's own."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from jobs.experiment.spec import Experiment
from jobs.results.finding import stores_below
from jobs.results.places import redacted
from jobs.results.store import ResultStore, StoreError


@dataclass(frozen=True)
class StoredResults:
    """Some results, and whose they were when they were played: the experiment's name and its identity."""

    store: ResultStore
    name: str
    identity: str


def identified(stores: Iterable[ResultStore]) -> list[StoredResults]:
    """Whose results these are, by their manifest; by their experiment file where there is none."""
    found = []
    for store in stores:
        manifest = store.manifest()
        if not {"experiment", "identity"} <= manifest.keys():
            experiment = store.experiment()
            manifest = {"experiment": experiment.name, "identity": experiment.identity}
        found.append(StoredResults(store, manifest["experiment"], manifest["identity"]))
    return found


def results_of(experiment: Experiment, found: Iterable[StoredResults]) -> ResultStore | None:
    """Those of the very experiment, by its identity: the ones with most rows, the last of equal ones.

    Of the same identity are results of more and of fewer runs: they have the same rows as far as they go.
    """
    own = [one.store for one in found if one.identity == experiment.identity]
    if len(own) < 2:
        return own[0] if own else None
    return max(reversed(own), key=lambda store: store.runs().num_rows)


def found_stores(locations: Sequence[str]) -> list[ResultStore]:
    """All results below some folders, the newest last.

    Parameters
    ----------
    locations:
        Results roots, folders of an experiment, or of one of its identities.

    Raises
    ------
    StoreError
        If one of them is no folder with results.
    """
    found: list[tuple[float, ResultStore]] = []
    for location in locations:
        below = stores_below(location, lambda _: None)
        if not below:
            message = f"{redacted(location)}: found no results, expected a folder of results or of an experiment"
            raise StoreError(message)
        found += below
    return [store for _, store in sorted(found, key=lambda pair: pair[0])]
