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
from collections.abc import Sequence
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from apel.book import EpisodeRows
from cluster.coordinator import RunRows
from cluster.shard import Shard
from cluster.storage import Folder
from jobs.hindsight import with_hindsight
from jobs.plan import RunKey, arm_points
from jobs.spec import Experiment, validate
from jobs.yaml_source import parse

_RUN_COLUMNS = (
    "experiment", "arm", "sweep", "run_index", "seed", "train_time", "censored", "adaptation_time", "steady_state",
    "episodes", "steps",
)  # fmt: skip


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
        return cls.at(f"{root.rstrip('/')}/{experiment.name}/{experiment.identity}")

    @classmethod
    def at(cls, location: str) -> ResultStore:
        """The results in a folder, by path or URI; see `of`."""
        try:
            return cls(Folder(location))
        except (OSError, ValueError, ImportError) as error:
            message = f"{location}: found no place for results: {error}"
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
                for name in ("parts", "episodes", "checkpoints", "spilled", "figures"):
                    self.folder.delete_folder(name)
                for name in ("runs.parquet", "summary.parquet", "manifest.json", "report.html"):
                    self.folder.delete(name)
            self.folder.write("spec.yaml", experiment.to_yaml().encode())
            self._delete_orphans()
        except OSError as error:
            message = f"{self.folder.location()}: found a results folder that cannot be written to: {error}"
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
        table = _concatenated(tables)
        keys = zip(table["arm"].to_pylist(), table["sweep"].to_pylist(), strict=True)
        table = table.append_column("position", pa.array([place[key] for key in keys]))
        table = table.sort_by([("position", "ascending"), ("run_index", "ascending")]).drop_columns(["position"])
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
        return validate(parse(self.folder.read("spec.yaml").decode(), self.folder.location("spec.yaml")))

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
            with self.folder.filesystem.open_input_file(self.folder.path(name)) as file:
                return pq.ParquetFile(file).read(columns)
        except (OSError, pa.ArrowException) as error:
            message = f"{self.folder.location(name)}: found an unreadable file: {error}"
            raise StoreError(message) from error

    def _delete_orphans(self) -> None:
        """Episode rows of shards that were never committed would be counted twice."""
        committed = set(self.folder.names("parts"))
        for name in self.folder.names("episodes"):
            if name not in committed:
                self.folder.delete(f"episodes/{name}")
        under_way = {name.removesuffix(".npz") for name in self.folder.names("checkpoints")}
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
        _write(self._folder, _spilled(shard, part), _episode_table(shard, rows, None))

    def commit(self, shard: Shard, runs: RunRows, num_parts: int, rows: Sequence[EpisodeRows]) -> None:
        """Store the rows of the finished runs of a shard."""
        if len(runs.position) == 0:
            return
        name = f"arm={shard.arm.arm}/{shard_id(shard)}.parquet"
        if shard.arm.recording != "none":
            last = _episode_table(shard, rows, runs.position)
            finished = pa.array([shard.runs[position].index for position in runs.position])
            self._folder.write_with(
                f"episodes/{name}", lambda path: self._write_episodes(path, shard, num_parts, last, finished)
            )
        _write(self._folder, f"parts/{name}", _run_table(shard, runs))
        for part in range(num_parts):
            self._folder.delete(_spilled(shard, part))

    def _write_episodes(self, path: str, shard: Shard, num_parts: int, last: pa.Table, finished: pa.Array) -> None:
        with pq.ParquetWriter(path, last.schema, filesystem=self._folder.filesystem) as writer:
            for part in range(num_parts):
                with self._folder.filesystem.open_input_file(self._folder.path(_spilled(shard, part))) as file:
                    table = pq.ParquetFile(file).read()
                mask = pa.compute.is_in(table["run_index"], value_set=finished)
                writer.write_table(table.filter(mask))
            writer.write_table(last)


class CheckpointFiles:
    """One file per shard under way; a `cluster.coordinator.CheckpointStore`."""

    def __init__(self, folder: Folder) -> None:
        self._folder = folder

    def read(self, shard: Shard) -> bytes | None:
        """The last checkpoint, or None."""
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


def _run_table(shard: Shard, runs: RunRows) -> pa.Table:
    plans = [shard.runs[position] for position in runs.position]
    has_criterion = shard.arm.criterion is not None
    after = shard.arm.criterion.after if shard.arm.criterion else 0
    count = len(plans)
    columns: dict[str, Any] = {
        "experiment": pa.array([shard.arm.experiment] * count, pa.string()),
        "arm": pa.array([shard.arm.arm] * count, pa.string()),
        "sweep": pa.array([shard.arm.sweep] * count, pa.string()),
        "run_index": pa.array([plan.index for plan in plans], pa.int64()),
        "seed": pa.array([plan.seed for plan in plans], pa.int64()),
        "train_time": pa.array(runs.train_time if has_criterion else [None] * count, pa.int64()),
        "censored": pa.array(runs.censored if has_criterion else [None] * count, pa.bool_()),
        "adaptation_time": pa.array(runs.train_time - after if after else [None] * count, pa.int64()),
        "steady_state": pa.array(runs.steady_state, pa.float64(), from_pandas=True),
        "episodes": pa.array(runs.episodes, pa.int64()),
        "steps": pa.array(runs.steps, pa.int64()),
    }
    swept = shard.arm.sweep_values
    extras = [{**info, **plan.variables, **swept} for info, plan in zip(runs.info, plans, strict=True)]
    for name in dict.fromkeys(name for extra in extras for name in extra if name not in _RUN_COLUMNS):
        columns[name] = _column([_plain(extra.get(name)) for extra in extras])
    return pa.table(columns)


def _column(values: list[Any]) -> pa.Array:
    """A column of values of one type; of several types as text."""
    try:
        return pa.array(values)
    except pa.ArrowException:
        return _text(values)


def _text(values: list[Any]) -> pa.Array:
    return pa.array([v if v is None or isinstance(v, str) else json.dumps(v) for v in values], pa.string())


def _concatenated(tables: Sequence[pa.Table]) -> pa.Table:
    """All rows; a variable or an axis whose values are of several types is text in all of them."""
    types: dict[str, set[pa.DataType]] = {}
    for table in tables:
        for field in table.schema:
            types.setdefault(field.name, set()).add(field.type)
    mixed = {name for name, found in types.items() if not _is_one_kind(found - {pa.null()})}
    for name in mixed:
        tables = [
            table.set_column(table.column_names.index(name), name, _text(table[name].to_pylist()))
            if name in table.column_names
            else table
            for table in tables
        ]
    return pa.concat_tables(tables, promote_options="permissive")


def _is_one_kind(types: set[pa.DataType]) -> bool:
    return len(types) < 2 or all(pa.types.is_integer(one) or pa.types.is_floating(one) for one in types)


def _plain(value: Any) -> Any:
    """A variable's value as Parquet can hold it; composite ones as JSON."""
    return value if value is None or isinstance(value, bool | int | float | str) else json.dumps(value)


def _episode_table(shard: Shard, rows: Sequence[EpisodeRows], finished: Any) -> pa.Table:
    """Rows sorted by run and episode; those of runs that are not ``finished`` (positions; None: all) are left out."""
    num_learners = len(shard.arm.learner_names)
    joined = _joined(rows, num_learners)
    order = np.lexsort((joined.episode, joined.run))
    if finished is not None:
        order = order[np.isin(joined.run[order], finished)]
    sorted_rows = EpisodeRows._make(column[order] for column in joined)
    index = np.array([run.index for run in shard.runs], dtype=np.int64)
    header = sorted_rows.header.reshape(-1, 3, num_learners)
    return pa.table(
        {
            "sweep": pa.array([shard.arm.sweep] * len(order), pa.string()),
            "run_index": pa.array(index[sorted_rows.run], pa.int64()),
            "episode": pa.array(sorted_rows.episode, pa.int64()),
            "selected": pa.array(sorted_rows.selected, pa.int64()),
            "return": pa.array(sorted_rows.episode_return, pa.float64()),
            "length": pa.array(sorted_rows.length, pa.int64()),
            "probability": _lists(header[:, 0]),
            "performance_estimate": _lists(header[:, 1]),
            "concentration": _lists(header[:, 2]),
        }
    )


def _joined(rows: Sequence[EpisodeRows], num_learners: int) -> EpisodeRows:
    if not rows:
        return EpisodeRows.empty(0, num_learners)
    return EpisodeRows._make(np.concatenate(columns) for columns in zip(*rows, strict=True))


def _lists(values: Any) -> pa.Array:
    """``float64[rows, learners]`` as lists; NaN becomes null."""
    offsets = np.arange(len(values) + 1, dtype=np.int32) * values.shape[1]
    return pa.ListArray.from_arrays(pa.array(offsets), pa.array(values.ravel(), pa.float64(), from_pandas=True))
