"""What a job calls itself is as good as whoever submitted it: nothing is written outside of the named folder."""

from __future__ import annotations

from pathlib import Path

import pytest

from cluster.errors import ClusterError
from jobs.remote import fetching
from jobs.remote.fetching import fetch_results
from jobs.remote.status import Status


class Bucket:
    """A store with files of these names."""

    def __init__(self, *names: str) -> None:
        self._names = names

    def names(self) -> list[str]:
        return list(self._names)

    def read(self, name: str) -> bytes:
        return b"content"


def fetched(
    monkeypatch: pytest.MonkeyPatch, destination: Path, bucket: Bucket, experiment: str = "e", identity: str = "i"
) -> Path:
    """The folder that a finished job's results are copied to."""
    monkeypatch.setattr(fetching, "reached", lambda _: bucket)
    progress = {"experiment": experiment, "identity": identity, "results": "s3://bucket/results"}
    return fetch_results("http://127.0.0.1:9", Status("job", "done", "", 0, progress), destination)


@pytest.mark.parametrize("name", ["..", ".", "", "../../up", "/absolute", "a/b", "a\0b"])
def test_folders_are_names(name: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Neither the experiment nor its identity leads elsewhere."""
    for words in ({"experiment": name}, {"identity": name}):
        with pytest.raises(ClusterError, match="expected the name of a folder: nothing is fetched"):
            fetched(monkeypatch, tmp_path / "there", Bucket("runs.parquet"), **words)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", ["../outside", "figures/../../outside", "/outside", "figures//x"])
def test_files_are_below(name: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Nor does the name of a file in a store."""
    with pytest.raises(ClusterError):
        fetched(monkeypatch, tmp_path, Bucket(name))
    assert not (tmp_path / "outside").exists()


def test_files_are_copied(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """All that is no business of the job alone."""
    folder = fetched(monkeypatch, tmp_path, Bucket("runs.parquet", "parts/arm=A/0.parquet", "checkpoints/x"))
    assert sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()) == [
        "parts/arm=A/0.parquet",
        "runs.parquet",
    ]
