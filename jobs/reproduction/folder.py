"""What is made of all experiments together: ledger, tables, figures and one page, in a folder of its own.

``results/reproduction/``

    report.html      everything on one page, which opens offline
    claims.parquet   the ledger, also as claims.md
    tables/          the summary of each experiment as CSV
    figures/         of each experiment, and those that need no runs, PNG and SVG
"""

from __future__ import annotations

import io
from collections.abc import Sequence

import pyarrow as pa
import pyarrow.csv

from jobs.analysis.pages.report import write_report
from jobs.analysis.plotting.figures import draw_figures
from jobs.experiment.spec_files import Group, shipped_experiments, shipped_galleries
from jobs.reproduction.claims.claim_files import judged_experiments, shipped_claims
from jobs.reproduction.claims.judging import Verdict, evaluate
from jobs.reproduction.claims.ledger import write_ledger
from jobs.reproduction.gallery import draw_gallery
from jobs.reproduction.page import reproduction_page
from jobs.results.storage import Folder
from jobs.results.store import ResultStore


def write_reproduction(folder: Folder, stores: Sequence[ResultStore], group: Group) -> list[Verdict]:
    """Draw, evaluate and write everything of a group's finished experiments; returns the verdicts."""
    for store in stores:
        draw_figures(store, store.experiment())
        write_report(store)
        _copy(store, folder)
    galleries = shipped_galleries() if group == "tabular" else {}
    for name, gallery in galleries.items():
        draw_gallery(gallery, folder.sub(f"figures/{name}"))
    concerned = shipped_experiments(group)
    claims = [claim for claim in shipped_claims() if claim.experiment in concerned]
    verdicts = evaluate(claims, stores, judged_experiments(claims))
    write_ledger(folder, verdicts)
    folder.write("report.html", reproduction_page(folder, galleries.values(), stores, verdicts))
    return verdicts


def _copy(store: ResultStore, folder: Folder) -> None:
    """Summary and figures of an experiment, so that the folder stands for itself."""
    name = store.experiment().name
    folder.write(f"tables/{name}.csv", _csv(store.summary()))
    for file in store.folder.names("figures"):
        folder.write(f"figures/{name}/{file}", store.folder.read(f"figures/{file}"))


def _csv(table: pa.Table) -> bytes:
    buffer = io.BytesIO()
    pyarrow.csv.write_csv(table, buffer)
    return buffer.getvalue()
