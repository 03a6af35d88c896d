"""The ledger of claims: what the dissertation says of its figures, each with a statistic, an interval and a verdict.

A claim holds where the whole 95 % interval lies on its side of the threshold, fails where the whole lies on the other,
and is undecided in between. A claim on every run, or on none, fails with the first run that is otherwise. A claim that
fails is a finding, and is reported as one.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import pyarrow as pa
from pyarrow import fs

from cluster.storage import joined, redacted
from jobs.analysis import claim_statistics
from jobs.analysis.bootstrap import Estimate
from jobs.analysis.claim_models import SWITCH_METRICS, Claim, Statistic, read_claims, shipped_claims
from jobs.analysis.claim_samples import Results
from jobs.analysis.claim_selection import MissingError, UnknownNameError
from jobs.store import ResultStore, StoreError
from jobs.yaml_source import SpecError

__all__ = [
    "MIN_RUNS", "RULINGS", "Claim", "Ruling", "Verdict", "claims_markdown", "claims_table", "evaluate", "found_stores",
    "read_claims", "rule", "shipped_claims",
]  # fmt: skip

MIN_RUNS = 5
"""Fewer runs decide nothing but counterexamples: their bootstrap knows too little of the spread."""

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
    identity:
        Of the results.
    note:
        What to heed.
    """

    claim: Claim
    ruling: Ruling
    estimate: Estimate[float] | None = None
    num_runs: int = 0
    num_censored: int = 0
    identity: str = ""
    note: str = ""


def evaluate(claims: Iterable[Claim], stores: Iterable[ResultStore]) -> list[Verdict]:
    """A verdict on each claim, from the results of the experiment that it names.

    Raises
    ------
    SpecError
        If a claim names an arm or a column that its experiment does not have.
    """
    results = {found.experiment.name: found for found in map(Results, stores)}
    return [_verdict(claim, results.get(claim.experiment)) for claim in claims]


def _verdict(claim: Claim, results: Results | None) -> Verdict:
    if results is None:
        return Verdict(claim, "missing", note=f"{claim.experiment}: no results")
    identity = results.experiment.identity
    try:
        estimate, num_runs, num_censored = _estimate(claim.statistic, results)
    except MissingError as error:
        return Verdict(claim, "missing", identity=identity, note=str(error))
    except (UnknownNameError, ValueError) as error:
        message = f"claim {claim.id}: {error}"
        raise SpecError(message) from error
    notes = []
    if num_censored and claim.statistic.metric in _TIMES and claim.statistic.of != "share":
        notes.append(f"{num_censored} of {num_runs} runs at the cap: their times are lower bounds")
    if num_runs < MIN_RUNS:
        notes.append(f"{num_runs} runs are too few to decide")
    ruling = rule(claim, estimate, num_runs)
    return Verdict(claim, ruling, estimate, num_runs, num_censored, identity, "; ".join(notes))


def _estimate(statistic: Statistic, results: Results) -> tuple[Estimate[float], int, int]:
    selected = results.select(statistic.selection)
    sample, censored = selected.sample, selected.censored
    if statistic.of == "share":
        meets = np.zeros(sample.values.shape, dtype=np.bool_)
        if statistic.below is not None:
            meets |= sample.values < statistic.below
        if statistic.censored:
            meets |= selected.censored_at
        estimate = claim_statistics.share(np.logical_and.reduce(meets, axis=(1, 2)))
    elif statistic.theory is not None:
        estimate = claim_statistics.against_theory(
            sample, statistic.of, statistic.over, statistic.theory, statistic.since
        )
    else:
        estimate = claim_statistics.measured(
            sample, statistic.of, statistic.over, median=statistic.location == "median"
        )
    return estimate, len(sample.values), int(censored.sum())


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


def found_stores(locations: Sequence[str]) -> list[ResultStore]:
    """The newest results of each experiment below some folders.

    Parameters
    ----------
    locations:
        Results roots, folders of an experiment, or of one of its identities.

    Raises
    ------
    StoreError
        If one of them is no folder with results.
    """
    newest: dict[str, tuple[float, ResultStore]] = {}
    for location in locations:
        found = _stores_below(location)
        if not found:
            message = f"{redacted(location)}: found no results, expected a folder of results or of an experiment"
            raise StoreError(message)
        for time, store in found:
            name = store.experiment().name
            if name not in newest or time > newest[name][0]:
                newest[name] = time, store
    return [store for _, store in newest.values()]


def _stores_below(location: str) -> list[tuple[float, ResultStore]]:
    """All folders with a ``runs.parquet``, at most two levels down, and when that was written."""
    level, found = [location], []
    for _ in range(3):
        below = []
        for place in level:
            store = ResultStore.at(place)
            (info,) = store.folder.filesystem.get_file_info([store.folder.path("runs.parquet")])
            if info.type == fs.FileType.File:
                found.append((info.mtime.timestamp() if info.mtime else 0.0, store))
                continue
            selector = fs.FileSelector(store.folder.path(), allow_not_found=True)
            infos = store.folder.filesystem.get_file_info(selector)
            below += [joined(place, info.base_name) for info in infos if info.type == fs.FileType.Directory]
        level = sorted(below)
    return found


def claims_table(verdicts: Sequence[Verdict]) -> pa.Table:
    """One row per claim, for ``claims.parquet``."""
    rows = [_row(verdict) for verdict in verdicts]
    return pa.Table.from_pylist(rows, schema=_SCHEMA)


def _row(verdict: Verdict) -> dict[str, object]:
    claim, estimate = verdict.claim, verdict.estimate
    low, high = (None if math.isinf(edge) else edge for edge in claim.bounds)
    return {
        "id": claim.id,
        "source": claim.source,
        "claim": claim.text,
        "experiment": claim.experiment,
        "identity": verdict.identity or None,
        "statistic": str(claim.statistic),
        "value": estimate.value if estimate else None,
        "interval_low": estimate.low if estimate else None,
        "interval_high": estimate.high if estimate else None,
        "direction": claim.direction,
        "threshold_low": low,
        "threshold_high": high,
        "verdict": verdict.ruling,
        "expected": claim.expected,
        "runs": verdict.num_runs,
        "censored": verdict.num_censored,
        "note": verdict.note,
    }


_TEXTS = ("id", "source", "claim", "experiment", "identity", "statistic")
_NUMBERS = ("value", "interval_low", "interval_high")
_SCHEMA = pa.schema(
    [(name, pa.string()) for name in _TEXTS]
    + [(name, pa.float64()) for name in _NUMBERS]
    + [("direction", pa.string()), ("threshold_low", pa.float64()), ("threshold_high", pa.float64())]
    + [("verdict", pa.string()), ("expected", pa.string()), ("runs", pa.int64()), ("censored", pa.int64())]
    + [("note", pa.string())]
)
HEADINGS = (
    "claim", "figure", "what is claimed", "statistic", "value", "95 % interval", "claimed", "verdict", "expected",
    "runs", "censored", "note",
)  # fmt: skip


def cells(verdict: Verdict) -> list[str]:
    """A verdict as text, one cell for each of `HEADINGS`."""
    claim, estimate = verdict.claim, verdict.estimate
    has_runs = verdict.num_runs > 0
    return [
        claim.id,
        claim.source,
        claim.text,
        str(claim.statistic),
        _number(estimate.value) if estimate else "-",
        f"{_number(estimate.low)} to {_number(estimate.high)}" if estimate else "-",
        _claimed(claim),
        verdict.ruling,
        claim.expected,
        str(verdict.num_runs) if has_runs else "-",
        str(verdict.num_censored) if has_runs else "-",
        verdict.note,
    ]


def count_line(verdicts: Sequence[Verdict]) -> str:
    """How many claims hold, fail, and so on."""
    counts = {ruling: sum(verdict.ruling == ruling for verdict in verdicts) for ruling in RULINGS}
    return f"{len(verdicts)} claims: " + ", ".join(f"{count} {ruling}" for ruling, count in counts.items())


def claims_markdown(verdicts: Sequence[Verdict]) -> str:
    """The ledger as a page."""
    rows = [list(HEADINGS), ["---"] * len(HEADINGS), *(cells(verdict) for verdict in verdicts)]
    lines = ["| " + " | ".join(cell.replace("|", "\\|").replace("\n", " ") for cell in row) + " |" for row in rows]
    legend = (
        "A claim holds where the whole 95 % interval lies on the claimed side, fails where the whole lies on the "
        "other, and is undecided otherwise. A claim on every run, or on none, fails with the first run that is "
        f"otherwise. Fewer than {MIN_RUNS} runs decide only that. Arms of one experiment share their runs, and are "
        "compared in pairs. Censored runs count with their cap, which is a lower bound."
    )
    return "\n".join(["# Claims", "", f"{count_line(verdicts)}.", "", legend, "", *lines, ""])


def _claimed(claim: Claim) -> str:
    if isinstance(claim.threshold, tuple):
        return f"{claim.threshold[0]:g} to {claim.threshold[1]:g}"
    if claim.threshold is None:
        return {"every": "every run", "none": "no run"}[claim.direction]
    return f"{'<' if claim.direction == 'below' else '>'} {claim.threshold:g}"


def _number(value: float) -> str:
    if 1000 <= abs(value) < math.inf:
        return f"{value:,.0f}"
    return f"{value:.4g}" if abs(value) >= 1 else f"{value:.3g}"
