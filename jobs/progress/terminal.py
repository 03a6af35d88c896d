"""What the terminal shows: progress while it runs, then the table."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pyarrow as pa
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from cluster.events import ShardEvent, ShardReplayed, ShardRestarted, ShardWaiting
from cluster.shard import Shard
from jobs.analysis.pages.escaping import printable
from jobs.analysis.pages.fitting_table import FittingTable
from jobs.analysis.pages.results_table import results_table
from jobs.progress.live_table import LiveTable, short_return, totals_line
from jobs.progress.observers import Ending, Observer
from jobs.progress.pace import Pace
from jobs.progress.progress import ArmProgress, JobProgress
from jobs.results.manifest import arm_timings

_FIRST_LINE_SECONDS, _MOST_LINE_SECONDS = 5.0, 60.0


class NoteObserver(Observer):
    """Says nothing but what was not as it should be."""

    def __init__(self, console: Console) -> None:
        self._console = console

    def noted(self, message: str) -> None:
        """Say what was found."""
        self._console.print(f"note: {message}", highlight=False, markup=False)

    def progressed(self, shard: Shard, event: ShardEvent, progress: JobProgress) -> None:
        """Say where a shard does not go on from what is stored of it."""
        if isinstance(event, ShardReplayed):
            self.noted(f"{shard.label}: {event.reason}: it is played from its beginning")


class TerminalObserver(Observer):
    """A progress bar per arm; in a log, where bars would be rubbish, a line now and then."""

    def __init__(self, console: Console) -> None:
        self._console = console
        self._view = LiveTable(console) if console.is_terminal else _Lines(console)
        self._has_begun = False

    def waiting(self, message: str) -> None:
        """Say why nothing moves."""
        self._console.print(message, highlight=False)

    def compiling(self) -> None:
        """Say why nothing moves."""
        self._console.print("compiling: once per installation, up to a minute", highlight=False)

    def joined(self, dashboard_url: str, num_cpus: int, log_folder: Path) -> None:
        """Say where the dashboard is."""
        self._console.print(f"Ray with {num_cpus} CPUs", highlight=False)
        if dashboard_url:
            self._console.print(
                f"dashboard: http://{dashboard_url} (log in with the token that `ray get-auth-token` prints)",
                highlight=False,
            )

    def planned(self, progress: JobProgress) -> None:
        """Begin to show how far it has come, or go on with more to do."""
        before = sum(arm.runs_done for arm in progress.arms().values())
        if before and not self._has_begun:
            self._console.print(f"{before} run{' is' if before == 1 else 's are'} already finished", highlight=False)
        self._view.begin(progress.arms())
        self._has_begun = True

    def progressed(self, shard: Shard, event: ShardEvent, progress: JobProgress) -> None:
        """Show what has changed."""
        if isinstance(event, ShardRestarted):
            what = f"{shard.label}: its processes died; restarting from its checkpoint in {event.delay_seconds:.1f} s"
            self._console.print(what, highlight=False)
        if isinstance(event, ShardWaiting):
            self._console.print("the cluster has no CPU at the moment: waiting for a worker to join", highlight=False)
        self._view.show(progress.arms)

    def ended(self, ending: Ending) -> None:
        """Leave what is shown as it is."""
        self._view.end()


class _Lines:
    """One line for all arms every few seconds, later every minute, for a file or the log of a job."""

    def __init__(self, console: Console) -> None:
        self._console = console
        self._began = self._last = time.monotonic()
        self._has_begun = False
        self._arms: Callable[[], Mapping[str, ArmProgress]] = dict
        self._shown = ""
        self._pace = Pace()

    def begin(self, arms: Mapping[str, ArmProgress]) -> None:
        if not self._has_begun:
            self._began = self._last = time.monotonic()
        self._has_begun = True

    def show(self, arms: Callable[[], Mapping[str, ArmProgress]]) -> None:
        self._arms = arms
        now = time.monotonic()
        pause = min(max(_FIRST_LINE_SECONDS, 0.2 * (now - self._began)), _MOST_LINE_SECONDS)
        if now - self._last >= pause:
            self._last = now
            self._print(now)

    def end(self) -> None:
        self._print(time.monotonic())

    def _print(self, now: float) -> None:
        arms = self._arms()
        line = f"{progress_line(arms)} · {totals_line(arms, now - self._began, self._pace)}"
        if line != self._shown and arms:
            self._console.print(line, highlight=False)
        self._shown = line


def progress_line(arms: Mapping[str, ArmProgress]) -> str:
    """All arms in one line.

    >>> progress_line({"APEL": ArmProgress(runs_planned=4, runs_done=1, episodes_planned=10, episodes=5)})
    'APEL 1/4 (50 %)'
    """
    parts = []
    for name, arm in arms.items():
        share = f" ({arm.episodes / arm.episodes_planned:.0%})".replace("%", " %") if arm.episodes_planned else ""
        failed = f", {arm.runs_failed} failed" if arm.runs_failed else ""
        returned = "" if arm.mean_return is None else f", return {short_return(arm.mean_return)}"
        parts.append(f"{name} {arm.runs_done}/{arm.runs_planned}{share}{failed}{returned}")
    return " · ".join(parts)


@contextmanager
def episode_bar(console: Console, what: str, num_episodes: int) -> Iterator[Callable[[int], None]]:
    """A progress bar for one run, by episodes, to be told how many there are so far; nothing in a log."""
    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        TextColumn("{task.completed:,.0f}/{task.total:,.0f} episodes"),
    )
    with Progress(*columns, TimeElapsedColumn(), console=console, disable=not console.is_terminal) as progress:
        task = progress.add_task(printable(what), total=num_episodes)
        yield lambda completed: progress.update(task, completed=completed)


def summary_table(summary: pa.Table, manifest: dict[str, Any]) -> FittingTable:
    """The table of results."""
    shown = results_table(summary, arm_timings(manifest))
    return FittingTable(
        shown.headings,
        shown.rows,
        names=shown.headings[: shown.num_names],
        first_to_go=("steps/s", "wall time", "IQM", "median", "SD", "steps", "censored", "runs"),
        title=manifest.get("experiment"),
    )
