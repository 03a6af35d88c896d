"""One self-contained page of an experiment's results, from the files alone: it opens offline, on a desk or a phone."""

from __future__ import annotations

import html
from string import Template
from typing import Any

from jobs.manifest import arm_timings
from jobs.spec import Experiment
from jobs.store import ResultStore

_PAGE = Template("""<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>$title</title>
<style>
  body { font: 16px/1.5 system-ui, sans-serif; color: #222; max-width: 60rem; margin: 0 auto; padding: 1rem; }
  h1 { font-size: 1.5rem; } h2 { font-size: 1.15rem; margin-top: 2rem; }
  .wide { overflow-x: auto; }
  table { border-collapse: collapse; }
  th, td { padding: .3rem .8rem; text-align: right; border-bottom: 1px solid #ddd; white-space: nowrap; }
  th:first-child, td:first-child { text-align: left; }
  svg { max-width: 100%; height: auto; }
  pre { background: #f5f5f5; padding: .8rem; overflow-x: auto; font-size: .85rem; }
</style>
</head>
<body>
<h1>$title</h1>
<p>Experiment <code>$name</code>, identity <code>$identity</code>$figures. $runs runs per arm, seed $seed.</p>
<h2>Results</h2>
$table
$pictures
<h2>Experiment file</h2>
<pre>$spec</pre>
<h2>What it rests on</h2>
$sessions
</body>
</html>
""")


def write_report(store: ResultStore) -> str:
    """Write ``report.html``; returns where it is."""
    experiment, manifest = store.experiment(), store.manifest()
    pictures = [store.folder.read(f"figures/{name}") for name in store.folder.names("figures") if name.endswith(".svg")]
    figures = f", figures {', '.join(experiment.figures)} of the dissertation" if experiment.figures else ""
    page = _PAGE.substitute(
        title=html.escape(experiment.title or experiment.name),
        name=experiment.name,
        identity=experiment.identity,
        figures=html.escape(figures),
        runs=max((row["runs"] for row in store.summary().to_pylist()), default=0),
        seed=experiment.seed,
        table=_results(store, experiment, manifest),
        pictures="\n".join(f"<figure>{_inline(picture.decode())}</figure>" for picture in pictures),
        spec=html.escape(experiment.to_yaml()),
        sessions=_sessions(manifest),
    )
    store.folder.write("report.html", page.encode())
    return store.folder.location("report.html")


def _results(store: ResultStore, experiment: Experiment, manifest: dict[str, Any]) -> str:
    timings = arm_timings(manifest)
    rows = []
    summary = store.summary().to_pylist()
    has_sweep = any(row["sweep"] for row in summary)
    for row in summary:
        seconds, steps = timings.get(row["arm"], (0.0, 0.0))
        cells = [row["arm"], *([row["sweep"]] if has_sweep else []), f"{row['runs']}"]
        if row.get("mean_train_time") is not None:
            cells += [
                f"{row['mean_train_time']:,.0f}",
                f"{row['interval_low']:,.0f} to {row['interval_high']:,.0f}",
                f"{row['standard_deviation']:,.0f}",
                f"{row['interquartile_mean']:,.0f}",
                f"{row['median']:,.0f}",
                f"{row['num_censored']} of {row['runs']}",
            ]
        else:
            cells += ["-"] * 6
        rows.append([*cells, f"{seconds:,.1f} s", f"{steps / seconds / 1e6:,.1f} M" if seconds else "-"])
    heads = ["arm", *(["sweep"] if has_sweep else []), "runs", "mean", "95 % interval", "SD", "IQM", "median"]
    caption = (
        "Train time in episodes: mean with its bootstrap interval, standard deviation, interquartile mean, median. "
        f"A run that did not meet the criterion within {experiment.episodes:,} episodes is censored, "
        "and counts as that many."
    )
    return _table([*heads, "censored", "wall time", "steps/s"], rows, caption)


def _sessions(manifest: dict[str, Any]) -> str:
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
    return _table(heads, rows, "Sessions of work; Ray's start is not counted.")


def _table(heads: list[str], rows: list[list[str]], caption: str) -> str:
    head = "".join(f"<th>{html.escape(cell)}</th>" for cell in heads)
    body = "".join("<tr>" + "".join(f"<td>{html.escape(cell)}</td>" for cell in row) + "</tr>" for row in rows)
    return f"<p>{html.escape(caption)}</p><div class='wide'><table><tr>{head}</tr>{body}</table></div>"


def _inline(svg: str) -> str:
    """An SVG file without what only a file of its own may have."""
    return svg[svg.index("<svg") :]
