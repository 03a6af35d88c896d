"""The parts that self-contained pages are made of; they open offline, on a desk or a phone."""

from __future__ import annotations

import base64
import csv
import html
import io
import re
from collections.abc import Iterable, Mapping, Sequence
from string import Template
from typing import Any

from jobs.analysis.pages.results_table import results_table
from jobs.analysis.stored_summary import stored_summary
from jobs.analysis.switching.table import HEADINGS, cells
from jobs.experiment.figures import CurvePlot
from jobs.experiment.spec import Experiment
from jobs.results.manifest import arm_timings
from jobs.results.store import ResultStore

_PAGE = Template("""<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta http-equiv="Content-Security-Policy" content="default-src 'none'; img-src data:; style-src 'unsafe-inline'">
<title>$title</title>
<style>
  :root { color-scheme: light dark; }
  body { font: 16px/1.5 system-ui, sans-serif; color: #222; background: #fff; }
  body { max-width: 64rem; margin: 0 auto; padding: 1rem; }
  h1 { font-size: 1.5rem; } h2 { font-size: 1.2rem; margin-top: 2.5rem; } h3 { font-size: 1rem; }
  .wide { overflow-x: auto; }
  table { border-collapse: collapse; font-size: .9rem; }
  th, td { padding: .25rem .7rem; text-align: right; border-bottom: 1px solid #ddd; white-space: nowrap; }
  th.name, td.name { text-align: left; }
  td.text { text-align: left; white-space: normal; min-width: 16rem; }
  td.source { text-align: left; white-space: normal; max-width: 7rem; }
  .holds { color: #00664b; font-weight: 600; } .fails { color: #b04400; font-weight: 600; }
  .undecided, .missing { color: #666; }
  figure { margin: 1rem 0; }
  img { width: min(100%, 52rem); height: auto; background: #fff; }
  pre { background: #f5f5f5; padding: .8rem; overflow-x: auto; font-size: .85rem; }
  summary, a { cursor: pointer; color: #0059a3; }
  @media (prefers-color-scheme: dark) {
    body { color: #ddd; background: #181a1b; } th, td { border-bottom-color: #3a3d3f; } pre { background: #242729; }
    .holds { color: #4cc38a; } .fails { color: #f0883e; } .undecided, .missing { color: #999; }
    summary, a { color: #6cb6ff; }
  }
</style>
</head>
<body>
<h1>$title</h1>
$body
</body>
</html>
""")


def page(title: str, body: Iterable[str]) -> bytes:
    """A whole page; ``body`` is HTML."""
    return _PAGE.substitute(title=html.escape(title), body="\n".join(body)).encode()


def with_contents(body: Sequence[str]) -> list[str]:
    """The parts of a page with a list of its chapters (``<h2>``) before the first of them, and a place to jump to each.

    >>> with_contents(["<p>What it is.</p>", "<h2>Claims</h2>", "<h2>Maze &amp; switch</h2>"])[1]
    "<nav><ul><li><a href='#claims'>Claims</a></li><li><a href='#maze-switch'>Maze &amp; switch</a></li></ul></nav>"
    """
    titles = [part[4:-5] for part in body if part.startswith("<h2>")]
    anchors = dict(zip(titles, map(_anchor, titles), strict=True))
    links = "".join(f"<li><a href='#{anchors[title]}'>{title}</a></li>" for title in titles)
    parts = [f"<h2 id='{anchors[part[4:-5]]}'>{part[4:]}" if part.startswith("<h2>") else part for part in body]
    first = next((place for place, part in enumerate(body) if part.startswith("<h2>")), len(body))
    return [*parts[:first], f"<nav><ul>{links}</ul></nav>", *parts[first:]]


def _anchor(title: str) -> str:
    return "-".join(re.findall(r"[a-z0-9]+", html.unescape(title).lower()))


def table(heads: list[str], rows: list[list[str]], caption: str = "", *, num_names: int = 1) -> str:
    """A table of text whose first ``num_names`` columns are names."""

    def line(tag: str, cells: list[str]) -> str:
        marks = [" class='name'" if i < num_names else "" for i in range(len(cells))]
        return "".join(f"<{tag}{mark}>{html.escape(cell)}</{tag}>" for mark, cell in zip(marks, cells, strict=True))

    body = "".join(f"<tr>{line('td', row)}</tr>" for row in rows)
    text = f"<p>{html.escape(caption)}</p>" if caption else ""
    return f"{text}<div class='wide'><table><tr>{line('th', heads)}</tr>{body}</table></div>"


def results(store: ResultStore, experiment: Experiment) -> str:
    """The table of an experiment's results."""
    shown = results_table(stored_summary(store), arm_timings(store.manifest()))
    caption = (
        "Times in episodes; means with bootstrap intervals, SD over runs. A run that did not meet its criterion within "
        "its cap is censored, and counts with the cap."
        if experiment.criterion
        else "Means with bootstrap intervals, SD over runs. The return is that of the last tenth of each run: of its "
        "episodes, or of its environment steps where they end it."
    )
    return table(shown.headings, shown.rows, caption, num_names=shown.num_names)


def sessions(manifest: Mapping[str, Any]) -> str:
    """What was worked on the results, when, and with what."""
    rows = [
        [
            session["began"],
            f"{session['seconds']:,.1f} s",
            session["placement"],
            str(session["num_cpus"]),
            session["machine"],
            ", ".join(f"{name} {number}" for name, number in session["versions"].items()),
            (session["revision"] or "-")[:12],
        ]
        for session in manifest.get("sessions", [])
    ]
    heads = ["began", "took", "placement", "CPUs", "machine", "versions", "revision"]
    return table(heads, rows, "Sessions of work; Ray's start is not counted.")


def pictures(store: ResultStore, experiment: Experiment) -> list[str]:
    """The figures of an experiment, inline, each with the switch delays that belong to it.

    Others lie there, too, where an earlier session drew other plots, perhaps of fewer runs.
    """
    files = store.folder.names("figures")
    shown = []
    for plot in experiment.drawn_plots:
        name, delays = f"{plot.name}.svg", f"{plot.name}_switch.csv"
        if name in files:
            shown.append(embedded_svg(store.folder.read(f"figures/{name}"), f"{experiment.name}/{name}"))
        if delays in files and isinstance(plot, CurvePlot) and plot.switch:
            shown.append(_switches(store.folder.read(f"figures/{delays}"), delays))
    return shown


def _switches(content: bytes, name: str) -> str:
    """The table of switch delays, from its CSV file."""
    try:
        rows = cells(list(csv.DictReader(io.StringIO(content.decode()))))
    except (ValueError, KeyError, TypeError, csv.Error) as error:
        return f"<p>{html.escape(f'{name}: found no table of switch delays: {error!r}')}</p>"
    caption = (
        "Switch delays: from where the late learner alone overtakes the early one for good to where the ensemble comes "
        "to select it most of the time; medians and means with bootstrap intervals, pairs run by run. A run that never "
        "switches is censored, and counts with what was left of it: a lower bound."
    )
    return table(HEADINGS, rows, caption)


def embedded_svg(svg: bytes, name: str) -> str:
    """An SVG file as a picture on a page. As a picture it cannot run scripts, load anything, or touch the page: whoever
    can write to results may have written it.
    """
    content = base64.b64encode(svg).decode()
    return f'<figure><img src="data:image/svg+xml;base64,{content}" alt="{html.escape(name)}"></figure>'


def spec(experiment: Experiment) -> str:
    """The experiment file, folded away."""
    return f"<details><summary>experiment file</summary><pre>{html.escape(experiment.to_yaml())}</pre></details>"
