"""How far a job has come, from what its shards tell; and everything that shows it."""

from __future__ import annotations

import io
import json
import math
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from rich.console import Console
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from cluster.errors import RunFailure
from cluster.events import ShardDone, ShardEvent, ShardProgress, ShardRestarted
from cluster.shard import Shard
from jobs.cli.consoles import OUT
from jobs.cli.job_tables import arms_table, jobs_table, time_left
from jobs.experiment.plan import Plan
from jobs.experiment.spec_files import load_experiment
from jobs.progress import prometheus as metrics
from jobs.progress.apart import Apart
from jobs.progress.job_observer import JobInfo
from jobs.progress.observers import Observer, Observers, told_if_it_lasts
from jobs.progress.progress import JobProgress
from jobs.progress.prometheus import PrometheusObserver
from jobs.progress.status_file import StatusFile, read_status, status_file_name
from jobs.progress.tensorboard import EventFiles
from jobs.progress.terminal import TerminalObserver
from jobs.remote.status import Status
from jobs.runner import Settings, run_experiment

ARM = {
    **dict.fromkeys(("runs_planned", "runs_done", "runs_failed", "episodes", "episodes_planned", "steps"), 1),
    **dict.fromkeys(("mean_return", "mean_train_time"), None),
    "selection_share": {"Q": 1.0},
}
WHOLE = {"experiment": "e", "identity": "i", "results": "/r", "message": "", "seconds": 1.5, "arms": {"A": ARM}}


@pytest.fixture
def shards(small: Path) -> list[Shard]:
    """Two shards of three runs for each of APEL and Q_full, of 80 episodes."""
    return Plan.of(load_experiment(str(small))).only(["APEL", "Q_full"]).shards(num_cpus=2, shard_size=3)


def test_arms_are_put_together(shards: list[Shard]) -> None:
    """Numbers of an arm are sums over its shards; shares and means are over what was played lately.

    By hand: 40 of 60 episodes by Q_full; returns −30 − 6 over 60 episodes; train times 200 + 100 over three runs;
    concentrations 2 and 5, weighted by one and by two runs under way; 180 + 90 episodes and 1300 steps that six runs
    have really played, of which those that are over count with their cap of 80 where a share of the work is told.
    """
    progress = JobProgress()
    progress.planned(shards, [("APEL", "", 7), ("SSBAS", "", 0)])
    first, second = (shard for shard in shards if shard.arm.arm == "APEL")
    progress.progressed(
        first,
        ShardProgress(
            2,
            200,
            900,
            0,
            200,
            5,
            0.5,
            0.1,
            played=(30, 10),
            episode_return=-30.0,
            episodes_played=180,
            concentration=(2.0, 1.0),
        ),
    )
    progress.progressed(
        second,
        ShardProgress(
            1,
            100,
            400,
            0,
            100,
            4,
            0.3,
            0.2,
            played=(10, 10),
            episode_return=-6.0,
            episodes_played=90,
            concentration=(5.0, 1.0),
        ),
    )
    arm = progress.arms()["APEL"]
    assert (arm.runs_planned, arm.runs_done, arm.runs_failed) == (7, 4, 0)
    assert (arm.episodes, arm.episodes_planned, arm.episodes_per_run, arm.steps) == (300, 480, 45.0, 1300)
    assert arm.steps_per_run == pytest.approx(1300 / 6)
    assert (arm.rounds, arm.round_seconds) == (9, 0.8)
    assert arm.checkpoint_seconds == pytest.approx(0.3)
    assert arm.selection_share == {"Q_full": 40 / 60, "Q_red": 20 / 60}
    assert arm.mean_return == -36 / 60
    assert arm.mean_train_time == 100.0
    assert arm.concentration == {"Q_full": (2.0 + 2 * 5.0) / 3, "Q_red": 1.0}
    other = progress.arms()["SSBAS"]
    assert (other.runs_planned, other.runs_done, other.episodes_planned) == (1, 1, 0)


def test_end_of_a_shard(shards: list[Shard]) -> None:
    """Once it is over all its runs count, those too that failed before they could report; a fault counts as restart."""
    progress = JobProgress()
    progress.planned(shards, [])
    shard = next(shard for shard in shards if shard.arm.arm == "APEL")
    failure = RunFailure("APEL", "", 0, 1, "(environment)", 0, "no world")
    progress.progressed(shard, ShardRestarted(1, 0.5, "died"))
    progress.progressed(shard, ShardDone((failure,), 1000, 2.0, 7))
    arm = progress.arms()["APEL"]
    assert (arm.runs_done, arm.runs_failed, arm.episodes, arm.steps) == (3, 1, 240, 1000)
    assert progress.as_json()["restarts"] == 1


def test_report_without_an_episode(shards: list[Shard]) -> None:
    """The latest episodes are those of the report before, until others were played; also once the shard is over."""
    progress = JobProgress()
    progress.planned(shards, [])
    shard = next(shard for shard in shards if shard.arm.arm == "APEL")
    progress.progressed(shard, ShardProgress(0, 20, 90, played=(15, 5), episode_return=-30.0))
    progress.progressed(shard, ShardProgress(3, 240, 90, played=(0, 0), episode_return=0.0))
    progress.progressed(shard, ShardDone((), 1000, 2.0, 7))
    arm = progress.arms()["APEL"]
    assert (arm.runs_done, arm.mean_return, arm.selection_share) == (3, -1.5, {"Q_full": 0.75, "Q_red": 0.25})


def test_return_that_is_no_number(shards: list[Shard]) -> None:
    """A mean that is no number is none: JSON has no word for it."""
    progress = JobProgress()
    progress.planned(shards, [])
    progress.progressed(shards[0], ShardProgress(0, 9, 9, played=(9, 0), episode_return=math.nan))
    assert progress.arms()[shards[0].arm.arm].mean_return is None
    json.loads(json.dumps(progress.as_json(), allow_nan=False))


class Recorder(Observer):
    """Keeps the events, and the last progress."""

    def __init__(self) -> None:
        self.events: list[ShardEvent] = []
        self.last: JobProgress | None = None
        self.endings: list[str] = []

    def progressed(self, shard: Shard, event: ShardEvent, progress: JobProgress) -> None:
        self.events.append(event)
        self.last = progress

    def ended(self, ending: str) -> None:
        self.endings.append(ending)


@pytest.mark.parametrize("changes", [[], ["steps=1000"]], ids=["episodes", "steps"])
def test_last_report_of_a_real_job(small: Path, tmp_path: Path, changes: list[str]) -> None:
    """The progress at the end is what the results say; runs that missed the criterion count with the cap."""
    recorder = Recorder()
    outcome = run_experiment(
        load_experiment(str(small), changes), Settings(results=str(tmp_path), placement="local"), Observers([recorder])
    )
    assert recorder.last is not None
    rows = outcome.store.counted_runs().to_pandas()
    for name, arm in recorder.last.arms().items():
        mine = rows[rows["arm"] == name]
        assert (arm.runs_done, arm.steps) == (len(mine), int(mine["steps"].sum()))
        assert arm.mean_train_time == pytest.approx(mine["train_time"].mean())
        assert sum(arm.selection_share.values()) == pytest.approx(1.0)
    assert recorder.endings == ["done"]


def test_status_file(shards: list[Shard], tmp_path: Path) -> None:
    """The file is there from the moment the cluster is, whole at any time, and says in the end how it ended."""
    observer = StatusFile("job-1", {"experiment": "small", "identity": "0", "results": "/results"})
    path = tmp_path / status_file_name("job-1")
    observer.waiting("for another job")
    observer.joined("", 2, tmp_path)
    assert json.loads(path.read_text())["message"] == "for another job"
    progress = JobProgress()
    progress.planned(shards, [])
    observer.planned(progress)
    found = json.loads(path.read_text())
    assert (found["state"], found["message"], found["arms"]["APEL"]["runs_planned"]) == ("running", "", 6)
    event = ShardProgress(1, 100, 400)
    progress.progressed(shards[0], event)
    observer.progressed(shards[0], event, progress)
    observer._began -= 10.0  # as if so many seconds had passed
    observer._last -= 10.0
    observer.progressed(shards[0], event, progress)
    running = read_status(path.read_bytes())
    assert running is not None
    # 100 of 960 episodes in 10 seconds and a little: 860 take 86 and a little.
    assert 85.9 < running["seconds_left"] < 120
    assert time_left(running).startswith("0:00:1")
    assert " so far, about 0:01:" in time_left(running)
    observer.ended("stopped")
    found = json.loads(path.read_text())
    assert (found["state"], found["arms"]["APEL"]["steps"]) == ("stopped", 400)
    assert found["seconds_left"] is None
    assert list(found["phases"]) == ["joined", "planned", "first_episode", "ended"]
    assert [file.name for file in tmp_path.iterdir() if file.name != "small.yaml"] == [path.name]
    assert read_status(path.read_bytes()) == found


@pytest.mark.parametrize(
    "content",
    [b"", b"\xff", b"[]", b"{}", b"[" * 100_000, b'{"arms": []}']
    + [
        json.dumps(WHOLE | change).encode()
        for change in (
            {"arms": {"[/red]": {}}},
            {"arms": {"A": ARM | {"steps": "many"}}},
            {"arms": {"A": ARM | {"steps": 10**400}}},
            {"arms": {"A": ARM | {"selection_share": [1]}}},
            {"seconds": None},
            {"seconds_left": math.inf},
            {"seconds_left": -1.0},
            {"results": ["/"]},
            {"message": {}},
        )
    ],
)
def test_status_of_another_make(content: bytes) -> None:
    """A file that is no status says nothing: one job must not keep the others from being listed."""
    assert read_status(json.dumps(WHOLE).encode()) == WHOLE
    assert read_status(content) is None


def test_hostile_status_is_shown(capsys: pytest.CaptureFixture[str]) -> None:
    """What a job calls itself and its arms is shown as it is, in both tables."""
    progress = WHOLE | {"arms": {"[/a]\x1b[2J": ARM}}
    OUT.print(jobs_table([Status("[/red]", "done", "", 0, progress)]))
    OUT.print(arms_table(progress))
    shown = capsys.readouterr().out
    assert "[/red]" in shown
    assert "[/a]\\u001b[2J" in shown


def event_files(folder: Path) -> Observer:
    """Told in a thread of its own, as `apel run` does; what it raises fails the test."""
    return Apart("tensorboard", EventFiles(str(folder)), JobInfo("small", "0", "", "", {}), pytest.fail)


def test_event_files(small: Path, tmp_path: Path) -> None:
    """TensorBoard's own reader finds the scalars of every arm, against episodes and against steps per run."""
    settings = Settings(results=str(tmp_path / "results"), placement="local")
    done = run_experiment(load_experiment(str(small)), settings, event_files(tmp_path / "board"))
    rows = done.store.runs().to_pandas()
    for arm in ("Q_full", "APEL", "SSBAS"):
        events = EventAccumulator(str(tmp_path / "board" / arm))
        events.Reload()
        assert {"runs_done", "mean_return", "mean_train_time", "selection_share/Q_full"} <= set(
            events.Tags()["scalars"]
        )
        assert [(event.step, event.value) for event in events.Scalars("runs_done")][-1] == (
            round(rows[rows["arm"] == arm]["episodes"].mean()),
            6.0,
        )
        assert [(event.step, event.value) for event in events.Scalars("by_steps/runs_done")][-1] == (
            round(rows[rows["arm"] == arm]["steps"].mean()),
            6.0,
        )
    assert "concentration/Q_red" not in events.Tags()["scalars"]


def test_event_files_end_where_the_runs_did(small: Path, tmp_path: Path) -> None:
    """With a limit of steps no event is at an episode that was never played: not at the cap of 2000."""
    spec = load_experiment(str(small), ["episodes=2000", "steps=300", "criterion=null", "runs=2"])
    settings = Settings(results=str(tmp_path / "results"), placement="local", arms=("Q_full",))
    done = run_experiment(spec, settings, event_files(tmp_path / "board"))
    rows = done.store.runs().to_pandas()
    events = EventAccumulator(str(tmp_path / "board" / "Q_full"))
    events.Reload()
    assert rows["episodes"].max() < 200
    assert events.Scalars("mean_return")[-1].step == round(rows["episodes"].mean())
    assert events.Scalars("by_steps/mean_return")[-1].step == round(rows["steps"].mean())


def test_compiling_is_told_only_where_it_lasts() -> None:
    """Half a minute is announced where it comes, and not where all is there already."""
    told: list[str] = []
    with told_if_it_lasts(lambda: told.append("soon"), seconds=30.0):
        pass
    assert told == []
    with told_if_it_lasts(lambda: told.append("now"), seconds=0.0):
        wait_until(lambda: told == ["now"])


def wait_until(holds: Callable[[], bool]) -> None:
    """Wait for another thread."""
    end = time.monotonic() + 300.0
    while not holds():
        assert time.monotonic() < end
        time.sleep(0.001)


class Series:
    """Keeps what is reported."""

    def __init__(self) -> None:
        self.gauges: dict[tuple[str, ...], float] = {}
        self.counters: dict[tuple[str, str | None], list[float]] = {}

    def set(self, name: str, value: float, **labels: str) -> None:
        self.gauges[name, *labels.values()] = value

    def raise_to(self, name: str, total: float, arm: str | None = None) -> None:
        self.counters.setdefault((name, arm), []).append(total)


def test_metrics(shards: list[Shard], monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Rounds and seconds are counted on over the processes that play a shard; gauges say what is now."""
    series = Series()
    monkeypatch.setattr("jobs.progress.prometheus_series.PrometheusSeries", lambda *_: series)
    monkeypatch.setattr(metrics, "_PAUSE_SECONDS", 0.0)
    observer = PrometheusObserver("small", "job-1")
    progress = JobProgress()
    progress.planned(shards, [])
    observer.joined("", 2, tmp_path)
    observer.planned(progress)
    shard = shards[0]
    reports = [
        ShardProgress(0, 10, 90, rounds=3, round_seconds=1.0, checkpoint_seconds=0.25, played=(10, 0)),
        ShardProgress(0, 20, 180, rounds=6, round_seconds=2.0, checkpoint_seconds=0.5, played=(5, 5)),
        # Another process, from a checkpoint.
        ShardProgress(1, 15, 130, rounds=5, round_seconds=0.5, checkpoint_seconds=0.0, played=(4, 1)),
    ]
    for event in reports:
        progress.progressed(shard, event)
        observer.progressed(shard, event, progress)
    assert series.counters["apel_round_seconds_total", "APEL"][-3:] == [1.0, 2.0, 2.5]
    assert series.counters["apel_checkpoint_seconds_total", "APEL"][-1] == 0.5
    assert series.counters["apel_episodes_total", "APEL"][-3:] == [10, 20, 15]
    assert series.gauges["apel_selection_share", "APEL", "Q_full"] == 0.8
    assert series.gauges["apel_runs_planned", "Q_full"] == 6
    assert series.gauges["apel_runs_done", "APEL"] == 1
    assert ("apel_mean_train_time", "Q_full") not in series.gauges


@pytest.mark.ray
def test_counters_never_fall(ray_session: None) -> None:
    """A counter stays where it was while a shard plays again what a fault has cost."""
    from jobs.progress.prometheus_series import PrometheusSeries

    raised: list[tuple[float, dict[str, str]]] = []
    series = PrometheusSeries("small", "job-1")
    series._counters["apel_episodes_total"].inc = lambda value, tags: raised.append((value, tags))
    for total in (10, 20, 15, 20, 26):
        series.raise_to("apel_episodes_total", total, "APEL")
    labels = {"experiment": "small", "apel_job": "job-1", "arm": "APEL"}
    assert raised == [(10, labels), (10, labels), (6, labels)]


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """A clock that stands still until it is moved."""
    now = [0.0]
    monkeypatch.setattr("jobs.progress.terminal.time.monotonic", lambda: now[0])
    return now


def test_lines_in_a_log(shards: list[Shard], clock: list[float], tmp_path: Path) -> None:
    """Where the output is no terminal there is a line every few seconds, and one at the end; a restart is told."""
    written = io.StringIO()
    observer = TerminalObserver(Console(file=written, width=120))
    progress = JobProgress()
    progress.planned(shards, [("APEL", "", 0)])
    observer.joined("127.0.0.1:8265", 2, tmp_path)
    observer.planned(progress)
    for second in range(20):
        clock[0] = float(second)
        event = ShardProgress(0, 10 * second, 1_000_000 * second)
        progress.progressed(shards[0], event)
        observer.progressed(shards[0], event, progress)
    observer.progressed(shards[0], ShardRestarted(1, 0.5, "died"), progress)
    observer.ended("done")
    lines = written.getvalue().splitlines()
    assert lines[0] == "Ray with 2 CPUs"
    assert lines[2] == "1 run is already finished"
    assert [line.split(" · ")[2] for line in lines if line.startswith("APEL 1/7")] == [
        "0:00:05",
        "0:00:10",
        "0:00:15",
        "0:00:19",
    ]
    # Of 960 episodes 50 are played after five seconds, and 100, the later half of them in five seconds, after ten.
    assert "APEL 1/7 (10 %) · Q_full 0/6 (0 %) · 0:00:05 · 1.0 M steps/s" in lines[3]
    assert "APEL 1/7 (21 %) · Q_full 0/6 (0 %) · 0:00:10 · about 0:01:26 left · 1.0 M steps/s" in lines[4]
    assert f"{shards[0].label}: its processes died; restarting from its checkpoint in 0.5 s" in lines
