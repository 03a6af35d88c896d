"""The rows of shards as Arrow tables: columns, their types, and what joins them."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pyarrow as pa

from apel.run.selection import common_blocks
from apel.run.state import EpisodeRows
from cluster.protocols import RunRows
from cluster.shard import RunPlan, Shard
from jobs.results.labels import DamageError, check_columns, is_number

RUN_TYPES = {
    "experiment": pa.string(), "arm": pa.string(), "sweep": pa.string(), "run_index": pa.int64(), "seed": pa.int64(),
    "train_time": pa.int64(), "censored": pa.bool_(), "adaptation_time": pa.int64(), "steady_state": pa.float64(),
    "episodes": pa.int64(), "steps": pa.int64(),
}  # fmt: skip
"""The columns that every run has."""
_SUMMARY_TYPES = {
    "arm": pa.string(), "sweep": pa.string(), "runs": pa.int64(), "episodes": pa.int64(), "steps": pa.int64(),
}  # fmt: skip
_SUMMARY_MEASURES = {
    "mean_train_time": (
        "interval_low", "interval_high", "standard_deviation", "interquartile_mean", "median", "num_censored",
    ),
    **{
        f"mean_{name}": (f"{name}_low", f"{name}_high", f"{name}_standard_deviation")
        for name in ("adaptation_time", "steady_state", "last_tenth_return")
    },
    "median_last_tenth_return": ("mean_last_tenth_return",),
}  # fmt: skip
"""With each mean, the columns that go with it."""
RUN_KEY = ("arm", "sweep", "run_index")
LATE_RETURN = "last_tenth_return"
"""The column that runs of older versions lack."""
_TAKEN = frozenset({*RUN_TYPES, LATE_RETURN, "chosen"})
_INT64 = range(-(2**63), 2**63)
_MOST_NUMBERS = 64
"""Of an array that is written down in a cell."""


def run_table(shard: Shard, runs: RunRows) -> pa.Table:
    """One row per finished run of a shard."""
    plans = [shard.runs[position] for position in runs.position]
    has_criterion = shard.arm.criterion is not None
    afters = [_first_counted(shard, plan) for plan in plans]
    count = len(plans)
    columns: dict[str, Any] = {
        "experiment": pa.array([shard.arm.experiment] * count, pa.string()),
        "arm": pa.array([shard.arm.arm] * count, pa.string()),
        "sweep": pa.array([shard.arm.sweep] * count, pa.string()),
        "run_index": pa.array([plan.index for plan in plans], pa.int64()),
        "seed": pa.array([plan.seed for plan in plans], pa.int64()),
        "train_time": pa.array(runs.train_time if has_criterion else [None] * count, pa.int64()),
        "censored": pa.array(runs.censored if has_criterion else [None] * count, pa.bool_()),
        "adaptation_time": pa.array(
            [int(time) - after if after else None for time, after in zip(runs.train_time, afters, strict=True)],
            pa.int64(),
        ),
        "steady_state": pa.array(runs.steady_state, pa.float64(), from_pandas=True),
        "episodes": pa.array(runs.episodes, pa.int64()),
        "steps": pa.array(runs.steps, pa.int64()),
        LATE_RETURN: pa.array(runs.last_tenth_return, pa.float64(), from_pandas=True),
    }
    swept = shard.arm.sweep_values
    named = [{**plan.variables, **swept} for plan in plans]
    told = [_renamed(info, {*plan.variables, *swept}) for info, plan in zip(runs.info, plans, strict=True)]
    extras = [{**info, **own} for info, own in zip(told, named, strict=True)]
    for name in dict.fromkeys(name for extra in extras for name in extra if name not in columns):
        columns[name] = _column([_plain(extra.get(name)) for extra in extras])
    return pa.table(columns)


def _first_counted(shard: Shard, plan: RunPlan) -> int:
    """The episode from which on the criterion counts in a run."""
    after = shard.arm.criterion.of_run(plan.variables).after if shard.arm.criterion else 0
    return int(after)


def _renamed(info: Mapping[Any, Any], names: set[str]) -> dict[str, Any]:
    """What an environment says of itself, by names that are text and no column's, upper and lower case taken as one."""
    taken = {name.casefold() for name in (*_TAKEN, *names)}
    renamed = {}
    for key, value in info.items():
        name = _clean(str(key))
        while name.casefold() in taken:
            name = f"info_{name}"
        taken.add(name.casefold())
        renamed[name] = value
    return renamed


def _column(values: list[Any]) -> pa.Array:
    """A column of values of one type; of several types, or of none that Arrow has, as text."""
    try:
        return pa.array(values)
    except (pa.ArrowException, OverflowError):
        return _text(values)


def _text(values: list[Any]) -> pa.Array:
    return pa.array([v if v is None or isinstance(v, str) else json.dumps(v) for v in values], pa.string())


def _clean(text: str) -> str:
    """Text that UTF-8 can hold."""
    return text.encode(errors="backslashreplace").decode()


def check_summary(table: pa.Table) -> None:
    """Refuse a summary of an older version that has another form than that of the table of results.

    Raises
    ------
    DamageError
        The message says what it lacks.
    """
    check_columns(table, _SUMMARY_TYPES)
    names = set(table.column_names)
    for measure, others in _SUMMARY_MEASURES.items():
        missing = [name for name in others if name not in names]
        if measure in names and missing:
            message = f"found no column {', '.join(missing)}, expected those that go with {measure}"
            raise DamageError(message)
    for field in table.schema:
        if field.name not in _SUMMARY_TYPES and not is_number(field.type):
            message = f"column {field.name!r}: found {field.type}, expected numbers"
            raise DamageError(message)


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
    """A value as Parquet can hold it; composite ones as JSON, and whole numbers beyond 64 bits as text.

    >>> _plain(np.float32(0.5)), _plain([1, (2, None)]), _plain(2**64), _plain(np.zeros((9, 9)))
    (0.5, '[1, [2, null]]', '18446744073709551616', 'array of shape (9, 9)')
    """
    value = _json(value)
    if isinstance(value, str):
        return _clean(value)
    if isinstance(value, int) and value not in _INT64:
        return str(value)
    return json.dumps(value) if isinstance(value, list | dict) else value


def _json(value: Any) -> Any:
    """A value as JSON can hold it; of what it cannot, the type."""
    match value:
        case None | bool():
            return value
        # Of a subclass, such as an enumeration's member, what it stands for.
        case int():
            return int(value)
        case float():
            return float(value)
        case str():
            return str.__str__(value)
        case np.generic():
            return _json(value.item()) if not isinstance(value.item(), np.generic) else str(value)
        case np.ndarray():
            return _json(value.tolist()) if value.size <= _MOST_NUMBERS else f"array of shape {value.shape}"
        case list() | tuple():
            return [_json(child) for child in value]
        case set() | frozenset():
            return sorted((_json(child) for child in value), key=repr)
        case dict():
            return {str(key): _json(child) for key, child in value.items()}
    return f"{type(value).__module__}.{type(value).__qualname__}"


def episode_table(shard: Shard, rows: Sequence[EpisodeRows], finished: Any) -> pa.Table:
    """Rows sorted by run and episode; those of runs that are not ``finished`` (positions; None: all) are left out."""
    num_learners = len(shard.arm.learner_names)
    joined = _joined(rows, num_learners)
    order = np.lexsort((joined.episode, joined.run))
    if finished is not None:
        order = order[np.isin(joined.run[order], finished)]
    sorted_rows = EpisodeRows._make(column[order] for column in joined)
    index = np.array([run.index for run in shard.runs], dtype=np.int64)
    state = common_blocks(sorted_rows.header, num_learners)
    return pa.table(
        {
            "sweep": pa.array([shard.arm.sweep] * len(order), pa.string()),
            "run_index": pa.array(index[sorted_rows.run], pa.int64()),
            "episode": pa.array(sorted_rows.episode, pa.int64()),
            "selected": pa.array(sorted_rows.selected, pa.int64()),
            "return": pa.array(sorted_rows.episode_return, pa.float64()),
            "length": pa.array(sorted_rows.length, pa.int64()),
            "probability": _lists(state.probability),
            "performance_estimate": _lists(state.performance_estimate),
            "concentration": _lists(state.concentration),
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
