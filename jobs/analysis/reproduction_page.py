"""All experiments on one page, with the ledger of claims, from the files alone."""

from __future__ import annotations

import html
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from cluster.storage import Folder
from jobs.analysis import page
from jobs.spec import Gallery
from jobs.store import ResultStore

_CLAIM_HEADS = ("figure", "claim", "value", "95 % interval", "claimed", "verdict")


def reproduction_page(
    folder: Folder, galleries: Iterable[Gallery], stores: Sequence[ResultStore], claims: Sequence[Mapping[str, Any]]
) -> bytes:
    """The page: what was done, the claims (rows of ``claims.parquet``), then figures and tables of each experiment."""
    runs = sum(len(store.runs()) for store in stores)
    seconds = sum(session["seconds"] for store in stores for session in store.manifest().get("sessions", []))
    counts = ", ".join(f"{count} {verdict}" for verdict, count in Counter(row["verdict"] for row in claims).items())
    played = f"{len(stores)} experiments, {runs:,} runs, {seconds / 60:,.1f} minutes of playing"
    body = [
        f"<p>{played}. Of {len(claims)} claims: {counts}.</p>",
        "<h2>Ledger of claims</h2>",
        _ledger(claims),
    ]
    for gallery in galleries:
        body += [_heading(gallery.title or gallery.name, gallery.figures)]
        names = [f"figures/{gallery.name}/{picture.name}.svg" for picture in gallery.pictures]
        body += [page.inline_svg(folder.read(name).decode(), name) for name in names]
    for store in stores:
        experiment = store.experiment()
        body += [_heading(experiment.title or experiment.name, experiment.figures)]
        body += [page.results(store, experiment), *page.pictures(store), page.spec(experiment)]
        body += [f"<details><summary>what it rests on</summary>{page.sessions(store.manifest())}</details>"]
    return page.page("The experiments, reproduced", body)


def _heading(title: str, figures: Sequence[str]) -> str:
    numbers = f" (figure{'s' if len(figures) > 1 else ''} {', '.join(figures)})" if figures else ""
    return f"<h2>{html.escape(title + numbers)}</h2>"


def _ledger(claims: Sequence[Mapping[str, Any]]) -> str:
    head = "".join(f"<th class='name'>{heading}</th>" for heading in _CLAIM_HEADS)
    rows = []
    for claim in claims:
        cells = [_number(claim["value"]), f"{_number(claim['low'])} to {_number(claim['high'])}", claim["claimed"]]
        numbers = "".join(f"<td>{html.escape(cell)}</td>" for cell in cells)
        text = f"<td class='name'>{html.escape(claim['source'])}</td><td class='text'>{html.escape(claim['text'])}</td>"
        rows.append(f"<tr>{text}{numbers}<td class='{claim['verdict']}'>{claim['verdict']}</td></tr>")
    return f"<div class='wide'><table><tr>{head}</tr>{''.join(rows)}</table></div>"


def _number(value: float | None) -> str:
    return "-" if value is None or value != value else f"{value:,.4g}" if abs(value) < 1000 else f"{value:,.0f}"
