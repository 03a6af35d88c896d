"""Run rows hold whatever an environment says of itself, under names of their own."""

from __future__ import annotations

import enum
import io
import subprocess
import sys
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given
from hypothesis import strategies as st

from apel.configs import EnvironmentConfig, LearnerConfig, SelectorConfig
from apel.run.criterion import Criterion
from cluster.protocols import RunRows
from cluster.shard import ArmPlan, RunPlan, Shard
from jobs.results.labels import DamageError, content_digest, label_of, labelled, parse_table
from jobs.results.tables import RUN_TYPES, concatenated, run_table


def table_of(*infos: dict[Any, Any], variables: dict[str, Any] | None = None) -> pa.Table:
    """The rows of one run for each of what environments say of themselves."""
    count = len(infos)
    runs = tuple(
        RunPlan(i, 100 + i, EnvironmentConfig("x"), (LearnerConfig("q_learning"),), variables or {})
        for i in range(count)
    )
    whole, real = np.arange(count), np.full(count, 0.5)
    rows = RunRows(whole, whole, whole > 0, whole, whole, real, real, infos)
    arm = ArmPlan("small", "A", "", ("Q",), SelectorConfig("fixed"), "return", 5)
    return run_table(Shard(arm, runs), rows)


def test_adaptation_times_count_from_each_runs_own_switch() -> None:
    """Trained after 30 and 40 episodes, with switches drawn at 13 and 25: 17 and 15; where all count there is none."""
    learners = (LearnerConfig("q_learning"),)
    runs = tuple(RunPlan(i, 9, EnvironmentConfig("x"), learners, {"switch": at}) for i, at in enumerate((13, 25)))
    whole, real, times = np.arange(2), np.full(2, 0.5), np.array([30, 40])
    rows = RunRows(whole, times, whole > 0, times, times, real, real, ({}, {}))
    for after, expected in (("$switch", [17, 15]), (10, [20, 30]), (0, [None, None])):
        criterion = Criterion("length", 5, below=9.0, after=after)
        arm = ArmPlan("small", "A", "", ("Q",), SelectorConfig("fixed"), "return", 50, criterion=criterion)
        assert run_table(Shard(arm, runs), rows)["adaptation_time"].to_pylist() == expected


def through_parquet(table: pa.Table) -> pa.Table:
    """Written and read."""
    file = io.BytesIO()
    pq.write_table(table, file)
    return pq.ParquetFile(file).read()


THREADS = """
import io, pathlib
import pyarrow as pa, pyarrow.parquet as pq
from jobs.results.labels import parse_table
from jobs.results.stock import check_once
names = lambda: sorted(task.joinpath("comm").read_text() for task in pathlib.Path("/proc/self/task").iterdir())
file = io.BytesIO()
pq.write_table(pa.table(dict.fromkeys(("arm", "sweep", "run_index"), range(5))), file)
before = names()
{reading}
print(names() == before)
"""


@pytest.mark.skipif(not Path("/proc/self/task").is_dir(), reason="threads are counted in /proc")
@pytest.mark.parametrize(
    ("reading", "expected"),
    [
        ("check_once(parse_table(file.getvalue()))", "True"),
        ("pq.ParquetFile(pa.BufferReader(file.getvalue())).read()", "False"),  # so that the count can fail
    ],
)
def test_results_are_read_in_the_thread_that_asks(reading: str, expected: str) -> None:
    """One of Arrow's would hold their bytes for a moment more, and abort a process that ends in it."""
    program = THREADS.format(reading=reading)
    said = subprocess.run([sys.executable, "-c", program], check=True, capture_output=True, text=True)
    assert said.stdout == f"{expected}\n"


class Colour(enum.StrEnum):
    """As an environment may use it."""

    RED = "red"


CELLS: dict[str, tuple[Any, Any]] = {
    "number": (7, 7),
    "NumPy's": (np.float32(0.5), 0.5),
    "beyond 64 bits": (2**64, str(2**64)),
    "far below": (-(10**30), str(-(10**30))),
    "text": ("easy", "easy"),
    "lone surrogate": ("\ud800", "\\ud800"),
    "enumeration": (Colour.RED, "red"),
    "array": (np.arange(3), "[0, 1, 2]"),
    "picture": (np.zeros((84, 84, 3)), "array of shape (84, 84, 3)"),
    "mapping": ({1: (2, {"a": None})}, '{"1": [2, {"a": null}]}'),
    "set": ({2, 1}, "[1, 2]"),
    "bytes": (b"x", "builtins.bytes"),
    "object": (object(), "builtins.object"),
    "nothing": (None, None),
}


@pytest.mark.parametrize("kind", CELLS)
def test_any_value(kind: str) -> None:
    """Whatever it is, it has one text or number that says it, and the row is there."""
    value, expected = CELLS[kind]
    table = through_parquet(table_of({"said": value}))
    assert table["said"].to_pylist() == [expected]


def test_values_of_several_types() -> None:
    """In a column they are text, within a shard as between two."""
    assert table_of({"x": 1}, {"x": "a"}, {"x": 2**70})["x"].to_pylist() == ["1", "a", str(2**70)]
    joined = concatenated([table_of({"x": 1}), table_of({"x": 2**70}), table_of({})])
    assert joined["x"].to_pylist() == ["1", str(2**70), None]


def test_names_that_are_taken() -> None:
    """A key that is a column's, a variable's, or another key's but for its type or its case gets a prefix."""
    info = {"seed": 1, "Steps": 2, "chosen": 3, "dropped": 4, 5: 6, "5": 7, "info_seed": 8, "free": 9}
    table = through_parquet(table_of(info, variables={"dropped": "x"}))
    assert table.column_names[len(RUN_TYPES) + 1 :] == [
        "info_seed", "info_Steps", "info_chosen", "info_dropped", "5", "info_5", "info_info_seed", "free", "dropped",
    ]  # fmt: skip
    (row,) = table.to_pylist()
    assert (row["seed"], row["steps"], row["dropped"]) == (100, 0, "x")
    assert (row["info_seed"], row["info_Steps"], row["info_dropped"], row["info_info_seed"]) == (1, 2, 4, 8)


VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(st.characters()) | st.binary() | st.dates(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text() | st.integers(), inner, max_size=3),
    max_leaves=5,
)
INFOS = st.dictionaries(st.sampled_from(["seed", "arm", "a", "A", 1, None, "", "1"]) | st.text(), VALUES, max_size=5)


@given(st.lists(st.lists(INFOS, min_size=1, max_size=3), min_size=1, max_size=3))
def test_no_row_is_lost(shards: list[list[dict[Any, Any]]]) -> None:
    """Whatever environments say: rows can be written, read, joined and labelled, their own columns as they were."""
    tables = [through_parquet(labelled(table_of(*infos), {"arm": "A"})) for infos in shards]
    assert [label_of(table) for table in tables] == [{"arm": "A"}] * len(tables)
    joined = through_parquet(concatenated([table.replace_schema_metadata(None) for table in tables]))
    assert joined["seed"].to_pylist() == [100 + i for infos in shards for i in range(len(infos))]
    assert joined["experiment"].to_pylist() == ["small"] * len(joined)
    assert len(set(joined.column_names)) == len(joined.column_names)
    assert content_digest(joined) == content_digest(through_parquet(joined))


@pytest.mark.parametrize("first", [0, 5])
def test_flipped_bits_of_a_labelled_file(first: int) -> None:
    """Wherever a bit is flipped, that is seen, or what is read is the same; text that is no UTF-8 included."""
    table = table_of({"a": "text", "b": 1.5}, {"a": "more", "c": None}, variables={"dropped": "distractor"})
    file = io.BytesIO()
    pq.write_table(labelled(table, {"arm": "A"}), file)
    whole = file.getvalue()
    for bit in range(first, 8 * len(whole), 29):
        flipped = bytearray(whole)
        flipped[bit // 8] ^= 1 << bit % 8
        with suppress(DamageError):
            found = parse_table(bytes(flipped))
            assert label_of(found) in ({"arm": "A"}, None)
            assert content_digest(found) == content_digest(table)
