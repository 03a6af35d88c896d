"""What the terminal shows: progress while it runs, then the table."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import pyarrow as pa
from rich import box
from rich.console import Console
from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeElapsedColumn
from rich.table import Table

from cluster.coordinator import ShardDone, ShardProgress
from cluster.shard import Shard
from jobs.analysis.claims import Ruling, Verdict, cells
from jobs.analysis.results_table import results_table
from jobs.design import SELECTION_AWARE, Prediction
from jobs.manifest import arm_timings
from jobs.runner import Observer


class TerminalObserver(Observer):
    """A progress bar per arm; plain lines where the output is no terminal."""

    def __init__(self, console: Console) -> None:
        self._console = console
        self._progress = Progress(
            TextColumn("{task.description:>12}"),
            BarColumn(),
            TextColumn("{task.percentage:3.0f} %  {task.fields[note]}"),
            TimeElapsedColumn(),
            console=console,
            disable=not console.is_terminal,
        )
        self._tasks: dict[str, TaskID] = {}
        self._shards: dict[tuple[str, str, int], tuple[int, int, int]] = {}
        self._num_runs: dict[str, int] = {}

    def compiling(self) -> None:
        """Say why nothing moves."""
        self._console.print("compiling, this once: about half a minute", highlight=False)

    def joined(self, dashboard_url: str, num_cpus: int) -> None:
        """Say where the dashboard is."""
        self._console.print(f"Ray with {num_cpus} CPUs", highlight=False)
        if dashboard_url:
            self._console.print(
                f"dashboard: http://{dashboard_url} (asks for a token once: `ray get-auth-token` prints it)",
                highlight=False,
            )

    def planned(self, shards: Sequence[Shard], num_finished: int) -> None:
        """Start the bars."""
        if num_finished:
            self._console.print(f"{num_finished} runs were finished before", highlight=False)
        episodes: dict[str, int] = {}
        for shard in shards:
            self._num_runs[shard.arm.arm] = self._num_runs.get(shard.arm.arm, 0) + len(shard.runs)
            episodes[shard.arm.arm] = episodes.get(shard.arm.arm, 0) + len(shard.runs) * shard.arm.num_episodes
        for arm, total in episodes.items():
            self._tasks[arm] = self._progress.add_task(arm, total=total, note="waiting")
        self._progress.start()

    def progressed(self, shard: Shard, event: ShardProgress | ShardDone) -> None:
        """Move the bar of the shard's arm."""
        if isinstance(event, ShardDone):
            self._shards[shard.key] = (len(shard.runs), len(shard.runs) * shard.arm.num_episodes, event.steps)
        else:
            self._shards[shard.key] = (event.num_finished, event.episodes, event.steps)
        arm = shard.arm.arm
        mine = [values for (name, _, _), values in self._shards.items() if name == arm]
        runs, episodes, steps = (sum(column) for column in zip(*mine, strict=True))
        note = f"{runs}/{self._num_runs[arm]} runs, {steps / 1e6:,.1f} M steps"
        self._progress.update(self._tasks[arm], completed=episodes, note=note)
        if isinstance(event, ShardDone) and not self._console.is_terminal and runs == self._num_runs[arm]:
            self._console.print(f"{arm}: {note}", highlight=False)

    def stop(self) -> None:
        """Leave the bars as they are."""
        self._progress.stop()


def summary_table(summary: pa.Table, manifest: dict[str, Any]) -> Table:
    """The table of results."""
    shown = results_table(summary, arm_timings(manifest))
    table = Table(title=manifest.get("experiment"), title_justify="left", box=box.SIMPLE_HEAD, padding=(0, 2, 0, 0))
    for column, heading in enumerate(shown.headings):
        table.add_column(heading, justify="left" if column < shown.num_names else "right", no_wrap=True)
    for row in shown.rows:
        table.add_row(*row)
    return table


def design_table(predictions: Sequence[Prediction]) -> Table:
    """The table of `apel design`: the rows to trust are bold where the terminal can."""
    has_performance = any(row.performance is not None for row in predictions)
    table = Table(box=box.SIMPLE_HEAD, padding=(0, 2, 0, 0))
    for heading in ("ν", "ν by", "predicted by"):
        table.add_column(heading, no_wrap=True)
    for heading in ("adaptation", "rise", "exploration", *(["performance"] if has_performance else [])):
        table.add_column(heading, justify="right", no_wrap=True)
    for row in predictions:
        cells = [f"{row.decay:.4g}", row.decay_by, row.predicted_by, f"{row.adaptation_time:,.1f}"]
        cells += [f"{row.rise_time:,.1f}", f"{row.exploration:.4g}"]
        cells += [f"{row.performance:.4g}"] if row.performance is not None else []
        table.add_row(*cells, style="bold" if row.predicted_by == SELECTION_AWARE else None)
    return table


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


_COLOURS: dict[Ruling, str] = {"holds": "green", "fails": "red", "undecided": "yellow", "missing": "dim"}
