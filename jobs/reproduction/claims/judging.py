"""Verdicts on what the dissertation says of its figures, each with a statistic and an interval.

A claim holds where the whole 95 % interval lies on its side of the threshold, fails where the whole lies on the other,
and is undecided in between. A claim on every run, or on none, fails with the first run that is otherwise. Times that
are all at the cap say nothing of what lies beyond it. A claim that fails is a finding, and is reported as one.

Each verdict by itself is wrong in some 5 % of cases. After Holm's correction over all claims of the ledger that are
judged by an interval, one that is not beyond doubt is undecided: all that remain are right together in 95 % of ledgers.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from apel.numerics.intervals import CONFIDENCE
from jobs.analysis.statistics.bootstrap import Estimate
from jobs.experiment.spec import Experiment
from jobs.experiment.yaml_source import SpecError
from jobs.reproduction.claims import statistics as claim_statistics
from jobs.reproduction.claims.claim import SWITCH_METRICS, Claim, Statistic
from jobs.reproduction.claims.holm import holm
from jobs.reproduction.claims.resampled import CountedShare, Found, level_of
from jobs.reproduction.claims.samples import Results, Selected
from jobs.reproduction.claims.selection import MissingError, UnknownNameError
from jobs.reproduction.claims.stored_results import StoredResults, identified, results_of
from jobs.reproduction.claims.theories import setting_of
from jobs.results.store import ResultStore

MIN_RUNS = 20
"""Fewer runs decide nothing but counterexamples: intervals of ten skewed times miss in 10 to 31 % of all cases."""

Ruling = Literal["holds", "fails", "undecided", "missing"]
RULINGS: tuple[Ruling, ...] = ("holds", "fails", "undecided", "missing")
_TIMES = {"train_time", "adaptation_time", *SWITCH_METRICS}


@dataclass(frozen=True)
class Verdict:
    """What the results say of a claim.

    Attributes
    ----------
    estimate:
        None where results are missing.
    num_runs, num_censored:
        Runs that have all arms and points of the claim, and those of them that met the cap at one: their times are
        lower bounds.
    identity, folder:
        Of the results that it comes from, and where they are; empty where there are none.
    others:
        Identities of results of the same name in another setting, where these are all that there are.
    note:
        What to heed.
    p_value:
        The smallest level at which the interval would lie on one side as well; None where no interval decides.
    corrected_p_value:
        After Holm's correction over all claims of the ledger that have one.
    """

    claim: Claim
    ruling: Ruling
    estimate: Estimate[float] | None = None
    num_runs: int = 0
    num_censored: int = 0
    identity: str = ""
    folder: str = ""
    others: tuple[str, ...] = ()
    note: str = ""
    p_value: float | None = None
    corrected_p_value: float | None = None

    @property
    def corrected_ruling(self) -> Ruling:
        """What is left of it after Holm's correction."""
        is_doubtful = self.corrected_p_value is not None and self.corrected_p_value > 1 - CONFIDENCE
        return "undecided" if is_doubtful else self.ruling


def evaluate(
    claims: Iterable[Claim], stores: Iterable[ResultStore], experiments: Mapping[str, Experiment]
) -> list[Verdict]:
    """A verdict on each claim, from the results of the experiment that it is about.

    Parameters
    ----------
    claims:
        What is claimed.
    stores:
        Results of any experiments. Those of an experiment that only bears the same name, with a setting of its own, say
        nothing of the claims.
    experiments:
        Those that the claims are about, by name.

    Raises
    ------
    SpecError
        If a claim names an arm or a column that its experiment does not have.
    """
    found = identified(stores)
    own = {name: results_of(experiment, found) for name, experiment in experiments.items()}
    results = {name: Results(store, experiments[name]) for name, store in own.items() if store is not None}
    return _corrected(
        [
            _verdict(claim, results[claim.experiment])
            if claim.experiment in results
            else _without_results(claim, experiments[claim.experiment], found)
            for claim in claims
        ]
    )


def _corrected(verdicts: Sequence[Verdict]) -> list[Verdict]:
    corrected = iter(holm([verdict.p_value for verdict in verdicts if verdict.p_value is not None]))
    return [
        verdict if verdict.p_value is None else replace(verdict, corrected_p_value=next(corrected))
        for verdict in verdicts
    ]


def _without_results(claim: Claim, experiment: Experiment, found: Iterable[StoredResults]) -> Verdict:
    others = tuple(sorted({one.identity for one in found if one.name == experiment.name}))
    note = f"{experiment.name}: no results"
    if others:
        note += f" of {experiment.identity}; of another setting: {', '.join(others)}"
    return Verdict(claim, "missing", others=others, note=note)


def _verdict(claim: Claim, results: Results) -> Verdict:
    identity, folder = results.experiment.identity, results.store.folder.location()
    try:
        selected = results.select(claim.statistic.selection)
        found = _found(claim.statistic, selected, results.experiment)
    except MissingError as error:
        return Verdict(claim, "missing", identity=identity, folder=folder, note=str(error))
    except (UnknownNameError, ValueError) as error:
        message = f"claim {claim.id}: {error}"
        raise SpecError(message) from error
    num_runs, num_censored = len(selected.sample.values), int(selected.censored.sum())
    notes = []
    is_time = claim.statistic.metric in _TIMES and claim.statistic.of != "share"
    if num_censored and is_time:
        notes.append(f"{num_censored} of {num_runs} runs at the cap: their times are lower bounds")
    if num_runs < MIN_RUNS:
        notes.append(f"{num_runs} runs are too few to decide")
    estimate = found.estimate
    ruling, p_value = rule(claim, estimate, num_runs), _p_value(claim, found, num_runs)
    # A mean of caps is a bound, which may lie beyond a threshold; what caps differ by is nothing that was measured.
    is_bound = claim.statistic.of == "mean" and claim.statistic.over == "only"
    if is_time and selected.censored_at.all() and not (is_bound and _is_beyond(claim, estimate)):
        notes.append("all are the cap, beyond which nothing is known")
        ruling, p_value = "undecided", None
    return Verdict(
        claim, ruling, estimate, num_runs, num_censored, identity, folder, note="; ".join(notes), p_value=p_value
    )


def _is_beyond(claim: Claim, bound: Estimate[float]) -> bool:
    """Whether what is at least so much decides: above all that is claimed, or within it where it has no end."""
    low, high = claim.bounds
    return bound.low >= high or (math.isinf(high) and bound.low > low)


def _found(statistic: Statistic, selected: Selected, experiment: Experiment) -> Found:
    sample = selected.sample
    if statistic.of == "share":
        meets = np.zeros(sample.values.shape, dtype=np.bool_)
        if statistic.below is not None:
            meets |= sample.values < statistic.below
        if statistic.censored:
            meets |= selected.censored_at
        return CountedShare(np.logical_and.reduce(meets, axis=(1, 2)))
    if statistic.theory is not None:
        setting = setting_of(experiment, statistic.selection, sample.axis, statistic.since)
        return claim_statistics.against_theory(sample, statistic.of, statistic.over, statistic.theory, setting)
    return claim_statistics.measured(sample, statistic.of, statistic.over, median=statistic.location == "median")


def _p_value(claim: Claim, found: Found, num_runs: int) -> float | None:
    if claim.direction in ("every", "none") or num_runs < MIN_RUNS:
        return None
    return level_of(found, claim.bounds, are_inside=claim.direction == "between")


def rule(claim: Claim, estimate: Estimate[float], num_runs: int) -> Ruling:
    """Which side of the threshold the interval lies on. An end on the threshold is not below or above it."""
    low, high = claim.bounds
    if claim.direction in ("every", "none"):
        holds, fails = estimate.value == low, estimate.value != low
        return "fails" if fails else "holds" if holds and num_runs >= MIN_RUNS else "undecided"
    if num_runs < MIN_RUNS:
        return "undecided"
    if claim.direction == "between":
        holds, fails = low <= estimate.low and estimate.high <= high, estimate.high < low or estimate.low > high
    else:
        holds, fails = low < estimate.low and estimate.high < high, estimate.high <= low or estimate.low >= high
    return "holds" if holds else "fails" if fails else "undecided"
