"""What a terminal shows while a job runs: one row per arm, in 80 columns."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping

from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from jobs.analysis.pages.escaping import printable
from jobs.analysis.pages.results_table import short_count
from jobs.progress.pace import Pace, clock
from jobs.progress.progress import ArmProgress

_PAUSE_SECONDS = 0.25
_BAR_WIDTH, _NAME_WIDTH = 10, 14
_MOST_SHARES = 3
_HEADINGS = ("arm", "", "", "runs", "return", "left", "selected, %")
_LEFT = ("arm", "selected, %")


class LiveTable:
    """How far each arm has come, its returns, which learners it selects, and how long it may still take."""

    def __init__(self, console: Console) -> None:
        self._shown: RenderableType = ""
        self._live = Live(console=console, get_renderable=lambda: self._shown, refresh_per_second=4)
        self._arms: Callable[[], Mapping[str, ArmProgress]] = dict
        self._paces: dict[str, Pace] = {}
        self._pace = Pace()
        self._began: float | None = None
        self._last = 0.0

    def begin(self, arms: Mapping[str, ArmProgress]) -> None:
        """Show the arms, or go on with more to do."""
        self._began = time.monotonic() if self._began is None else self._began
        self._arms = lambda: arms
        self._draw()
        self._live.start()

    def show(self, arms: Callable[[], Mapping[str, ArmProgress]]) -> None:
        """Show how far they have come, now and then."""
        self._arms = arms
        if time.monotonic() - self._last >= _PAUSE_SECONDS:
            self._draw()

    def end(self) -> None:
        """Leave the last of it as it is."""
        if self._began is not None:
            self._draw()
            self._live.stop()

    def _draw(self) -> None:
        self._last = now = time.monotonic()
        arms = {name: arm for name, arm in self._arms().items() if arm.episodes_planned}
        table = Table(box=None, padding=(0, 1, 0, 0), pad_edge=False, header_style="dim", expand=True)
        for heading in _HEADINGS:
            table.add_column(
                heading,
                justify="left" if heading in _LEFT else "right",
                no_wrap=True,
                overflow="ellipsis",
                ratio=1 if heading == "selected, %" else None,
                max_width=_NAME_WIDTH if heading == "arm" else None,
            )
        for name, arm in arms.items():
            table.add_row(*self._row(name, arm, now))
        elapsed = now - (now if self._began is None else self._began)
        failed = sum(arm.runs_failed for arm in arms.values())
        below = totals_line(arms, elapsed, self._pace) + (f" · {failed} failed" if failed else "")
        self._shown = Group(table, Text(below)) if arms else ""

    def _row(self, name: str, arm: ArmProgress, now: float) -> tuple[RenderableType, ...]:
        is_under_way = bool(arm.steps or arm.episodes)
        left = (
            self._paces.setdefault(name, Pace()).left(now, arm.episodes, arm.episodes_planned) if is_under_way else None
        )
        share = f"{arm.episodes / arm.episodes_planned:.0%}".replace("%", " %")
        return (
            Text(printable(name)),
            ProgressBar(total=arm.episodes_planned, completed=arm.episodes, width=_BAR_WIDTH),
            share,
            f"{arm.runs_done}/{arm.runs_planned}",
            "" if arm.mean_return is None else short_return(arm.mean_return),
            ("" if left is None else clock(left)) if is_under_way else "waiting",
            Text(printable(shares(arm.selection_share))),
        )


def totals_line(arms: Mapping[str, ArmProgress], seconds: float, pace: Pace) -> str:
    """Of all arms together: the time that they took, about how long they may still take, and steps per second.

    >>> totals_line({"APEL": ArmProgress(episodes_planned=10, episodes=5, steps=90)}, 2.0, Pace())
    '0:00:02 · 45 steps/s'
    """
    done, planned = (sum(getattr(arm, name) for arm in arms.values()) for name in ("episodes", "episodes_planned"))
    left = pace.left(seconds, done, planned)
    about = f" · about {clock(left)} left" if left else ""
    steps = sum(arm.steps for arm in arms.values()) / max(seconds, 1e-9)
    return f"{clock(seconds)}{about} · {short_count(steps)} steps/s"


def short_return(value: float) -> str:
    """In few characters.

    >>> short_return(-0.123), short_return(199.5), short_return(-12345.6), short_return(3.2e9)
    ('-0.12', '199.5', '-12,346', '3.2e+09')
    """
    size = abs(value)
    return f"{value:.2g}" if size >= 1e7 else f"{value:,.0f}" if size >= 1e3 else f"{value:.{2 if size < 100 else 1}f}"


def shares(selection_share: Mapping[str, float]) -> str:
    """Shares in per cent, of many learners the largest; nothing of a learner alone.

    >>> shares({"Q": 0.6, "P": 0.4}), shares({"Q": 1.0})
    ('Q 60, P 40', '')
    >>> shares({"A": 0.1, "B": 0.5, "C": 0.1, "D": 0.3})
    'B 50, D 30, A 10, …'
    """
    parts = list(selection_share.items())
    if len(parts) < 2:
        return ""
    if len(parts) > _MOST_SHARES:
        parts = sorted(parts, key=lambda part: -part[1])[:_MOST_SHARES]
    text = ", ".join(f"{learner} {100 * share:.0f}" for learner, share in parts)
    return text if len(parts) == len(selection_share) else f"{text}, …"
