"""State trees to bytes and back: arrays and plain values only, so that reading a file never runs code.

A tree becomes a *skeleton*, which is JSON, and arrays by name. In the skeleton a list is ``["list", children]`` and an
array ``["array", name]``; a dictionary is itself.
"""

from __future__ import annotations

import hashlib
import io
import json
import zipfile
from collections.abc import Mapping
from typing import Any

import numpy as np


class StateError(ValueError):
    """A state that cannot be stored, or bytes that hold none."""


_READ_ERRORS = (ValueError, KeyError, OSError, EOFError, TypeError, AttributeError, zipfile.BadZipFile)


def digest(*parts: bytes | memoryview) -> str:
    """The checksum of all stored files: 160 bits of BLAKE2b in hexadecimal digits."""
    total = hashlib.blake2b(digest_size=20)
    for part in parts:
        total.update(part)
    return total.hexdigest()


def pack(tree: Any) -> bytes:
    """A tree of dictionaries, lists, arrays, numbers, strings, booleans and None as the bytes of one ``npz`` file.

    Raises
    ------
    StateError
        If it holds anything else; the message names the place.
    """
    skeleton, arrays = flatten(tree)
    return bytes_of_arrays({"tree": np.frombuffer(json.dumps(skeleton).encode(), dtype=np.uint8), **arrays})


def unpack(content: bytes) -> Any:
    """The tree that `pack` stored; tuples have become lists.

    Raises
    ------
    StateError
        If the bytes are no such file.
    """
    arrays = arrays_from(content)
    try:
        skeleton = json.loads(arrays["tree"].tobytes())
    except _READ_ERRORS as error:
        raise _unreadable(error) from error
    return restore(skeleton, arrays)


def flatten(tree: Any) -> tuple[Any, dict[str, Any]]:
    """Skeleton and arrays of a tree; see `pack`."""
    arrays: dict[str, Any] = {}
    return _flatten(tree, arrays, "state"), arrays


def bytes_of_arrays(arrays: Mapping[str, Any]) -> bytes:
    """The bytes of an ``npz`` file."""
    buffer = io.BytesIO()
    np.savez(buffer, **arrays)
    return buffer.getvalue()


def arrays_from(content: bytes) -> dict[str, Any]:
    """The arrays of an ``npz`` file, see `unpack`."""
    try:
        with np.load(io.BytesIO(content), allow_pickle=False) as arrays:
            return dict(arrays)
    except _READ_ERRORS as error:
        raise _unreadable(error) from error


def restore(skeleton: Any, arrays: Mapping[str, Any]) -> Any:
    """The tree that `flatten` was given; see `unpack`."""
    try:
        return _restore(skeleton, arrays)
    except _READ_ERRORS as error:
        raise _unreadable(error) from error


def _unreadable(error: BaseException) -> StateError:
    return StateError(f"found an unreadable state ({error}), expected one written by this program")


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
    raise StateError(message)


def _restore(node: Any, arrays: Mapping[str, Any]) -> Any:
    match node:
        case dict():
            return {key: _restore(child, arrays) for key, child in node.items()}
        case ["array", name]:
            return arrays[name]
        case ["list", children]:
            return [_restore(child, arrays) for child in children]
    return node
