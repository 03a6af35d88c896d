"""Recorded episodes as they are stored: one file per shard, whose checksum stands with the shard's run rows."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Sequence

import pyarrow as pa
import pyarrow.compute as pc

from cluster.checkpoint import digest
from jobs.results.labels import DamageError, check_columns, label_of, parse_table
from jobs.results.storage import Folder
from jobs.results.storage_faults import StoreError

_LISTS = pa.list_(pa.float64())
COLUMNS = {
    "sweep": pa.string(), "run_index": pa.int64(), "episode": pa.int64(), "selected": pa.int64(),
    "return": pa.float64(), "length": pa.int64(), "probability": _LISTS, "performance_estimate": _LISTS,
    "concentration": _LISTS,
}  # fmt: skip
_KEY = ["sweep", "run_index", "episode"]


def sweep_mark(sweep: str) -> str:
    """How the names of the files of a sweep point end; empty where nothing is swept."""
    return f"-{hashlib.sha256(sweep.encode()).hexdigest()[:8]}" if sweep else ""


def read_episodes(
    folder: Folder, arm: str, columns: Sequence[str], sweep: str | None = None, *, is_verified: bool = True
) -> pa.Table | None:
    """Recorded episodes of an arm, at one sweep point or at all, with some columns; None where none was recorded.

    The files' checksums are verified, unless the caller has a better way to see what is true.

    Raises
    ------
    StoreError
        If a file is damaged or another one's, or an episode is there twice.
    """
    tables = list(_tables(folder, arm, list(dict.fromkeys((*_KEY, *columns))), sweep, is_verified))
    if not tables:
        return None
    try:
        table = pa.concat_tables(tables)
    except pa.ArrowException as error:
        message = f"{folder.location(f'episodes/arm={arm}')}: found files of several forms ({error}), expected one"
        raise StoreError(message) from error
    for name in columns:
        if pa.types.is_list(table.schema.field(name).type) and len(pc.list_value_length(table[name]).unique()) > 1:
            message = f"{folder.location(f'episodes/arm={arm}')}: column {name!r}: found lists of several lengths"
            raise StoreError(message)
    count = table.group_by(_KEY, use_threads=False).aggregate([([], "count_all")])["count_all"]
    if len(count) < len(table):
        place = folder.location(f"episodes/arm={arm}")
        message = f"{place}: found {len(table) - len(count)} episodes twice, expected every one once"
        raise StoreError(message)
    return table.select(list(dict.fromkeys(columns)))


def _tables(folder: Folder, arm: str, columns: list[str], sweep: str | None, is_verified: bool) -> Iterator[pa.Table]:
    place = f"episodes/arm={arm}"
    for name in folder.names(place):
        if not name.removesuffix(".parquet").endswith(sweep_mark(sweep or "")):
            continue
        try:
            content = folder.read(f"{place}/{name}")
            if is_verified:
                check_episodes(content, recorded_digest(folder, f"arm={arm}/{name}"))
            table = parse_table(content, columns).replace_schema_metadata(None)
            check_columns(table, {column: COLUMNS[column] for column in columns})
        except (DamageError, OSError) as error:
            message = f"{folder.location(f'{place}/{name}')}: {error}: `apel run` of its spec.yaml plays that again"
            raise StoreError(message) from error
        is_wanted = pc.equal(table["sweep"], sweep) if sweep is not None else None
        yield table if is_wanted is None else table.filter(is_wanted)


def recorded_digest(folder: Folder, name: str) -> str:
    """The checksum of a shard's file of episodes, as its run rows have it; empty where they are not there, or older."""
    if not folder.exists(f"parts/{name}"):
        return ""
    label = label_of(parse_table(folder.read(f"parts/{name}")))
    return label.get("episodes", "") if label else ""


def check_episodes(content: bytes, checksum: str) -> None:
    """Refuse a file of episodes that has another checksum than it should; an empty one says nothing.

    Raises
    ------
    DamageError
        If that is so.
    """
    if checksum and digest(content) != checksum:
        message = "found a damaged file, whose checksum is not that of its content"
        raise DamageError(message)
