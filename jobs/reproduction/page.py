"""All experiments on one page, with the ledger of claims, from the files alone."""

from __future__ import annotations

import html
from collections.abc import Iterable, Sequence

from jobs.analysis.pages import parts as page
from jobs.experiment.spec import Gallery
from jobs.reproduction.claims.judging import Verdict
from jobs.reproduction.claims.ledger import cells, corrected_count_line, count_line
from jobs.results.storage import Folder
from jobs.results.store import ResultStore

_HEADS = ("figure", "verdict", "after Holm", "what is claimed", "value", "95 % interval", "claimed", "expected")


def reproduction_page(
    folder: Folder, galleries: Iterable[Gallery], stores: Sequence[ResultStore], verdicts: Sequence[Verdict]
) -> bytes:
    """The page: what was done, the claims, then figures and tables of each experiment."""
    runs = sum(len(store.runs()) for store in stores)
    seconds = sum(session["seconds"] for store in stores for session in store.manifest().get("sessions", []))
    played = f"{len(stores)} experiments, {runs:,} runs, {seconds / 60:,.1f} minutes of playing"
    body = [
        f"<p>{played}. {count_line(verdicts)}. {corrected_count_line(verdicts)}.</p>",
        "<h2>Ledger of claims</h2>",
        f"<details><summary>all {len(verdicts)} claims</summary>{_ledger(verdicts)}</details>",
    ]
    for gallery in galleries:
        body += [_heading(gallery.title or gallery.name, gallery.figures)]
        names = [f"figures/{gallery.name}/{picture.name}.svg" for picture in gallery.pictures]
        body += [page.embedded_svg(folder.read(name), name) for name in names]
    for store in stores:
        experiment = store.experiment()
        body += [_heading(experiment.title or experiment.name, experiment.figures)]
        body += [page.results(store, experiment), *page.pictures(store, experiment), page.spec(experiment)]
        body += [f"<details><summary>what it rests on</summary>{page.sessions(store.manifest())}</details>"]
    return page.page("The experiments, reproduced", page.with_contents(body))


def _heading(title: str, figures: Sequence[str]) -> str:
    numbers = f" (figure{'s' if len(figures) > 1 else ''} {', '.join(figures)})" if figures else ""
    return f"<h2>{html.escape(title + numbers)}</h2>"


def _ledger(verdicts: Sequence[Verdict]) -> str:
    head = "".join(f"<th class='name'>{heading}</th>" for heading in _HEADS)
    rows = []
    for verdict in verdicts:
        _, source, text, _, value, interval, claimed, ruling, _, corrected, expected, *_, note, _ = map(
            html.escape, cells(verdict)
        )
        words = f"<td class='text'>{text}{f' ({note})' if note else ''}</td>"
        numbers = "".join(f"<td>{cell}</td>" for cell in (value, interval, claimed, expected))
        rulings = "".join(f"<td class='{one}'>{one}</td>" for one in (ruling, corrected))
        rows.append(f"<tr><td class='source'>{source}</td>{rulings}{words}{numbers}</tr>")
    return f"<div class='wide'><table><tr>{head}</tr>{''.join(rows)}</table></div>"
