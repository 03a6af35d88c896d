"""The results of one experiment as a folder of Parquet files that pandas, polars and DuckDB open as they are.

``results/<experiment>/<identity>/``

    spec.yaml        the experiment, overrides included
    manifest.json    versions, seeds, and what each session of work took
    runs.parquet     one row per run
    summary.parquet  one row per arm and sweep point
    episodes/arm=…/  one row per recorded episode, one file per shard
    parts/           run rows per shard: what is stored here is done; runs.parquet is made from it
    checkpoints/     shards under way, with the rows that did not fit into memory in spilled/
    figures/         PNG and SVG
    report.html      all of it on one page
"""

from __future__ import annotations

import hashlib
import json
import socket
from collections.abc import Sequence
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from apel.book import EpisodeRows
from cluster.protocols import RunRows
from cluster.shard import Shard
from cluster.storage import Folder, joined, redacted
from cluster.storage_faults import StorageAwayError, StorageError
from jobs.plan import RunKey, arm_points
from jobs.spec import Experiment, validate
from jobs.tables import concatenated, episode_table, run_table
from jobs.yaml_source import parse

SPEC_FILE = "spec.yaml"
_FOLDERS = ("parts", "episodes", "checkpoints", "spilled", "figures")


class StoreError(Exception):
    """Results that cannot be read or written. The message says where and why."""


def shard_id(shard: Shard) -> str:
    """A file name for a shard: the same runs of the same arm and sweep point have the same."""
    indices = [run.index for run in shard.runs]
    parts = [f"{indices[0]:06d}-{indices[-1]:06d}"]
    if len(indices) != indices[-1] - indices[0] + 1:
        parts.append(hashlib.sha256(repr(indices).encode()).hexdigest()[:8])
    if shard.arm.sweep:
        parts.append(hashlib.sha256(shard.arm.sweep.encode()).hexdigest()[:8])
    return "-".join(parts)


class ResultStore:
    """The folder of one experiment."""

    def __init__(self, folder: Folder) -> None:
        self.folder = folder

    @classmethod
    def of(cls, experiment: Experiment, root: str) -> ResultStore:
        """Where the results of ``experiment`` belong below ``root``.

        Raises
        ------
        StoreError
            If that is no place that can be used.
        """
        return cls.at(joined(root, f"{experiment.name}/{experiment.identity}"))

    @classmethod
    def at(cls, location: str) -> ResultStore:
        """The results in a folder, by path or URI; see `of`."""
        try:
            return cls(Folder(location))
        except (OSError, ValueError, ImportError) as error:
            message = f"{redacted(location)}: found no place for results: {error}"
            raise StoreError(message) from error

    def open_for_writing(self, experiment: Experiment, *, fresh: bool) -> None:
        """Make the folder ready: forget everything if ``fresh``, and what an interrupted job left half-done.

        Raises
        ------
        StoreError
            If it cannot be written to.
        """
        try:
            if fresh:
                for name in _FOLDERS:
                    self.folder.delete_folder(name)
                for name in ("runs.parquet", "summary.parquet", "manifest.json", "report.html"):
                    self.folder.delete(name)
            self.folder.write(SPEC_FILE, experiment.to_yaml().encode())
            self._delete_temporary()
            self._delete_orphans()
        except StorageAwayError:
            raise  # no fault of the place that was named
        except OSError as error:
            message = f"found a results folder that cannot be written to: {error}"
            raise StoreError(message) from error

    def finished(self) -> set[RunKey]:
        """The runs whose rows are stored."""
        keys: set[RunKey] = set()
        for name in self.folder.names("parts"):
            table = self._read(f"parts/{name}", ["arm", "sweep", "run_index"])
            keys.update(zip(*(table[column].to_pylist() for column in table.column_names), strict=True))
        return keys

    def consolidate(self, experiment: Experiment) -> pa.Table:
        """Make ``runs.parquet`` from the parts, in the order of the arms and sweep points; returns its rows."""
        tables = [self._read(f"parts/{name}") for name in self.folder.names("parts")]
        if not tables:
            message = f"{self.folder.location()}: found no finished run"
            raise StoreError(message)
        order = [(arm, point.label) for point, arm in arm_points(experiment, None)]
        place = {key: position for position, key in enumerate(order)}
        table = concatenated(tables)
        keys = zip(table["arm"].to_pylist(), table["sweep"].to_pylist(), strict=True)
        table = table.append_column("position", pa.array([place[key] for key in keys]))
        table = table.sort_by([("position", "ascending"), ("run_index", "ascending")]).drop_columns(["position"])
        if experiment.hindsight:
            # With pandas, which no command should wait for that only reads an experiment file.
            from jobs.hindsight import with_hindsight

            table = with_hindsight(table, experiment.hindsight)
        self.write_table("runs.parquet", table)
        return table

    def runs(self) -> pa.Table:
        """The rows of ``runs.parquet``."""
        if not self.folder.exists("runs.parquet"):
            message = f"{self.folder.location()}: found no runs.parquet, expected the folder of a finished experiment"
            raise StoreError(message)
        return self._read("runs.parquet")

    def summary(self) -> pa.Table:
        """The rows of ``summary.parquet``."""
        self.runs()
        return self._read("summary.parquet")

    def experiment(self) -> Experiment:
        """The experiment whose results these are."""
        self.runs()
        return validate(parse(self.folder.read(SPEC_FILE).decode(), self.folder.location(SPEC_FILE)))

    def manifest(self) -> dict[str, Any]:
        """The manifest; empty before the first session of work."""
        if not self.folder.exists("manifest.json"):
            return {}
        manifest: dict[str, Any] = json.loads(self.folder.read("manifest.json"))
        return manifest

    def write_manifest(self, manifest: dict[str, Any]) -> None:
        """Replace the manifest."""
        self.folder.write("manifest.json", json.dumps(manifest, indent=2).encode())

    def write_table(self, name: str, table: pa.Table) -> None:
        """Write a Parquet file, whole or not at all."""
        _write(self.folder, name, table)

    def _read(self, name: str, columns: list[str] | None = None) -> pa.Table:
        try:
            return self.folder.read_with(name, lambda file: pq.ParquetFile(file).read(columns))
        except (OSError, pa.ArrowException) as error:
            message = f"{self.folder.location(name)}: found an unreadable file: {error}"
            raise StoreError(message) from error

    def _delete_temporary(self) -> None:
        """What processes that were killed were writing. Not in claims/: other jobs that are alive write there."""
        for name in self.folder.temporary_names():
            if not name.startswith("claims/"):
                self.folder.delete(name)

    def _delete_orphans(self) -> None:
        """Episode rows of shards that were never committed would be counted twice; a shard that was committed when its
        processes died has left its checkpoint.
        """
        committed = set(self.folder.names("parts"))
        for name in self.folder.names("episodes"):
            if name not in committed:
                self.folder.delete(f"episodes/{name}")
        under_way = set()
        for name in self.folder.names("checkpoints"):
            if f"{name.removesuffix('.npz')}.parquet" in committed:
                self.folder.delete(f"checkpoints/{name}")
            else:
                under_way.add(name.removesuffix(".npz"))
        for name in self.folder.names("spilled"):
            if name.rpartition("-")[0] not in under_way:
                self.folder.delete(f"spilled/{name}")


class ParquetSink:
    """Writes a shard's rows; a `cluster.coordinator.ResultSink`.

    The part is written last: it is what makes the shard done.
    """

    def __init__(self, folder: Folder) -> None:
        self._folder = folder

    def spill(self, shard: Shard, part: int, rows: Sequence[EpisodeRows]) -> None:
        """Put rows aside, so that memory stays flat."""
        _write(self._folder, _spilled(shard, part), episode_table(shard, rows, None))

    def commit(self, shard: Shard, runs: RunRows, num_parts: int, rows: Sequence[EpisodeRows]) -> None:
        """Store the rows of the finished runs of a shard."""
        if len(runs.position) == 0:
            return
        name = f"arm={shard.arm.arm}/{shard_id(shard)}.parquet"
        if shard.arm.recording != "none":
            last = episode_table(shard, rows, runs.position)
            finished = pa.array([shard.runs[position].index for position in runs.position])
            self._folder.write_with(
                f"episodes/{name}", lambda path: self._write_episodes(path, shard, num_parts, last, finished)
            )
        _write(self._folder, f"parts/{name}", run_table(shard, runs))
        for part in range(num_parts):
            self._folder.delete(_spilled(shard, part))

    def _write_episodes(self, path: str, shard: Shard, num_parts: int, last: pa.Table, finished: pa.Array) -> None:
        with pq.ParquetWriter(path, last.schema, filesystem=self._folder.filesystem) as writer:
            for part in range(num_parts):
                table = self._folder.read_with(_spilled(shard, part), lambda file: pq.ParquetFile(file).read())
                mask = pa.compute.is_in(table["run_index"], value_set=finished)
                writer.write_table(table.filter(mask))
            writer.write_table(last)


class CheckpointFiles:
    """One file per shard under way; a `cluster.coordinator.CheckpointStore`."""

    def __init__(self, folder: Folder) -> None:
        self._folder = folder

    def read(self, shard: Shard) -> bytes | None:
        """The last checkpoint, or None.

        Raises
        ------
        StorageError
            If this is not the place that the job's driver has opened: a node that does not share its disk.
        """
        if not self._folder.exists(SPEC_FILE):
            message = (
                f"{self._folder.location()}: found on the node {socket.gethostname()} nothing of what the job's driver "
                "has written there, expected a place that all nodes share: give --results a path on a shared disk, or "
                "a URI such as s3://bucket/results"
            )
            raise StorageError(message)
        name = self._name(shard)
        return self._folder.read(name) if self._folder.exists(name) else None

    def write(self, shard: Shard, content: bytes) -> None:
        """Replace it."""
        self._folder.write(self._name(shard), content)

    def delete(self, shard: Shard) -> None:
        """Forget it."""
        if shard.runs:
            self._folder.delete(self._name(shard))

    def _name(self, shard: Shard) -> str:
        return f"checkpoints/arm={shard.arm.arm}/{shard_id(shard)}.npz"


def _spilled(shard: Shard, part: int) -> str:
    return f"spilled/arm={shard.arm.arm}/{shard_id(shard)}-{part:04d}.parquet"


def _write(folder: Folder, name: str, table: pa.Table) -> None:
    folder.write_with(name, lambda path: pq.write_table(table, path, filesystem=folder.filesystem))
