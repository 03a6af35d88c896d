"""State trees to bytes and back: arrays and plain values only, so that reading a file never runs code."""

from __future__ import annotations

import io
import json
import zipfile
from typing import Any

import numpy as np

# In the skeleton, which is JSON, a list is ["list", children] and an array ["array", name]; a dictionary is itself.


class CheckpointError(Exception):
    """A state that cannot be stored, or a file that holds none."""


def pack(tree: Any) -> bytes:
    """A tree of dictionaries, lists, arrays, numbers, strings, booleans and None as the bytes of one ``npz`` file.

    Raises
    ------
    CheckpointError
        If it holds anything else; the message names the place.
    """
    arrays: dict[str, Any] = {}
    skeleton = _flatten(tree, arrays, "state")
    buffer = io.BytesIO()
    np.savez(buffer, tree=np.frombuffer(json.dumps(skeleton).encode(), dtype=np.uint8), **arrays)
    return buffer.getvalue()


def unpack(content: bytes) -> Any:
    """The tree that `pack` stored; tuples have become lists.

    Raises
    ------
    CheckpointError
        If the bytes are no such file.
    """
    try:
        with np.load(io.BytesIO(content), allow_pickle=False) as arrays:
            skeleton = json.loads(arrays["tree"].tobytes())
            return _restore(skeleton, arrays)
    except (ValueError, KeyError, OSError, EOFError, TypeError, AttributeError, zipfile.BadZipFile) as error:
        message = f"found an unreadable checkpoint ({error}), expected one written by this program"
        raise CheckpointError(message) from error


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


def _flatten(node: Any, arrays: dict[str, Any], place: str) -> Any:
    match node:
        case None | bool() | int() | float() | str():
            return node
        case np.generic() | np.ndarray() if node.dtype.kind in "biufcSU":
            name = f"a{len(arrays)}"
            arrays[name] = np.asarray(node)
            return ["array", name]
        case list() | tuple():
            return ["list", [_flatten(child, arrays, f"{place}[{i}]") for i, child in enumerate(node)]]
        case dict() if all(isinstance(key, str) for key in node):
            return {key: _flatten(child, arrays, f"{place}.{key}") for key, child in node.items()}
    message = (
        f"{place}: found {type(node).__name__}, expected only dictionaries with string keys, lists, arrays of numbers, "
        "numbers, strings, booleans and None in a learner's state()"
    )
    raise CheckpointError(message)


def _restore(node: Any, arrays: Any) -> Any:
    match node:
        case dict():
            return {key: _restore(child, arrays) for key, child in node.items()}
        case ["array", name]:
            return arrays[name]
        case ["list", children]:
            return [_restore(child, arrays) for child in children]
    return node
