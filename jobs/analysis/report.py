"""One self-contained page of an experiment's results, from the files alone."""

from __future__ import annotations

import html

from jobs.analysis import page
from jobs.store import ResultStore


def write_report(store: ResultStore) -> str:
    """Write ``report.html``; returns where it is."""
    experiment, manifest = store.experiment(), store.manifest()
    figures = f", figures {', '.join(experiment.figures)} of the dissertation" if experiment.figures else ""
    runs = max((row["runs"] for row in store.summary().to_pylist()), default=0)
    about = f"Experiment <code>{experiment.name}</code>, identity <code>{experiment.identity}</code>"
    body = [
        f"<p>{about}{html.escape(figures)}. {runs} runs per arm, seed {experiment.seed}.</p>",
        "<h2>Results</h2>",
        page.results(store, experiment),
        *page.pictures(store, experiment),
        "<h2>What it rests on</h2>",
        page.spec(experiment),
        page.sessions(manifest),
    ]
    store.folder.write("report.html", page.page(experiment.title or experiment.name, body))
    return store.folder.location("report.html")
