"""Results and checkpoints on an object store that all workers reach: the same rows as on a disk."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from cluster.events import ShardEvent
from cluster.shard import Execution, Shard
from jobs.experiment.spec_files import load_experiment
from jobs.progress.observers import NO_OBSERVER, Observer
from jobs.progress.progress import JobProgress
from jobs.results.storage import Folder
from jobs.results.store import CheckpointFiles
from jobs.runner import Outcome, Settings, run_experiment
from tests.command_line import call, printed
from tests.s3_server import Bucket
from tests.same_rows import assert_same, folder_of


def run(small: Path, results: str, observer: Observer = NO_OBSERVER, **settings: object) -> Outcome:
    """Run the small experiment."""
    chosen = Settings(results=results, dashboard=False, **{"placement": "local", **settings})  # type: ignore[arg-type]
    return run_experiment(load_experiment(str(small)), chosen, observer)


def fetched(folder: Folder, target: Path) -> Path:
    """A copy of all files on this disk."""
    for name in folder.names():
        (target / name).parent.mkdir(parents=True, exist_ok=True)
        (target / name).write_bytes(folder.read(name))
    return target


def test_local_placement(small: Path, tmp_path: Path, s3: Bucket) -> None:
    """Rows that are written to S3 are those that are written to a disk."""
    outcome = run(small, s3.fresh())
    assert outcome.num_computed == 18
    assert_same(fetched(outcome.store.folder, tmp_path / "copy"), folder_of(run(small, str(tmp_path / "disk"))))


@pytest.mark.ray
@pytest.mark.usefixtures("ray_session")
def test_packed_placement(small: Path, tmp_path: Path, s3: Bucket) -> None:
    """Workers of a Ray cluster write to S3 themselves, and the second time nothing is computed."""
    root = s3.fresh()
    outcome = run(small, root, placement="packed", shard_size=2)
    assert_same(fetched(outcome.store.folder, tmp_path / "copy"), folder_of(run(small, str(tmp_path / "disk"))))
    assert run(small, root).num_computed == 0


class _Interrupter(Observer):
    """Breaks a job off at its n-th event."""

    def __init__(self, num_events: int) -> None:
        self._left = num_events

    def progressed(self, shard: Shard, event: ShardEvent, progress: JobProgress) -> None:
        self._left -= 1
        if not self._left:
            raise KeyboardInterrupt


def test_resumes_from_a_checkpoint(small: Path, tmp_path: Path, s3: Bucket, monkeypatch: pytest.MonkeyPatch) -> None:
    """An interrupted job goes on from the checkpoint that lies on S3, to the rows of one that was not."""
    root = s3.fresh()
    often = Execution(
        streak_episodes=5, checkpoint_seconds=0.0, checkpoint_share=1.0, checkpoint_episodes=1, progress_seconds=0.0
    )
    with pytest.raises(KeyboardInterrupt):
        run(small, root, _Interrupter(6), execution=often, shard_size=6)
    folder = Folder(root)
    assert any("/checkpoints/" in name for name in folder.names())
    found: list[bool] = []
    read = CheckpointFiles.read

    def spy(store: CheckpointFiles, shard: Shard) -> bytes | None:
        content = read(store, shard)
        found.append(content is not None)
        return content

    monkeypatch.setattr(CheckpointFiles, "read", spy)
    outcome = run(small, root, execution=often, shard_size=6)
    assert any(found)
    assert_same(fetched(outcome.store.folder, tmp_path / "copy"), folder_of(run(small, str(tmp_path / "disk"))))
    assert not any("/checkpoints/" in name for name in folder.names())


def test_commands(small: Path, s3: Bucket, capsys: pytest.CaptureFixture[str]) -> None:
    """The commands that read results take a URI with keys, print none of them, and print what can be used again."""
    root = s3.fresh("AKIAEXAMPLE:abc%2FdefEXAMPLEKEY@")
    said = run(small, root).store.folder.location("runs.parquet")
    location = re.search(r"s3://\S*/small-maze/\w+", said)
    assert location is not None
    assert said == f"{location.group()}/runs.parquet?{s3.query}"
    place = location.group().replace("***@", "AKIAEXAMPLE:abc%2FdefEXAMPLEKEY@")
    said += printed(capsys, "show", f"{place}?{s3.query}")
    assert "APEL" in said
    said += printed(capsys, "figures", f"{place}?{s3.query}")
    assert f"/report.html?{s3.query}" in said
    said += printed(capsys, "claims", root)
    folder = Folder(root)
    assert {"runs.parquet", "report.html"} <= {name.rpartition("/")[2] for name in folder.names()}
    assert "EXAMPLEKEY" not in said
    for name in folder.names():
        assert b"EXAMPLEKEY" not in folder.read(name), name


def test_bucket_that_is_not_there(small: Path, s3: Bucket, capsys: pytest.CaptureFixture[str]) -> None:
    """A bucket that is not there is bad input: one message, and nothing is computed."""
    results = f"s3://no-such-bucket/r?{s3.query}"
    code, error = call(capsys, "run", str(small), "--placement", "local", "--results", results)
    assert code == 2
    assert "make the bucket, or choose another --results" in error
    assert "Traceback" not in error
