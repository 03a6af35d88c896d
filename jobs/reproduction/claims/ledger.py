"""The ledger of claims as a table, as a page, on the terminal, and in files."""

from __future__ import annotations

import math
from collections.abc import Sequence

import pyarrow as pa
import pyarrow.parquet as pq
from rich.text import Text

from jobs.analysis.pages.escaping import markdown_cell
from jobs.analysis.pages.fitting_table import FittingTable
from jobs.reproduction.claims.claim import Claim
from jobs.reproduction.claims.judging import MIN_RUNS, RULINGS, Ruling, Verdict
from jobs.results.storage import Folder

DOUBTFUL = "*"
"""Marks verdicts that are undecided after Holm's correction."""
_COLOURS: dict[Ruling, str] = {"holds": "green", "fails": "red", "undecided": "yellow", "missing": "dim"}


def verdict_table(verdicts: Sequence[Verdict]) -> FittingTable:
    """The ledger of claims, short: its page has the words. ``before`` is what was expected.

    A verdict with a star is undecided after Holm's correction.
    """
    rows: list[list[str | Text]] = []
    for verdict in verdicts:
        name, _, _, _, value, interval, claimed, _, corrected, _, expected, runs, censored, *_ = cells(verdict)
        starred = verdict.ruling if verdict.corrected_ruling == verdict.ruling else f"{verdict.ruling}{DOUBTFUL}"
        coloured = Text(starred, style=_COLOURS[verdict.ruling])
        rows.append([name, value, interval, claimed, coloured, corrected, expected, runs, censored])
    return FittingTable(
        ("claim", "value", "95 % interval", "claimed", "verdict", "p, Holm", "before", "runs", "at cap"),
        rows,
        names=("claim", "claimed", "verdict", "before"),
        first_to_go=("before", "at cap", "runs", "p, Holm", "claimed", "95 % interval"),
        padding=1,
    )


def source_lines(verdicts: Sequence[Verdict]) -> list[str]:
    """Of each experiment the folder whose results were judged, or that all there are were left aside."""
    lines = [
        f"{verdict.claim.experiment}: {verdict.folder}" if verdict.folder else verdict.note
        for verdict in verdicts
        if verdict.folder or verdict.others
    ]
    return list(dict.fromkeys(lines))


def write_ledger(folder: Folder, verdicts: Sequence[Verdict]) -> list[str]:
    """Write ``claims.parquet`` and ``claims.md``; returns where they are."""
    table = claims_table(verdicts)
    folder.write_with("claims.parquet", lambda path: pq.write_table(table, path, filesystem=folder.filesystem))
    folder.write("claims.md", claims_markdown(verdicts).encode())
    return [folder.location(name) for name in ("claims.parquet", "claims.md")]


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
        "folder": verdict.folder or None,
        "statistic": str(claim.statistic),
        "value": estimate.value if estimate else None,
        "interval_low": estimate.low if estimate else None,
        "interval_high": estimate.high if estimate else None,
        "direction": claim.direction,
        "threshold_low": low,
        "threshold_high": high,
        "verdict": verdict.ruling,
        "p_value": verdict.p_value,
        "corrected_p_value": verdict.corrected_p_value,
        "corrected_verdict": verdict.corrected_ruling,
        "expected": claim.expected,
        "runs": verdict.num_runs,
        "censored": verdict.num_censored,
        "note": verdict.note,
    }


_TEXTS = ("id", "source", "claim", "experiment", "identity", "folder", "statistic")
_NUMBERS = ("value", "interval_low", "interval_high")
_SCHEMA = pa.schema(
    [(name, pa.string()) for name in _TEXTS]
    + [(name, pa.float64()) for name in _NUMBERS]
    + [("direction", pa.string()), ("threshold_low", pa.float64()), ("threshold_high", pa.float64())]
    + [("verdict", pa.string()), ("p_value", pa.float64()), ("corrected_p_value", pa.float64())]
    + [("corrected_verdict", pa.string()), ("expected", pa.string())]
    + [("runs", pa.int64()), ("censored", pa.int64()), ("note", pa.string())]
)
HEADINGS = (
    "claim", "figure", "what is claimed", "statistic", "value", "95 % interval", "claimed", "verdict", "p, Holm",
    "after Holm", "expected", "runs", "censored", "note", "results",
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
        "-" if verdict.corrected_p_value is None else _level(verdict.corrected_p_value),
        verdict.corrected_ruling,
        claim.expected,
        str(verdict.num_runs) if has_runs else "-",
        str(verdict.num_censored) if has_runs else "-",
        verdict.note,
        verdict.folder or "-",
    ]


def count_line(verdicts: Sequence[Verdict]) -> str:
    """How many claims hold, fail, and so on."""
    return f"{len(verdicts)} claims: {_counts([verdict.ruling for verdict in verdicts])}"


def corrected_count_line(verdicts: Sequence[Verdict]) -> str:
    """The same after Holm's correction, with how many claims that is of."""
    num_tested = sum(verdict.p_value is not None for verdict in verdicts)
    counts = _counts([verdict.corrected_ruling for verdict in verdicts])
    return f"After Holm's correction over the {num_tested} that an interval decides: {counts}"


def _counts(rulings: Sequence[Ruling]) -> str:
    return ", ".join(f"{rulings.count(ruling)} {ruling}" for ruling in RULINGS)


def claims_markdown(verdicts: Sequence[Verdict]) -> str:
    """The ledger as a page."""
    rows = [list(HEADINGS), ["---"] * len(HEADINGS), *(cells(verdict) for verdict in verdicts)]
    lines = ["| " + " | ".join(map(markdown_cell, row)) + " |" for row in rows]
    legend = (
        "A claim holds where the whole 95 % interval lies on the claimed side, fails where the whole lies on the "
        "other, and is undecided otherwise. A claim on every run, or on none, fails with the first run that is "
        f"otherwise. Fewer than {MIN_RUNS} runs decide only that. Arms of one experiment share their runs, and are "
        "compared in pairs. Censored runs count with their cap, which is a lower bound. A verdict by itself is wrong "
        "in some 5 % of cases; after Holm's correction over all claims of this page that an interval decides, those "
        "that are left are all right in 95 % of such ledgers. *p, Holm* is the corrected level at which the interval "
        "would still lie on one side."
    )
    counts = f"{count_line(verdicts)}. {corrected_count_line(verdicts)}."
    return "\n".join(["# Claims", "", counts, "", legend, "", *lines, ""])


def _claimed(claim: Claim) -> str:
    if isinstance(claim.threshold, tuple):
        return f"{claim.threshold[0]:g} to {claim.threshold[1]:g}"
    if claim.threshold is None:
        return {"every": "every run", "none": "no run"}[claim.direction]
    return f"{'<' if claim.direction == 'below' else '>'} {claim.threshold:g}"


def _level(value: float) -> str:
    return "< 0.0001" if value < 1e-4 else f"{value:.2g}"


def _number(value: float) -> str:
    if 1000 <= abs(value) < math.inf:
        return f"{value:,.0f}"
    return f"{value:.4g}" if abs(value) >= 1 else f"{value:.3g}"
