"""Fields of a document by their dotted paths (``arms.APEL.selector.decay``); positions in lists are numbers."""

from __future__ import annotations

from typing import Any


def set_path(content: dict[str, Any], path: str, value: Any) -> None:
    """Set a field by its dotted path (``arms.APEL.selector.decay``); list positions are numbers.

    Raises
    ------
    KeyError
        If the path leads through something that has no fields.
    """
    *parents, last = path.split(".")
    node: Any = content
    for part in parents:
        if isinstance(node, dict) and node.get(part, ...) in (..., None):
            node[part] = {}
        node = node[_key(node, part, path)]
    node[_key(node, last, path)] = value


def changed(content: dict[str, Any], path: str, value: Any) -> dict[str, Any]:
    """The content with a field set, see `set_path`; all that the path does not lead through is shared."""
    root = node = dict(content)
    for part in path.split(".")[:-1]:
        child = node.get(part) if isinstance(node, dict) else node[_key(node, part, path)]
        copied: Any = dict(child or {}) if isinstance(child, dict | None) else child
        copied = list(child) if isinstance(child, list) else copied
        node[_key(node, part, path)] = copied
        node = copied
    set_path(root, path, value)
    return root


def _key(node: Any, part: str, path: str) -> Any:
    if isinstance(node, dict):
        return part
    if isinstance(node, list) and part.isascii() and part.isdecimal() and len(part) < 9 and int(part) < len(node):
        return int(part)
    message = f"{path}: found {type(node).__name__} before {part!r}, expected a mapping"
    raise KeyError(message)
