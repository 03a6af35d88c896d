"""The results of one experiment as a folder of Parquet files that pandas, polars and DuckDB open as they are.

``results/<experiment>/<identity>/``

    spec.yaml        the experiment, overrides included
    manifest.json    versions, seeds, and what each session of work took
    runs.parquet     one row per run
    summary.parquet  one row per arm and sweep point
    episodes/arm=…/  one row per recorded episode, one file per shard
    parts/           run rows per shard: what is stored here is done; runs.parquet is made from it
    models/arm=…/    what runs have come to, where the experiment keeps that (`models`): an agent each
    checkpoints/     shards under way, with the rows that did not fit into memory in spilled/
    damaged/         what was found in place of those, and was not what it should be
    claims/          whose these results are at the moment: leases (`jobs.results.lease`)
    failures/        of the last session: the whole traceback of each distinct error, and which runs failed
    figures/         PNG and SVG
    report.html      all of it on one page

Every file that is read back says whose it is, and carries a checksum: Parquet files in their metadata
(`jobs.results.labels`), checkpoints at their end, ``spec.yaml`` in its last line, the manifest in a field, and the
episodes of a shard in the label of its run rows. What older versions wrote has none, and is taken as it is.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from cluster.checkpoint import digest
from jobs.experiment.plan import Plan, RunKey
from jobs.experiment.spec import Experiment, validate
from jobs.experiment.yaml_source import SpecError, parse
from jobs.results.caps import counted_with_cap, has_censored
from jobs.results.failures import FAILURES
from jobs.results.labels import DamageError, check_columns, content_digest, expect, label_of, labelled, parse_table
from jobs.results.lease import LEASES
from jobs.results.manifest import checked_manifest, new_manifest, sealed_manifest
from jobs.results.places import check_place, joined, redacted
from jobs.results.sinks import MODELS, SPEC_FILE, CheckpointFiles, ParquetSink
from jobs.results.stock import check_once, check_seeds, put_away, take_stock
from jobs.results.storage import Folder, reached
from jobs.results.storage_faults import StorageAwayError, StoreError
from jobs.results.tables import RUN_KEY, RUN_TYPES, check_summary, concatenated

__all__ = ["CheckpointFiles", "ParquetSink", "ResultStore", "StoreError"]

_FOLDERS = ("parts", "episodes", MODELS, "checkpoints", "spilled", "damaged", "figures", "tensorboard", FAILURES)
_FILES = ("runs.parquet", "summary.parquet", "manifest.json", "report.html")
_SEAL = "# checksum: "


def _silent(_: str) -> None:
    """Nobody is told."""


class ResultStore:
    """The folder of one experiment; ``say`` is told what was not as it should be, and could be done without."""

    def __init__(self, folder: Folder, say: Callable[[str], None] = _silent) -> None:
        self.folder = folder
        self.say = say
        self._said: set[str] = set()

    @classmethod
    def of(cls, experiment: Experiment, root: str) -> ResultStore:
        """Where the results of ``experiment`` belong below ``root``.

        Raises
        ------
        StoreError
            If that is no place that can be used.
        """
        try:
            check_place(root)
        except ValueError as error:
            message = f"--results: {error}"
            raise StoreError(message) from error
        return cls.at(joined(root, f"{experiment.name}/{experiment.identity}"))

    @classmethod
    def at(cls, location: str, say: Callable[[str], None] = _silent) -> ResultStore:
        """The results in a folder, by path or URI; see `of`."""
        try:
            return cls(reached(location), say)
        except StorageAwayError:
            raise  # no fault of the place that was named
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
                for name in _FILES:
                    self.folder.delete(name)
            self._refuse_folders()
            text = experiment.to_yaml()
            self.folder.write(SPEC_FILE, f"{text}{_SEAL}{digest(text.encode())}\n".encode())
            self._delete_temporary()
            self._delete_orphans()
            self._renew_manifest(experiment)
        except StorageAwayError:
            raise  # no fault of the place that was named
        except OSError as error:
            message = f"found a results folder that cannot be written to: {error}"
            raise StoreError(message) from error

    def finished(self, plan: Plan) -> set[RunKey]:
        """The runs whose rows are stored, and are this plan's; what lies there instead is put away, with a word."""
        stock = take_stock(self.folder, plan, with_episodes=True)
        put_away(self.folder, stock, self.say)
        return stock.keys

    def consolidate(self, plan: Plan) -> pa.Table:
        """Make ``runs.parquet`` from the parts, in the order of the plan, which has all arms; returns its rows."""
        stock = take_stock(self.folder, plan, with_episodes=False)
        for name, reason in stock.unfit.items():
            message = f"{self.folder.location(f'parts/{name}')}: {reason}: the same command plays those runs again"
            raise StoreError(message)
        if not stock.fit:
            message = f"{self.folder.location()}: found no finished run"
            raise StoreError(message)
        table = concatenated([part.replace_schema_metadata(None) for part in stock.fit.values()])
        place = {(one.arm, one.point.label): position for position, one in enumerate(plan.arm_points)}
        keys = zip(*(table[name].to_pylist() for name in ("arm", "sweep", "run_index")), strict=True)
        order = [(place[arm, sweep], index) for arm, sweep, index in keys]
        table = table.take(sorted(range(len(order)), key=order.__getitem__))
        if plan.experiment.hindsight:
            # With pandas, which no command should wait for that only reads an experiment file.
            from jobs.results.hindsight import with_hindsight

            table = with_hindsight(table, plan.experiment.hindsight)
        self._write_labelled("runs.parquet", table, identity=plan.experiment.identity)
        return table

    def runs(self) -> pa.Table:
        """The rows of ``runs.parquet``.

        Raises
        ------
        StoreError
            If there is no such file, or one that is damaged, another experiment's, or has a run twice.
        """
        if not self.folder.exists("runs.parquet"):
            message = f"{self.folder.location()}: found no runs.parquet, expected the folder of a finished experiment"
            raise StoreError(message)
        manifest = self.manifest()
        with self._told("runs.parquet"):
            table, label = self._read("runs.parquet")
            present = set(table.column_names) | set(RUN_KEY)
            check_columns(table, {name: kind for name, kind in RUN_TYPES.items() if name in present})
            if manifest:
                if label is not None:
                    expect(label, identity=manifest["identity"])
                if "seed" in manifest and "seed" in present:
                    check_seeds(table, manifest["seed"])
            check_once(table)
        return table

    def counted_runs(self) -> pa.Table:
        """The rows of `runs` as means and pictures take them; see `jobs.results.caps.counted_with_cap`.

        Where the experiment cannot be read its caps are not known, and the rows stay as they are.
        """
        runs = self.runs()
        if not has_censored(runs):
            return runs
        try:
            return counted_with_cap(runs, self.experiment())
        except (StoreError, SpecError):
            self._note(SPEC_FILE, "found no experiment that can be read: if steps ended runs, times may be too short")
            return runs

    def summary(self) -> pa.Table:
        """The rows of ``summary.parquet``.

        Raises
        ------
        StoreError
            If they are not those of ``runs.parquet``; the caller can make them anew from it.
        """
        runs = self.counted_runs()
        with self._told("summary.parquet"):
            table, label = self._read("summary.parquet")
            if label is None:
                check_summary(table)
            else:
                expect(label, runs=content_digest(runs))
        return table

    def write_summary(self, summary: pa.Table, runs: pa.Table) -> None:
        """Replace ``summary.parquet``, which was made from these runs, counted as in `counted_runs`."""
        self._write_labelled("summary.parquet", summary, runs=content_digest(runs))

    def experiment(self) -> Experiment:
        """The experiment whose results these are."""
        self.runs()
        with self._told(SPEC_FILE):
            text = self.folder.read(SPEC_FILE).decode()
        content, mark, checksum = text.rpartition(_SEAL)
        if mark and checksum.strip() != digest(content.encode()):
            self._note(SPEC_FILE, "found another text than this program wrote there: it was changed since")
        return validate(parse(text, self.folder.location(SPEC_FILE)))

    def manifest(self) -> dict[str, Any]:
        """The manifest; empty before the first session of work, and where it is damaged."""
        if not self.folder.exists("manifest.json"):
            return {}
        try:
            return checked_manifest(self.folder.read("manifest.json"))
        except (ValueError, OSError) as error:
            self._note("manifest.json", f"{error}: going on without what it says")
            return {}

    def write_manifest(self, manifest: dict[str, Any]) -> None:
        """Replace the manifest."""
        self.folder.write("manifest.json", json.dumps(sealed_manifest(manifest), indent=2).encode())

    def _note(self, name: str, what: str) -> None:
        message = f"{self.folder.location(name)}: {what}"
        if message not in self._said:
            self._said.add(message)
            self.say(message)

    def write_table(self, name: str, table: pa.Table) -> None:
        """Write a Parquet file, whole or not at all."""
        self.folder.write_with(name, lambda path: pq.write_table(table, path, filesystem=self.folder.filesystem))

    def _write_labelled(self, name: str, table: pa.Table, **label: str) -> None:
        self.write_table(name, labelled(table, {"file": name, **label}))

    def _read(self, name: str) -> tuple[pa.Table, dict[str, str] | None]:
        table = parse_table(self.folder.read(name))
        label = label_of(table)
        if label is not None:
            expect(label, file=name)
        return table.replace_schema_metadata(None), label

    @contextmanager
    def _told(self, name: str) -> Iterator[None]:
        """What is wrong with a file, as one clear error."""
        try:
            yield
        except (DamageError, OSError, UnicodeDecodeError) as error:
            remedy = "`apel run` of its experiment file makes it again"
            message = f"{self.folder.location(name)}: {error}: {remedy}"
            raise StoreError(message) from error

    def _refuse_folders(self) -> None:
        """A folder where a file has to be would be found when a shard is over, and its rows could not be stored."""
        for name in self.folder.folder_names():
            if name in (*_FILES, SPEC_FILE) or name.endswith((".parquet", ".npz", ".png", ".svg", ".csv")):
                message = f"{self.folder.location(name)}: found a folder, expected a file: move it away"
                raise StoreError(message)

    def _renew_manifest(self, experiment: Experiment) -> None:
        """Put one away that is damaged, or another experiment's."""
        if not self.folder.exists("manifest.json"):
            return
        found = self.manifest()
        if found.get("identity") != experiment.identity:
            self.folder.move("manifest.json", "damaged/manifest.json")
            self.write_manifest(new_manifest(experiment))
            if found:
                self._note("manifest.json", f"found the identity {found['identity']!r}: put into damaged/")

    def _delete_temporary(self) -> None:
        """What processes that were killed were writing. Not of leases: other jobs that are alive write there."""
        for name in self.folder.temporary_names():
            if not name.startswith(f"{LEASES}/"):
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
