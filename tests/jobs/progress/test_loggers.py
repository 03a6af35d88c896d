"""``--log``: who is told how a job goes on, by name or by import path, and what is refused before anything starts."""

from __future__ import annotations

import json
import struct
import sys
import threading
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from jobs import ArmProgress, JobInfo, Settings, load_experiment, run_experiment
from jobs.cli.user_modules import find_user_modules
from jobs.experiment.yaml_source import SpecError
from jobs.progress import apart
from jobs.progress.apart import Apart
from jobs.progress.loggers import check_words, observer_of
from jobs.progress.wandb import WandbRuns
from tests.command_line import call

LIGHTS = """
import json, pathlib

class Lights:
    def begin(self, job):
        self.told = [job.experiment, list(job.content["arms"])]

    def progress(self, arms):
        self.told.append({name: [arm.runs_done, arm.mean_return, arm.selection_share] for name, arm in arms.items()})

    def end(self, ending):
        pathlib.Path("lights.json").write_text(json.dumps([*self.told, ending]))

class Fused(Lights):
    def progress(self, arms):
        raise SystemExit("no more bulbs")

class Unplugged:
    def __init__(self):
        raise OSError("no socket")

class Dim:
    def begin(self, job):
        pass
"""


@pytest.fixture
def lights(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """A module of observers in the working directory."""
    (tmp_path / "lights.py").write_text(LIGHTS)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path])
    yield
    sys.modules.pop("lights", None)


def job_of(small: Path, results: Path) -> JobInfo:
    """What an observer is told of the small experiment."""
    experiment = load_experiment(str(small))
    return JobInfo(experiment.name, experiment.identity, str(results), "", experiment.content())


def played(small: Path, results: Path, word: str) -> Any:
    """The run rows of the small experiment, which a logger was told of; what it raises fails the test."""
    job = job_of(small, results)
    observer = Apart(word, observer_of(word, job), job, pytest.fail)
    settings = Settings(results=str(results), placement="local")
    return run_experiment(load_experiment(str(small)), settings, observer).store.runs().to_pandas()


def test_observer_of_ones_own(lights: None, small: Path, tmp_path: Path) -> None:
    """It is told the beginning, the last state and the end; a job without anything to play tells it nothing."""
    find_user_modules()
    rows = played(small, tmp_path / "results", "lights:Lights")
    experiment, arms, *states, ending = json.loads(Path("lights.json").read_text())
    assert (experiment, arms, ending) == ("small-maze", ["Q_full", "APEL", "SSBAS"], "done")
    assert [states[-1][arm][0] for arm in arms] == [6, 6, 6]
    assert sum(states[-1]["APEL"][2].values()) == pytest.approx(1.0)
    Path("lights.json").unlink()
    assert played(small, tmp_path / "results", "lights:Lights").equals(rows)
    assert not Path("lights.json").exists()


def test_observer_that_raises(lights: None, small: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The job is played to its end; the user is told once, with the line."""
    words = ("run", str(small), "--placement", "local", "--quiet", "--log", "lights:Fused")
    code, error = call(capsys, *words)
    assert code == 0
    assert error.count("note: ") == error.count('no more bulbs")') == 1
    assert "--log lights:Fused: progress raised SystemExit: no more bulbs" in error
    assert "in progress: raise SystemExit" in error
    assert json.loads(Path("lights.json").read_text())[-1] == "done"


@pytest.mark.parametrize(
    ("word", "expected"),
    [
        ("lights:Dark", "--log: found the import path 'lights:Dark', but module 'lights' has no 'Dark'"),
        ("no_lights:Dark", "--log: found the import path 'no_lights:Dark', but importing 'no_lights' failed"),
        ("lights:Unplugged", "--log lights:Unplugged: found OSError: no socket on making it without arguments"),
        ("lights:Dim", "--log lights:Dim: found a Dim without progress, end, expected one with the methods"),
        ("mlfow", "--log: found 'mlfow', expected tensorboard[:DIR], mlflow[:URI], wandb, or an import path"),
        ("wandb:project", "--log: found 'wandb:project', expected wandb: WANDB_PROJECT and WANDB_DIR say the rest"),
    ],
)
def test_refused_before_anything_starts(
    word: str, expected: str, lights: None, small: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """One line, exit code 2, and no results."""
    code, error = call(capsys, "run", str(small), "--results", "results", "--log", word)
    assert code == 2
    assert error.startswith(f"error: {expected}")
    assert len(error.splitlines()) == 1
    assert not Path("results").exists()


@pytest.mark.parametrize(
    ("name", "package"), [("tensorboard", "tensorboardX"), ("mlflow", "mlflow"), ("wandb", "wandb")]
)
def test_package_that_is_not_there(
    name: str, package: str, small: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The extra is named; a folder of that name, as wandb leaves it, is no package."""
    (tmp_path / package).mkdir()
    for known in [known for known in sys.modules if known.split(".")[0] == package]:
        monkeypatch.delitem(sys.modules, known)
    monkeypatch.setattr(sys, "path", [str(tmp_path)])
    with pytest.raises(SpecError, match=rf"found no {package}, .*pip install 'apel\[{name}\]'"):
        observer_of(name, job_of(small, tmp_path))


def test_twice() -> None:
    """Two writers would write over each other."""
    with pytest.raises(SpecError, match="found 'wandb' twice"):
        check_words(["wandb", "tensorboard", "wandb"])


@pytest.mark.parametrize(
    ("word", "variables", "results", "expected"),
    [
        ("tensorboard", {}, "s3://lab/results", "found results at s3://lab/results, .* expected tensorboard:DIR"),
        ("wandb", {}, "s3://lab/results", "expected WANDB_DIR"),
        ("wandb", {"WANDB_MODE": "sometimes"}, "r", "found WANDB_MODE=sometimes, expected one of offline, online"),
        ("mlflow:file:///runs", {}, "r", "found 'file:///runs', expected the URI of a tracking server or database"),
        ("mlflow", {"MLFLOW_TRACKING_URI": "ftp://x"}, "r", "found 'ftp://x', expected the URI"),
        ("mlflow:http://127.0.0.1:9", {}, "r", "found no answer at http://127.0.0.1:9 .ConnectionError"),
        ("mlflow:sqlite:///no/such/m.db", {}, "r", "found no folder 'no/such', expected one for the database"),
    ],
)
def test_nowhere_to_write(
    word: str, variables: Mapping[str, str], results: str, expected: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each is refused with what would do; whether the packages are there is another question."""
    monkeypatch.setattr("jobs.progress.loggers._expect_installed", lambda *_: None)
    for name in ("WANDB_MODE", "WANDB_DIR", "MLFLOW_TRACKING_URI"):
        monkeypatch.delenv(name, raising=False)
    for name, value in variables.items():
        monkeypatch.setenv(name, value)
    with pytest.raises(SpecError, match=expected):
        observer_of(word, JobInfo("e", "i", results, "", {}))


def test_mlflow_on_a_cluster_needs_a_place(monkeypatch: pytest.MonkeyPatch) -> None:
    """The folder of a submitted job is gone when it is over: no database there."""
    monkeypatch.setattr("jobs.progress.loggers._expect_installed", lambda *_: None)
    monkeypatch.delenv("MLFLOW_TRACKING_URI", raising=False)
    with pytest.raises(SpecError, match="found no MLFLOW_TRACKING_URI on the cluster"):
        observer_of("mlflow", JobInfo("e", "i", "/r", "job-1", {}))


class Slow:
    """Takes longer than the job; keeps how often it was told."""

    def __init__(self) -> None:
        self.goes_on, self.told = threading.Event(), list[int]()

    def begin(self, job: JobInfo) -> None:
        self.goes_on.wait(60.0)

    def progress(self, arms: Mapping[str, ArmProgress]) -> None:
        self.told.append(arms["APEL"].runs_done)

    def end(self, ending: str) -> None:
        pass


def test_nobody_waits_for_a_slow_observer(small: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The job is over first; an observer that does not come to its end is left behind, and the user told."""
    monkeypatch.setattr(apart, "_PAUSE_SECONDS", 0.0)
    monkeypatch.setattr(apart, "_END_SECONDS", 0.05)
    slow, said = Slow(), list[str]()
    observer = Apart("slow", slow, job_of(small, tmp_path), said.append)
    settings = Settings(results=str(tmp_path / "results"), placement="local")
    assert not run_experiment(load_experiment(str(small)), settings, observer).failures
    assert len(said) == 1
    assert "was not done within 0 s after the job" in said[0]
    slow.goes_on.set()
    end = time.monotonic() + 60.0
    while not slow.told:
        assert time.monotonic() < end
        time.sleep(0.001)
    assert slow.told == [6]


@pytest.mark.filterwarnings("ignore")  # MLflow's own, about SQLAlchemy
def test_mlflow(small: Path, tmp_path: Path) -> None:
    """A run per arm with its parameters, its last metrics against episodes and steps, and how it ended."""
    pytest.importorskip("mlflow")
    uri = f"sqlite:///{tmp_path / 'mlflow.db'}"
    rows = played(small, tmp_path / "results", f"mlflow:{uri}")
    from mlflow import MlflowClient

    client = MlflowClient(tracking_uri=uri)
    experiment = client.get_experiment_by_name("small-maze")
    runs = {run.info.run_name: run for run in client.search_runs([experiment.experiment_id])}
    assert sorted(runs) == ["APEL", "Q_full", "SSBAS"]
    mine = rows[rows["arm"] == "APEL"]
    run = runs["APEL"]
    assert run.info.status == "FINISHED"
    assert run.data.params["selector.type"] == "apel"
    assert run.data.metrics["mean_train_time"] == pytest.approx(mine["train_time"].mean())
    assert {"selection_share/Q_full", "selection_share/Q_red", "by_steps/mean_return"} <= set(run.data.metrics)
    for name, column in (("runs_done", "episodes"), ("by_steps/runs_done", "steps")):
        last = client.get_metric_history(run.info.run_id, name)[-1]
        assert (last.value, last.step) == (6.0, round(mine[column].mean()))


def test_wandb_offline(small: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without WANDB_MODE nothing is sent: a file per arm lies beside the results, for `wandb sync`."""
    pytest.importorskip("wandb")
    monkeypatch.delenv("WANDB_MODE", raising=False)
    rows = played(small, tmp_path, "wandb")
    files = sorted((tmp_path / "wandb").glob("offline-run-*/run-*.wandb"))
    found = {}
    for file in files:
        run, history, code = wandb_records(file)
        found[run.display_name] = history
        assert (run.project, code) == ("small-maze", 0)
    assert sorted(found) == ["APEL", "Q_full", "SSBAS"]
    mine = rows[rows["arm"] == "APEL"]
    last = found["APEL"][-1]
    assert (last["runs_done"], last["episodes"], last["steps"]) == pytest.approx(
        (6, mine["episodes"].mean(), mine["steps"].mean())
    )
    assert last["selection_share/Q_full"] + last["selection_share/Q_red"] == pytest.approx(1.0)


def wandb_records(file: Path) -> tuple[Any, list[dict[str, float]], int]:
    """What `wandb sync` would send of a file: the run, the rows that were logged, and the exit code."""
    from wandb.proto import wandb_internal_pb2

    run, history, code = None, [], -1
    for data in log_records(file.read_bytes()):
        record = wandb_internal_pb2.Record()
        record.ParseFromString(data)
        kind = record.WhichOneof("record_type")
        if kind == "run":
            run = record.run
        elif kind == "history":
            items = record.history.item
            history.append({item.key or "/".join(item.nested_key): json.loads(item.value_json) for item in items})
        elif kind == "exit":
            code = record.exit.exit_code
    return run, history, code


def log_records(content: bytes) -> Iterator[bytes]:
    """The records of a file of LevelDB's log format, after wandb's own seven bytes at the beginning.

    https://github.com/google/leveldb/blob/main/doc/log_format.md
    """
    block, place, record = 32_768, 7, b""
    while place + 7 <= len(content):
        if block - place % block < 7:
            place += block - place % block
            continue
        length, kind = struct.unpack_from("<HB", content, place + 4)
        record += content[place + 7 : place + 7 + length]
        place += 7 + length
        if kind in (1, 4):  # whole, or the last part of one
            yield record
            record = b""


def test_wandb_online_needs_a_login(small: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """It is not asked for in the middle of a job."""
    logins: list[bool] = []
    wandb = ModuleType("wandb")
    wandb.login = lambda *, prompt: bool(logins and not prompt)  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "wandb", wandb)
    monkeypatch.setattr("jobs.progress.loggers._expect_installed", lambda *_: None)
    monkeypatch.setenv("WANDB_MODE", "online")
    with pytest.raises(SpecError, match="found WANDB_MODE=online and no login"):
        observer_of("wandb", job_of(small, tmp_path))
    logins.append(True)
    assert isinstance(observer_of("wandb", job_of(small, tmp_path)), WandbRuns)
