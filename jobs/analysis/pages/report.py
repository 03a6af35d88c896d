"""One self-contained page of an experiment's results, from the files alone."""

from __future__ import annotations

import html
from collections.abc import Sequence

from jobs.analysis.answer import DEFAULT_ERROR
from jobs.analysis.pages import parts as page
from jobs.analysis.pages.escaping import printable
from jobs.analysis.stored_summary import stored_summary
from jobs.results.store import ResultStore, StoreError


def write_report(store: ResultStore, answer: Sequence[str] | None = None) -> str:
    """Write ``report.html``, with the answer in words; returns where it is.

    Without an ``answer`` (lines, see `jobs.analysis.answer.words`) it is found here.
    """
    experiment, manifest = store.experiment(), store.manifest()
    figures = f", figures {', '.join(experiment.figures)} of the dissertation" if experiment.figures else ""
    runs = max((row["runs"] for row in stored_summary(store).to_pylist()), default=0)
    about = f"Experiment <code>{experiment.name}</code>, identity <code>{experiment.identity}</code>"
    body = [
        f"<p>{about}{html.escape(figures)}. {runs} runs per arm, seed {experiment.seed}.</p>",
        "<h2>Answer</h2>",
        _answer(_lines(store) if answer is None else answer),
        "<h2>Results</h2>",
        page.results(store, experiment),
        *page.pictures(store, experiment),
        "<h2>What it rests on</h2>",
        page.spec(experiment),
        page.sessions(manifest),
    ]
    store.folder.write("report.html", page.page(experiment.title or experiment.name, body))
    return store.folder.location("report.html")


def _answer(lines: Sequence[str]) -> str:
    return f"<pre>{html.escape(printable(chr(10).join(lines)))}</pre>"


def _lines(store: ResultStore) -> list[str]:
    """The answer; where rows or episodes are not those of this program, why there is none."""
    # With scipy's statistics, which take half a second to import.
    from jobs.analysis.answer.comparison import compare
    from jobs.analysis.answer.words import answer_lines

    try:
        return answer_lines(compare(store, DEFAULT_ERROR))
    except StoreError as error:
        return [f"No answer: {error}"]
