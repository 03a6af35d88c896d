"""Which runs are to be played next: all that are missing, or more and more of them until the best arm is decided.

What comes next follows from the rows that are there, and from nothing else: an interrupted job goes on.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Protocol

import pyarrow as pa

from jobs.experiment.plan import Plan, RunKey
from jobs.experiment.yaml_source import SpecError
from jobs.results.store import StoreError

if TYPE_CHECKING:
    from jobs.analysis.statistics.bootstrap import Floats
    from jobs.analysis.statistics.sequential import Decision

_GROWTH = 1.25
_MOST_ARMS = 32


class Rounds(Protocol):
    """Says which runs are to be played."""

    def next(self, finished: Collection[RunKey]) -> Plan | None:
        """A plan with runs that are not ``finished``; None when all is done."""

    def told(self, finished: Collection[RunKey]) -> str:
        """What people should know once all is done; empty for nothing."""


@dataclass(frozen=True)
class AllAtOnce:
    """All runs of a plan."""

    plan: Plan

    def next(self, finished: Collection[RunKey]) -> Plan | None:
        """See `Rounds`."""
        return self.plan if any(key not in finished for key in self.plan.run_keys()) else None

    def told(self, finished: Collection[RunKey]) -> str:  # noqa: ARG002
        """See `Rounds`."""
        return ""


class UntilDecided:
    """More and more runs of a plan, until one arm is known to be the best; see `jobs.analysis.statistics.sequential`.

    An arm that another one has beaten gets no more runs.

    Parameters
    ----------
    plan:
        All runs that there may be.
    error:
        With which probability an arm may be called the best that is not.
    rows:
        Reads the run rows of those that are finished.
    """

    def __init__(self, plan: Plan, error: float, rows: Callable[[], pa.Table]) -> None:
        self._plan, self._error, self._rows = plan, error, rows

    def next(self, finished: Collection[RunKey]) -> Plan | None:
        """See `Rounds`.

        Raises
        ------
        StoreError
            If the measure that decides is not known of a run.
        """
        return self._walk(finished)[0]

    def told(self, finished: Collection[RunKey]) -> str:
        """See `Rounds`."""
        _, num_runs, best = self._walk(finished)
        saved = sum(key not in finished for key in self._plan.run_keys())
        planned = len(self._plan.seeds) * len(self._plan.arm_points)
        what = f"{best} is the best" if best else f"with {num_runs} runs it is not decided which arm is the best"
        return f"no more runs: {what}, at an error of {100 * self._error:.3g} %; {saved} of {planned} runs were saved"

    def _walk(self, finished: Collection[RunKey]) -> tuple[Plan | None, int, str | None]:
        """The round that is to be played, runs of the arms that are left in it or in the last one, and the best arm."""
        arms = [one.arm for one in self._plan.arm_points]
        left, count, known = arms, 0, None
        for count in _sizes(len(self._plan.seeds), len(arms), self._error):
            due = replace(self._plan.only(left), seeds=self._plan.seeds[:count])
            if any(key not in finished for key in due.run_keys()):
                return due, count, None
            known = self._values() if known is None else known
            values, smaller_is_better = known
            decision = self._decide(values[:count], smaller_is_better)
            if decision.best is not None:
                return None, count, arms[decision.best]
            left = [arms[place] for place in decision.left]
        return None, count, None

    def _values(self) -> tuple[Floats, bool]:
        """What decides, by run index and arm, and whether less of it is better."""
        from jobs.analysis.answer.contests import contests
        from jobs.analysis.answer.measures import deciding, run_rows

        names = [one.arm for one in self._plan.arm_points]
        candidates = [one for one in contests(self._plan.experiment)[0].candidates if one.name in names]
        measure = deciding(self._plan.experiment, run_rows(self._rows(), candidates))
        if measure is None:
            message = (
                "--until: found runs without a known final return, expected all to have one: --fresh plays them again"
            )
            raise StoreError(message)
        return measure.values, measure.smaller_is_better

    def _decide(self, values: Floats, smaller_is_better: bool) -> Decision:
        # With scipy's statistics, which take half a second to import.
        from jobs.analysis.statistics.sequential import decide

        seed = self._plan.experiment.seed
        return decide(values, smaller_is_better=smaller_is_better, error=self._error, seed=seed)


def refuse_undecidable(plan: Plan, error: float) -> None:
    """See that a plan has arms of which one can be the best, and be known to be with this error.

    Raises
    ------
    SpecError
        If it has a sweep, or not two arms, or if the error is so small that no number of runs decides.
    """
    sweep, arms = plan.experiment.sweep, len(plan.arm_points)
    if sweep:
        where = plan.experiment.where("sweep")
        message = (
            f"{where}: found a sweep, expected none with --until decided, which compares arms: make arms of its points"
        )
        raise SpecError(message)
    if not 2 <= arms <= _MOST_ARMS:
        message = f"--until: found {arms} arms to be played, expected 2 to {_MOST_ARMS}, one of which can be the best"
        raise SpecError(message)
    refuse_error(arms, error)


def refuse_error(num_candidates: int, error: float) -> None:
    """See that the best of so many candidates can be known with this error.

    Raises
    ------
    SpecError
        If no number of runs decides.
    """
    from jobs.analysis.statistics.sequential import least_error

    if error <= (least := least_error(num_candidates)):
        message = (
            f"--error: found {error:g}, expected more than {least:.6g} with {num_candidates} to be compared: "
            "with less no number of runs decides"
        )
        raise SpecError(message)


def _sizes(most: int, num_arms: int, error: float) -> Iterator[int]:
    """Runs of an arm after each round: as many as can decide at all, and then a quarter more each time.

    >>> list(_sizes(30, 2, 0.05)), list(_sizes(5, 2, 0.05))
    ([8, 10, 13, 17, 22, 28, 30], [5])
    """
    from jobs.analysis.statistics.sequential import first_look

    size = min(first_look(num_arms, error), most)
    while size < most:
        yield size
        size = min(math.ceil(_GROWTH * size), most)
    yield size
