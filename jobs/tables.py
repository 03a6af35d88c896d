"""The rows of shards as Arrow tables: columns, their types, and what joins them."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

import numpy as np
import pyarrow as pa

from apel.book import EpisodeRows
from cluster.protocols import RunRows
from cluster.shard import Shard

_RUN_COLUMNS = (
    "experiment", "arm", "sweep", "run_index", "seed", "train_time", "censored", "adaptation_time", "steady_state",
    "episodes", "steps",
)  # fmt: skip


def run_table(shard: Shard, runs: RunRows) -> pa.Table:
    """One row per finished run of a shard."""
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


def concatenated(tables: Sequence[pa.Table]) -> pa.Table:
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


def episode_table(shard: Shard, rows: Sequence[EpisodeRows], finished: Any) -> pa.Table:
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
