"""What is stored of a shard: state trees as bytes (`apel.numerics.state_trees`) that are *sealed*: they say whose they
are, and carry a checksum of all that.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

import numpy as np

from apel.numerics import state_trees
from apel.numerics.state_trees import StateError, digest

__all__ = ["CheckpointError", "digest", "pack", "seal", "unpack", "unseal", "writable"]

_SEAL = b"\nAPEL-SEAL "


class CheckpointError(Exception):
    """A state that cannot be stored, or a file that holds none, or another one's."""


def seal(content: bytes, label: Mapping[str, str]) -> bytes:
    """The bytes with a seal behind them: whose they are, and their checksum. An ``npz`` file stays one.

    >>> unseal(seal(b"state", {"arm": "APEL"}), {"arm": "APEL"})
    b'state'
    """
    said = json.dumps(dict(label), sort_keys=True)
    tail = json.dumps({"digest": digest(content, said.encode()), "label": said})
    return content + _SEAL + tail.encode()


def unseal(content: bytes, label: Mapping[str, str]) -> bytes:
    """The bytes that `seal` was given.

    Raises
    ------
    CheckpointError
        If they are damaged, have no seal, or are not those of ``label``; the message says which, and how.
    """
    payload, mark, tail = content.rpartition(_SEAL)
    if not mark:
        message = "found a file that is cut off, or of an older version, expected one with a checksum"
        raise CheckpointError(message)
    try:
        found = json.loads(tail)
        said, checksum = str(found["label"]), found["digest"]
    except (ValueError, TypeError, KeyError):
        said, checksum = "", None
    if checksum != digest(payload, said.encode()):
        message = "found a damaged file, whose checksum is not that of its content"
        raise CheckpointError(message)
    theirs = json.loads(said)
    for name in sorted(label.keys() | theirs.keys()):
        if theirs.get(name) != label.get(name):
            message = f"found the {name} {theirs.get(name)!r}, expected {label.get(name)!r}"
            raise CheckpointError(message)
    return payload


def pack(tree: Any) -> bytes:
    """The bytes of a state tree, see `apel.numerics.state_trees.pack`.

    Raises
    ------
    CheckpointError
        If it holds what cannot be stored; the message names the place.
    """
    try:
        return state_trees.pack(tree)
    except StateError as error:
        raise CheckpointError(str(error)) from error


def unpack(content: bytes) -> Any:
    """The tree that `pack` stored; tuples have become lists.

    Raises
    ------
    CheckpointError
        If the bytes are no such file.
    """
    try:
        return state_trees.unpack(content)
    except StateError as error:
        raise CheckpointError(str(error)) from error


def writable(tree: Any) -> Any:
    """The same tree with arrays of its own: those that came through Ray's object store may only be read.

    >>> frozen = np.zeros(1)
    >>> frozen.flags.writeable = False
    >>> writable({"a": [frozen]})["a"][0].flags.writeable
    True
    """
    match tree:
        case np.ndarray():
            return tree.copy()
        case dict():
            return {key: writable(child) for key, child in tree.items()}
        case list() | tuple():
            return [writable(child) for child in tree]
    return tree
