"""A storage that is full, forbidden, slow or unreliable costs time at most: no row changes, and none is lost."""

from __future__ import annotations

import errno
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from datetime import UTC, datetime, tzinfo
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import jobs.progress.status_file
import jobs.results.lease
import jobs.runner
from cluster.coordinator import Coordinator
from cluster.local import LocalHosts
from cluster.retry import RetryPolicy
from cluster.shard import Execution
from jobs.experiment.plan import Plan
from jobs.experiment.spec_files import load_experiment
from jobs.results.storage import Folder
from jobs.results.storage_faults import StorageError
from jobs.results.store import CheckpointFiles, ParquetSink, ResultStore
from jobs.runner import Settings, run_experiment
from tests.command_line import call
from tests.experiments import SMALL
from tests.same_rows import assert_same

WriteOnce = Callable[[Folder, str, Callable[[str], None]], None]
write_once: WriteOnce = Folder._write_once


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The results of the small experiment on a storage that works."""
    folder = tmp_path_factory.mktemp("undisturbed")
    (folder / "small.yaml").write_text(SMALL)
    return run(folder / "small.yaml", folder)


def run(small: Path, results: Path) -> Path:
    """Run in this process; the folder of the results."""
    experiment = load_experiment(str(small))
    outcome = run_experiment(experiment, Settings(results=str(results), placement="local", shard_size=2))
    return Path(outcome.store.folder.path())


def command(small: Path, results: Path) -> list[str]:
    """The same as a command."""
    return ["run", str(small), "--placement", "local", "--shard-size", "2", "--results", str(results), "--quiet"]


def temporary_files(folder: Path) -> list[Path]:
    """What is half-written."""
    return list(folder.rglob("*.tmp"))


def full_after(num_writes: int, code: int) -> WriteOnce:
    """Half of each file is written, then there is an error; the first ``num_writes`` files are whole."""
    done = 0

    def write(folder: Folder, target: str, write: Callable[[str], None]) -> None:
        nonlocal done
        done += 1
        if done <= num_writes:
            return write_once(folder, target, write)

        def half(path: str) -> None:
            Path(path).write_bytes(b"half")
            raise OSError(code, os.strerror(code))

        return write_once(folder, target, half)

    return write


@pytest.mark.parametrize(
    ("num_writes", "code"),
    [(0, errno.EROFS), (0, errno.EACCES), (3, errno.ENOSPC), (4, errno.EDQUOT), (5, errno.EACCES), (12, errno.ENOSPC)],
)
def test_storage_that_takes_no_more(
    num_writes: int,
    code: int,
    small: Path,
    tmp_path: Path,
    undisturbed: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Wherever a job is when its storage takes no more, it ends in one error, and the same command completes it."""
    results = tmp_path / "results"
    with monkeypatch.context() as patch:
        patch.setattr(Folder, "_write_once", full_after(num_writes, code))
        status, error = call(capsys, *command(small, results))
    # At the very first it is bad input: nothing can be written there.
    assert status == (2 if num_writes == 0 else 1)
    assert error.count("error: ") == 1
    assert f"found '{os.strerror(code)}' while writing" in error
    assert "the same command resumes from there" in error
    assert "Traceback" not in error
    assert temporary_files(results) == []
    assert call(capsys, *command(small, results)) == (0, "")
    assert_same(next(results.rglob("runs.parquet")).parent, undisturbed)


LIMITED = """
import resource, signal, sys
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (5000, 5000))
from jobs.cli.main import main
main()
"""


def test_disk_that_is_really_full(
    small: Path, tmp_path: Path, undisturbed: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Where write(2) itself fails, earlier results stay readable, nothing is half-written, and the job goes on."""
    results = tmp_path / "results"
    assert call(capsys, *command(small, results), "--arms", "Q_full")[0] == 0
    folder = next(results.rglob("runs.parquet")).parent
    before = {path: path.read_bytes() for path in folder.rglob("*.parquet")}
    limited = subprocess.run(
        [sys.executable, "-B", "-c", LIMITED, *command(small, results)],
        capture_output=True,
        text=True,
        check=False,
        timeout=600,
    )
    assert limited.returncode == 1
    assert limited.stderr.count("error: ") == 1
    assert "found 'File too large' while writing: free space, or choose another --results" in limited.stderr
    assert "Traceback" not in limited.stderr
    assert temporary_files(folder) == []
    assert all(path.read_bytes() == content for path, content in before.items() if "parts" in path.parts)
    assert len(pd.read_parquet(folder / "runs.parquet")) >= 6
    assert call(capsys, "show", str(folder))[0] == 0
    assert call(capsys, *command(small, results))[0] == 0
    assert_same(folder, undisturbed)


@pytest.mark.parametrize("place", ["/proc/results", "/sys/results"])
def test_read_only_results(place: str, small: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A place that takes no writes, not even the superuser's, is refused with what to do."""
    status, error = call(capsys, *command(small, Path(place)))
    assert status == 2
    assert error.count("error: ") == 1
    assert "choose another --results" in error
    assert "Traceback" not in error


def test_killed_while_writing(small: Path, tmp_path: Path, undisturbed: Path) -> None:
    """What a process that was killed while it wrote has left is no result, and is cleared away; leases are not."""
    folder = run(small, tmp_path)
    parts = folder / "parts" / "arm=APEL"
    parts_before = sorted(parts.iterdir())
    left = [parts / ".000000-000001.parquet.0123abcd.tmp", folder / ".runs.parquet.0123abcd.tmp"]
    left += [folder / name / "arm=APEL" / ".x.0123abcd.tmp" for name in ("episodes", "checkpoints", "spilled")]
    lease = folder / "claims" / ".other.json.0123abcd.tmp"
    for path in (*left, lease):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(b"PAR1 half")
    (parts / "000000-000001.parquet").unlink()
    plan = Plan.of(load_experiment(str(small)))
    assert len(ResultStore(Folder(str(folder))).finished(plan)) == 16
    assert run(small, tmp_path) == folder
    assert [path for path in left if path.exists()] == []
    assert lease.exists()
    assert sorted(parts.iterdir()) == parts_before
    assert_same(folder, undisturbed)


def test_slow_storage(small: Path, tmp_path: Path, undisturbed: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A storage that takes its time for every write changes no row."""

    def slow(folder: Folder, target: str, write: Callable[[str], None]) -> None:
        time.sleep(0.05)
        write_once(folder, target, write)

    monkeypatch.setattr(Folder, "_write_once", slow)
    assert_same(run(small, tmp_path), undisturbed)


@pytest.mark.parametrize("seed", range(5))
def test_unreliable_storage(
    seed: int, small: Path, tmp_path: Path, undisturbed: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Faults that pass, of a third of all writes, change no row: also those where only the answer was lost."""
    rng = np.random.default_rng(np.random.SeedSequence(seed))
    num_faults = 0

    def unreliable(folder: Folder, target: str, write: Callable[[str], None]) -> None:
        nonlocal num_faults
        kind = int(rng.integers(9))
        if kind == 0:
            num_faults += 1
            raise OSError(errno.EIO, "lost before")
        write_once(folder, target, write)
        if kind in (1, 2):
            num_faults += 1
            message = (
                "When completing: AWS Error NETWORK_CONNECTION during CompleteMultipartUpload operation: lost after"
            )
            raise OSError(message)

    make = Folder.__init__

    def patient(folder: Folder, root: str, *_: object) -> None:
        make(folder, root, RetryPolicy(12, 0.0))

    monkeypatch.setattr(Folder, "_write_once", unreliable)
    monkeypatch.setattr(Folder, "__init__", patient)
    assert_same(run(small, tmp_path), undisturbed)
    assert num_faults > 5


class JumpingDatetime(datetime):
    """A wall clock that someone sets forward and back all the time."""

    days: Iterator[int] = iter(())

    @classmethod
    def now(cls, tz: tzinfo | None = None) -> datetime:  # type: ignore[override]
        return datetime(2030, 1, 1 + next(cls.days), tzinfo=tz or UTC)


def test_clock_that_jumps(small: Path, tmp_path: Path, undisturbed: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A wall clock that goes back and forth by days changes no row, and no duration."""
    rng = np.random.default_rng(0)
    days = iter(lambda: int(rng.integers(28)), -1)
    monkeypatch.setattr(JumpingDatetime, "days", days)
    monkeypatch.setattr(time, "time", lambda: 1e9 + 86400.0 * next(days))
    for module in (jobs.results.lease, jobs.runner, jobs.progress.status_file):
        monkeypatch.setattr(module, "datetime", JumpingDatetime)
    began = time.monotonic()
    folder = run(small, tmp_path)
    elapsed = time.monotonic() - began
    monkeypatch.undo()
    assert_same(folder, undisturbed)
    (session,) = json.loads((folder / "manifest.json").read_text())["sessions"]
    assert session["began"].startswith("2030-01-")
    assert 0 < session["seconds"] <= elapsed
    assert all(0 < arm["seconds"] <= elapsed for arm in session["arms"].values())


def test_node_that_shares_no_disk(small: Path, tmp_path: Path) -> None:
    """A node that does not see the driver's results says so when it begins a shard, not when all was computed."""
    shard = Plan.of(load_experiment(str(small))).only(["APEL"]).shards(num_cpus=1, shard_size=100)[0]
    checkpoints = CheckpointFiles(Folder(str(tmp_path / "of this node")))
    coordinator = Coordinator(LocalHosts(), ParquetSink(Folder(str(tmp_path))), checkpoints, Execution())
    with pytest.raises(StorageError, match="expected a place that all nodes share"):
        list(coordinator.run(shard))


def test_checkpoint_of_a_shard_that_is_done(small: Path, tmp_path: Path) -> None:
    """What a process left that died between storing a shard and forgetting its checkpoint is forgotten later."""
    experiment, settings = load_experiment(str(small)), Settings(results=str(tmp_path), placement="local")
    folder = run_experiment(experiment, settings).store.folder
    folder.write(f"checkpoints/{folder.names('parts')[0].removesuffix('.parquet')}.npz", b"left")
    run_experiment(experiment, settings)
    assert folder.names("checkpoints") == []
