"""Where the processes that play put what they have: rows, and checkpoints. All of it says whose it is."""

from __future__ import annotations

import hashlib
import re
import socket
from collections.abc import Sequence
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from apel.agents.content import AgentContent, pack_agent
from apel.numerics.state_trees import StateError
from apel.run.state import EpisodeRows
from cluster.checkpoint import CheckpointError, digest, seal
from cluster.protocols import RunRows
from cluster.shard import ArmPlan, RunPlan, Shard
from jobs.results.episodes import sweep_mark
from jobs.results.labels import DamageError, labelled, parse_table
from jobs.results.storage import Folder
from jobs.results.storage_faults import StorageError
from jobs.results.tables import episode_table, run_table

SPEC_FILE = "spec.yaml"
MODELS = "models"


def shard_id(shard: Shard) -> str:
    """A file name for a shard: the same runs of the same arm and sweep point have the same."""
    indices = [run.index for run in shard.runs]
    parts = f"{indices[0]:06d}-{indices[-1]:06d}"
    if len(indices) != indices[-1] - indices[0] + 1:
        parts += f"-{hashlib.sha256(repr(indices).encode()).hexdigest()[:8]}"
    return parts + sweep_mark(shard.arm.sweep)


def begun_runs(folder: Folder, arm: str, sweep: str) -> list[tuple[int, int]]:
    """First and last run of each shard that has left a checkpoint; of those alone that have all runs between."""
    name = re.compile(rf"(\d{{6}})-(\d{{6}}){sweep_mark(sweep)}\.npz")
    found = (name.fullmatch(one) for one in folder.names(f"checkpoints/arm={arm}"))
    return [(int(one[1]), int(one[2])) for one in found if one]


def model_name(arm: str, sweep: str, run: int, mark: str) -> str:
    """The file of what a run has come to at some mark."""
    return f"{MODELS}/arm={arm}/{run:06d}{sweep_mark(sweep)}-{mark}.npz"


def model_label(arm: ArmPlan, run: RunPlan, name: str) -> dict[str, str]:
    """What that file says of itself."""
    return {
        "identity": arm.identity,
        "arm": arm.arm,
        "sweep point": arm.sweep,
        "run": str(run.index),
        "seed": str(run.seed),
        "file": name,
    }


class ParquetSink:
    """Writes a shard's rows; a `cluster.coordinator.ResultSink`.

    The part is written last: it is what makes the shard done.
    """

    def __init__(self, folder: Folder) -> None:
        self._folder = folder

    def spill(self, shard: Shard, part: int, rows: Sequence[EpisodeRows]) -> str:
        """Put rows aside, so that memory stays flat."""
        content = pa.BufferOutputStream()
        pq.write_table(episode_table(shard, rows, None), content)
        stored = content.getvalue().to_pybytes()
        self._folder.write(_spilled(shard, part), stored)
        return digest(stored)

    def commit(self, shard: Shard, runs: RunRows, parts: Sequence[str], rows: Sequence[EpisodeRows]) -> None:
        """Store the rows of the finished runs of a shard."""
        if len(runs.position) == 0:
            return
        name = f"arm={shard.arm.arm}/{shard_id(shard)}.parquet"
        label = {**shard.binding, "file": name}
        if shard.arm.recording != "none":
            last = episode_table(shard, rows, runs.position)
            finished = pa.array([shard.runs[position].index for position in runs.position])
            label["episodes"] = self._write_episodes(f"episodes/{name}", shard, parts, last, finished)
        table = labelled(run_table(shard, runs), label)
        self._folder.write_with(
            f"parts/{name}", lambda path: pq.write_table(table, path, filesystem=self._folder.filesystem)
        )
        for part in range(len(parts)):
            self._folder.delete(_spilled(shard, part))

    def keep(self, shard: Shard, position: int, mark: str, model: AgentContent) -> None:
        """Store what a run has come to."""
        run = shard.runs[position]
        name = model_name(shard.arm.arm, shard.arm.sweep, run.index, mark)
        try:
            content = pack_agent(model)
        except StateError as error:
            raise CheckpointError(str(error)) from error
        self._folder.write(name, seal(content, model_label(shard.arm, run, name)))

    def _write_episodes(self, name: str, shard: Shard, parts: Sequence[str], last: pa.Table, finished: pa.Array) -> str:
        """Write all episodes of the finished runs; returns the file's checksum."""
        checksum = ""

        def write(path: str) -> None:
            nonlocal checksum
            with self._folder.filesystem.open_output_stream(path) as stream:
                summed = _Summed(stream)
                with pq.ParquetWriter(pa.PythonFile(summed, mode="w"), last.schema) as writer:
                    for part, expected in enumerate(parts):
                        table = self._put_aside(shard, part, expected)
                        writer.write_table(table.filter(pa.compute.is_in(table["run_index"], value_set=finished)))
                    writer.write_table(last)
                checksum = summed.total.hexdigest()

        self._folder.write_with(name, write)
        return checksum

    def _put_aside(self, shard: Shard, part: int, expected: str) -> pa.Table:
        name = _spilled(shard, part)
        try:
            content = self._folder.read(name)
            if digest(content) != expected:
                message = f"{name}: found a damaged file, or another one's"
                raise CheckpointError(message)
            return parse_table(content)
        except (FileNotFoundError, DamageError) as error:
            message = f"{name}: found {error}"
            raise CheckpointError(message) from error


class _Summed:
    """A stream for writing that keeps the checksum, `cluster.checkpoint.digest`'s, of all that went through it."""

    closed = False

    def __init__(self, stream: Any) -> None:
        self._stream = stream
        self.total = hashlib.blake2b(digest_size=20)

    def write(self, data: Any) -> int:
        self.total.update(data)
        return int(self._stream.write(data))

    def flush(self) -> None:
        self._stream.flush()

    def tell(self) -> int:
        return int(self._stream.tell())

    def close(self) -> None:
        """Left to whoever has opened it."""
        self.closed = True


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
