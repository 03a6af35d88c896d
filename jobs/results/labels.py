"""What a stored table says of itself, in the metadata of its file: whose it is, and the checksum of what it holds.

The checksum is that of names, types and values, so that it holds whatever way a library has of writing them down.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping
from typing import Any

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from cluster.checkpoint import digest

_KEY = b"apel"
OPTIONAL = frozenset({"train_time", "censored", "adaptation_time", "steady_state"})
"""Columns of the run rows that are unknown of some runs."""


class DamageError(Exception):
    """A stored file that is not what it should be. The message says what was found, and what was expected."""


def content_digest(table: pa.Table) -> str:
    """The checksum of a table's names, types and values."""
    return digest(*_content(table))


def labelled(table: pa.Table, label: Mapping[str, str]) -> pa.Table:
    """The table with a label; it takes the place of all other metadata.

    >>> table = labelled(pa.table({"run_index": [0, 1]}), {"arm": "APEL"})
    >>> label_of(table)
    {'arm': 'APEL'}
    """
    said = json.dumps(dict(label), sort_keys=True)
    content = json.dumps({"digest": digest(*_content(table), said.encode()), "label": said})
    return table.replace_schema_metadata({_KEY: content.encode()})


def label_of(table: pa.Table) -> dict[str, str] | None:
    """What the table says of itself; None of one without a label, such as older versions wrote.

    Raises
    ------
    DamageError
        If its checksum is not that of what it holds.
    """
    metadata = table.schema.metadata or {}
    if _KEY not in metadata:
        return None
    try:
        found = json.loads(metadata[_KEY])
        said, checksum = str(found["label"]), found["digest"]
    except (ValueError, TypeError, KeyError):
        said, checksum = "", None
    if checksum != digest(*_content(table), said.encode()):
        message = "found a damaged file, whose checksum is not that of its content"
        raise DamageError(message)
    label: dict[str, str] = json.loads(said)
    return label


def expect(label: Mapping[str, str], **expected: str) -> None:
    """Refuse a label that says another thing.

    Raises
    ------
    DamageError
        The message says which.
    """
    for name, value in expected.items():
        if label.get(name) != value:
            message = f"found the {name} {label.get(name)!r}, expected {value!r}"
            raise DamageError(message)


def parse_table(content: bytes, columns: list[str] | None = None) -> pa.Table:
    """The table that the bytes of a Parquet file hold.

    Raises
    ------
    DamageError
        If they are none, or some of the columns are missing.
    """
    try:
        # A thread of Arrow's may still hold `content` when this returns; where that is a process's last act, it asks an
        # interpreter that has ended for its lock, and the process aborts (apache/arrow#34314) or hangs (#50482).
        table = pq.ParquetFile(pa.BufferReader(content)).read(columns, use_threads=False)
        # Text that is no UTF-8 is found here, or by whoever looks at it.
        table.validate(full=True)
        missing = [name for name in columns or () if name not in table.column_names]
    except Exception as error:  # of a damaged file pyarrow raises a dozen kinds
        reason = (str(error).splitlines() or [type(error).__name__])[0]
        message = f"found an unreadable file ({reason}), expected Parquet"
        raise DamageError(message) from error
    if missing:
        message = f"found no column {', '.join(map(repr, missing))}, expected the columns of this program's files"
        raise DamageError(message)
    return table


def check_columns(table: pa.Table, expected: Mapping[str, pa.DataType]) -> None:
    """Refuse a table that lacks some columns, has them twice, or has them of another type.

    Nor may any be empty; but what is unknown of some runs may be any number: pandas makes floats of whole ones then.

    Raises
    ------
    DamageError
        The message says which.
    """
    for name, kind in expected.items():
        found = [field.type for field in table.schema if field.name == name]
        is_any_number = len(found) == 1 and name in OPTIONAL and is_number(found[0])
        if [_plain(one) for one in found] != [_plain(kind)] and not is_any_number:
            what = "no such column" if not found else f"{len(found)} such" if len(found) > 1 else str(found[0])
            message = f"column {name!r}: found {what}, expected {kind}"
            raise DamageError(message)
        if name not in OPTIONAL and table[name].null_count:
            message = f"column {name!r}: found nothing in {table[name].null_count} of its rows"
            raise DamageError(message)


def is_number(kind: pa.DataType) -> bool:
    """Whether values of this type can be calculated with, or are all unknown."""
    is_of = pa.types.is_integer, pa.types.is_floating, pa.types.is_boolean, pa.types.is_null
    return any(one(kind) for one in is_of)


def _plain(kind: pa.DataType) -> str:
    """Its name, in which neither the width of offsets counts nor how libraries call the elements of a list."""
    return re.sub(r"<\w+: ", "<", str(kind).replace("large_", ""))


def _content(table: pa.Table) -> Iterator[bytes]:
    for name, column in zip(table.column_names, table.columns, strict=True):
        yield json.dumps([name, str(column.type), len(column)]).encode()
        yield from _values(column)


def _values(column: Any) -> Iterator[bytes]:
    kind = column.type
    if pa.types.is_integer(kind) or pa.types.is_floating(kind) or pa.types.is_boolean(kind):
        empty = pa.scalar(0, pa.int8()).cast(kind)
        yield pc.is_null(column).to_numpy().tobytes()
        yield pc.fill_null(column, empty).to_numpy().tobytes()
    else:
        yield repr(column.to_pylist()).encode(errors="backslashreplace")
