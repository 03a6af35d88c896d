"""An experiment in one call: environment, learners and selector as a script or a notebook has them."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from contextlib import nullcontext
from typing import Any

from cluster.errors import grouped
from jobs.cli.consoles import ERR, OUT
from jobs.experiment.plan import Plan
from jobs.precautions import refuse_shadowing
from jobs.progress.observers import Observer, Observers
from jobs.progress.terminal import NoteObserver, TerminalObserver
from jobs.runner import Outcome, Placement, Settings, run_planned
from jobs.script.parts import Described, described_experiment
from jobs.script.results import Results


class FailedRunsError(RuntimeError):
    """Some runs failed.

    Attributes
    ----------
    results:
        Of the others; None where there is none.
    """

    def __init__(self, outcome: Outcome, results: Results | None) -> None:
        super().__init__("\n".join(grouped(outcome.failures)))
        self.results = results


def run(
    *,
    environment: Described,
    learners: Mapping[str, Described],
    selector: Any = "apel",
    runs: int = 20,
    episodes: int = 500,
    steps: int | None = None,
    seed: int = 1234,
    name: str = "script",
    alone: bool = True,
    performance: Any = "return",
    criterion: Mapping[str, Any] | None = None,
    record: Any = "all",
    models: Any = "none",
    results: str = "results",
    placement: Placement = "actors",
    shard_size: int | None = None,
    address: str | None = None,
    num_cpus: int | None = None,
    fresh: bool = False,
    quiet: bool = False,
) -> Results:
    """Run an ensemble of learners, and each of them alone, over many seeds; or go on where the same call stopped.

    Parts are classes and functions of the script's own (``__main__`` included: they are sent to other processes by
    value), names as in an experiment file, or mappings of a name (``id`` of an environment, ``type`` of others) with
    options. What is there already is not computed again: results belong to an identity that changes with whatever
    changes a row. Of a user's modules with files it covers these files, of what stands in the script or the notebook
    itself the compiled code with all that it names (`jobs.script.code_digests`).

    Parameters
    ----------
    environment:
        A class, or a function, that returns one; a Gymnasium id; or a mapping with ``id``, ``options`` and so on.
    learners:
        By the names under which results speak of them.
    selector:
        Of several learners; also one that is made, such as ``apel.Apel(decay=0.02)``.
    runs, episodes, steps, seed, performance, criterion, record, models:
        As in an experiment file (`jobs.experiment.spec.Experiment`); every episode is recorded unless said otherwise.
        Without ``models`` an agent is had by playing its run again.
    name:
        Of the folder of its results.
    alone:
        Whether every learner of several is played by itself, too, to be compared with.
    results:
        Folder or URI that they lie in.
    placement, shard_size, address, num_cpus, fresh:
        See `jobs.Settings`; none of them changes a row.
    quiet:
        No progress is shown.

    Raises
    ------
    SpecError
        If something is not as it should be; before anything is started or written.
    FailedRunsError
        If runs failed.
    """
    refuse_shadowing()
    fields = {
        "name": name, "runs": runs, "episodes": episodes, "steps": steps, "seed": seed, "criterion": criterion,
        "record": record, "models": models,
    }  # fmt: skip
    experiment, modules = described_experiment(fields, environment, learners, selector, performance, alone=alone)
    settings = Settings(
        results=results, placement=placement, shard_size=shard_size, address=address, num_cpus=num_cpus, fresh=fresh
    )
    observers: list[Observer] = [NoteObserver(ERR), *([] if quiet else [TerminalObserver(OUT)])]
    with nullcontext() if placement == "local" else _shipped(modules):
        outcome = run_planned(Plan.of(experiment), settings, Observers(observers))
    found = Results(outcome.store, experiment) if len(outcome.summary) else None
    if outcome.failures or found is None:
        raise FailedRunsError(outcome, found)
    return found


def _shipped(modules: set[str]) -> Any:
    from cluster.by_value import shipped_by_value

    return shipped_by_value(modules & set(sys.modules))  # of the others, nothing can have been made yet
