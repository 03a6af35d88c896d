"""YAML with a memory of where everything stood, so that an error can name its line."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import yaml

Place = tuple[str | int, ...]


class SpecError(Exception):
    """An experiment file, or an option that overrides it, that cannot be used. The message says where and why."""


@dataclass(frozen=True)
class Source:
    """A parsed document with the line of each of its fields."""

    name: str
    content: dict[str, Any]
    lines: dict[Place, int] = field(default_factory=dict)

    def where(self, place: Sequence[str | int]) -> str:
        """``file:line`` of the nearest enclosing field that stands in the file."""
        for length in range(len(place), -1, -1):
            line = self.lines.get(tuple(place[:length]))
            if line is not None:
                return f"{self.name}:{line}"
        return self.name


def parse(text: str, name: str) -> Source:
    """Parse a document whose top level is a mapping.

    Raises
    ------
    SpecError
        If it is no YAML, gives a key twice, or is no mapping.
    """
    try:
        loader = yaml.SafeLoader(text)
        root = loader.get_single_node()
        lines: dict[Place, int] = {}
        if root is not None:
            _walk(root, (), lines, name)
        content = loader.construct_document(root) if root is not None else None
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        line = f":{mark.line + 1}" if mark else ""
        message = f"{name}{line}: found no valid YAML: {getattr(error, 'problem', None) or error}"
        raise SpecError(message) from error
    if not isinstance(content, dict):
        message = f"{name}: found {type(content).__name__}, expected a mapping with the fields of an experiment"
        raise SpecError(message)
    return Source(name, content, lines)


def _walk(node: yaml.Node, place: Place, lines: dict[Place, int], name: str) -> None:
    lines.setdefault(place, node.start_mark.line + 1)
    if isinstance(node, yaml.MappingNode):
        for key, value in node.value:
            inner = (*place, str(key.value))
            if inner in lines:
                message = f"{name}:{key.start_mark.line + 1}: {'.'.join(map(str, inner))}: found twice, expected once"
                raise SpecError(message)
            lines[inner] = key.start_mark.line + 1
            _walk(value, inner, lines, name)
    elif isinstance(node, yaml.SequenceNode):
        for index, value in enumerate(node.value):
            _walk(value, (*place, index), lines, name)
