"""The ledger of claims on the terminal and in files. Imported where it is needed: it takes pandas to read results."""

from __future__ import annotations

from collections.abc import Sequence

import pyarrow.parquet as pq
from rich import box
from rich.table import Table

from cluster.storage import Folder
from jobs.analysis.claims import Ruling, Verdict, cells, claims_markdown, claims_table

_COLOURS: dict[Ruling, str] = {"holds": "green", "fails": "red", "undecided": "yellow", "missing": "dim"}


def verdict_table(verdicts: Sequence[Verdict]) -> Table:
    """The ledger of claims, short: its page has the words. ``before`` is what was expected."""
    table = Table(box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0))
    for heading in ("claim", "value", "95 % interval", "claimed", "verdict", "before", "runs", "at cap"):
        is_text = heading in {"claim", "claimed", "verdict", "before"}
        table.add_column(heading, justify="left" if is_text else "right", no_wrap=True)
    for verdict in verdicts:
        name, _, _, _, value, interval, claimed, ruling, expected, runs, censored, _ = cells(verdict)
        colour = _COLOURS[verdict.ruling]
        table.add_row(name, value, interval, claimed, f"[{colour}]{ruling}[/]", expected, runs, censored)
    return table


def write_ledger(folder: Folder, verdicts: Sequence[Verdict]) -> list[str]:
    """Write ``claims.parquet`` and ``claims.md``; returns where they are."""
    table = claims_table(verdicts)
    folder.write_with("claims.parquet", lambda path: pq.write_table(table, path, filesystem=folder.filesystem))
    folder.write("claims.md", claims_markdown(verdicts).encode())
    return [folder.location(name) for name in ("claims.parquet", "claims.md")]
