"""What a terminal shows while a job runs."""

from __future__ import annotations

import io

import pytest
from rich.cells import cell_len

from jobs.cli.consoles import TextConsole
from jobs.progress.live_table import LiveTable
from jobs.progress.pace import Pace
from jobs.progress.progress import ArmProgress

ARM = ArmProgress(runs_planned=100, runs_done=12, episodes_planned=1000, episodes=250, steps=9_000)
ARMS = {
    "APEL": ArmProgress(**{**vars(ARM), "mean_return": -12.345, "selection_share": {"Q_full": 0.61, "Q_red": 0.39}}),
    "a-name-that-is-much-longer": ArmProgress(
        **{**vars(ARM), "mean_return": -123_456.7, "runs_failed": 3}
        | {"selection_share": {f"learner_number_{number}": number / 10 for number in range(1, 5)}}
    ),
    "alone[/red]": ArmProgress(runs_planned=100, episodes_planned=500, selection_share={"Q": 1.0}),
}


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """A clock that stands still until it is moved."""
    now = [0.0]
    monkeypatch.setattr("jobs.progress.live_table.time.monotonic", lambda: now[0])
    return now


def shown(clock: list[float]) -> list[str]:
    """The last state of a table of 80 columns, where the arms went from 150 episodes to 250 in a minute."""
    written = io.StringIO()
    console = TextConsole(file=written, width=80)
    table = LiveTable(console)
    before = {name: ArmProgress(**{**vars(arm), "episodes": arm.episodes and 150}) for name, arm in ARMS.items()}
    table.begin(before)
    clock[0] = 60.0
    table.show(lambda: ARMS)
    table.end()
    return written.getvalue().splitlines()[-5:]


def test_one_row_per_arm(clock: list[float]) -> None:
    """Bar, runs, return, time left and shares of each, and all of them together below."""
    heading, first, second, third, total = shown(clock)
    assert heading.split() == ["arm", "runs", "return", "left", "selected,", "%"]
    assert first.split(maxsplit=2)[0] == "APEL"
    assert first.split("%", 1)[1].rstrip().split(maxsplit=3) == ["12/100", "-12.35", "0:07:30", "Q_full 61, Q_red 39"]
    assert second.startswith("a-name-that-i…")
    assert "25 % 12/100 -123,457 0:07:30 learner_number_4 4" in " ".join(second.split())
    assert third.startswith("alone[/red]")
    assert third.split()[-2:] == ["0/100", "waiting"]
    assert total == "0:01:00 · about 0:10:00 left · 300 steps/s · 3 failed"


def test_eighty_columns(clock: list[float]) -> None:
    """No row is wider, whatever the names."""
    assert max(cell_len(line) for line in shown(clock)) <= 80


def test_pace_is_that_of_the_later_half() -> None:
    """What went slowly at first and goes fast now will be over soon, however long it has gone on."""
    pace = Pace()
    left = None
    for second in range(1000):
        done = second if second < 500 else 500 + 10 * (second - 500)
        left = pace.left(float(second), done, 10_000)
    # At 999 s 5 490 are done, the last 4 990 of them at ten a second.
    assert left == pytest.approx(451.0, rel=0.02)
