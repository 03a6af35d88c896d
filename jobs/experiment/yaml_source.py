"""YAML with a memory of where everything stood, so that an error can name its line.

A document is read by YAML 1.2's core schema into a tree: what an alias stands for is a copy. Merge keys (``<<``), which
YAML 1.2 has no more, are understood.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import yaml

from jobs.experiment.yaml_schema import MAX_DEPTH, is_name, plain_scalar, plain_value, shown, tagged_scalar, visible

Place = tuple[str | int, ...]
MAX_CHARACTERS = 1_000_000
MAX_VALUES = 50_000
_MERGE = "<<"
_LOADER: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
_COLLECTION_TAGS = {
    "[": (None, "!", "tag:yaml.org,2002:seq"),
    "{": (None, "!", "tag:yaml.org,2002:map"),
}


def place_of(path: str) -> Place:
    """The place that a dotted path names.

    >>> place_of("plots.0.name")
    ('plots', 0, 'name')
    """
    return tuple(int(part) if part.isdecimal() and len(part) < 9 else part for part in path.split("."))


class SpecError(Exception):
    """An experiment file, or an option that overrides it, that cannot be used. The message says where and why."""

    def __init__(self, message: str) -> None:
        # Whatever stood in a file goes to a terminal now.
        super().__init__(visible(message))


@dataclass(frozen=True)
class Source:
    """A parsed document with the line of each of its fields."""

    name: str
    content: dict[str, Any]
    lines: dict[Place, int] = field(default_factory=dict)
    overrides: dict[Place, str] = field(default_factory=dict)
    """Fields that were set by an option, with that option as it was given."""

    def where(self, place: Sequence[str | int]) -> str:
        """``file:line`` of the nearest enclosing field that stands in the file, or the option that has set it; both
        where an option has set a part of it.
        """
        parts = [text for inner, text in self.overrides.items() if place and inner[: len(place)] == tuple(place)]
        for length in range(len(place), -1, -1):
            enclosing = tuple(place[:length])
            if enclosing in self.overrides:
                return self.overrides[enclosing]
            if enclosing in self.lines:
                return " with ".join([f"{self.name}:{self.lines[enclosing]}", *parts])
            if makers := self.made_by(enclosing):
                return " and ".join(makers)
        return self.name

    def made_by(self, place: Place) -> list[str]:
        """The options that have set a part of a mapping which does not stand in the file; none for what does."""
        if not place or place in self.lines:
            return []
        return [text for inner, text in self.overrides.items() if inner[: len(place)] == place]


@dataclass(frozen=True)
class _Node:
    """A value as it stands in the text. ``content``: the scalar's value; nodes; or keys (line, text) with nodes."""

    kind: str
    content: Any
    line: int


class _FaultError(Exception):
    """What is wrong in a line."""

    def __init__(self, line: int, message: str) -> None:
        super().__init__(message)
        self.line = line


def parse(text: str, name: str) -> Source:
    """Parse a document whose top level is a mapping.

    Raises
    ------
    SpecError
        If it is no YAML, gives a key twice, is too large, or is no mapping.
    """
    content, lines = _read(text, name)
    if not isinstance(content, dict):
        found = "nothing" if content is None else type(content).__name__
        message = f"{name}: found {found}, expected a mapping with the fields of an experiment"
        raise SpecError(message)
    return Source(name, content, lines)


def parse_value(text: str, name: str, place: Place) -> Any:
    """The value that a text in YAML stands for, which is to be put at ``place``; see `parse`.

    >>> parse_value("[1e-3, on, 012]", "--set a=…", ("a",))
    [0.001, 'on', 12]
    """
    return _read(text, name, place)[0]


def _read(text: str, name: str, place: Place = ()) -> tuple[Any, dict[Place, int]]:
    try:
        if len(text) > MAX_CHARACTERS:
            raise _FaultError(0, f"found {len(text):,} characters, expected at most {MAX_CHARACTERS:,}")
        text.encode()
        root = _Composer(text).document(place)
        expansion = _Expansion()
        content = expansion.value(root, place) if root else None
    except (_FaultError, yaml.YAMLError, ValueError, OverflowError) as error:
        # An option has no lines.
        raise SpecError(_message(error, name, has_lines=not place)) from error
    return content, expansion.lines if root else {}


def _message(error: Exception, name: str, *, has_lines: bool) -> str:
    if isinstance(error, _FaultError):
        return f"{name}:{error.line}: {error}" if error.line and has_lines else f"{name}: {error}"
    mark = getattr(error, "problem_mark", None)
    line = f":{mark.line + 1}" if mark and has_lines else ""
    problem = getattr(error, "problem", None) or str(error).partition("\n")[0]
    return f"{name}{line}: found no valid YAML: {problem}"


class _Composer:
    """Events to nodes; an alias is the very node that it names, which the expansion then copies."""

    def __init__(self, text: str) -> None:
        self._events: Iterator[Any] = iter(yaml.parse(text, Loader=_LOADER))
        self._anchors: dict[str, _Node | None] = {}

    def document(self, place: Place) -> _Node | None:
        """The root of the only document, which is to be put at ``place``; None where there is none."""
        next(self._events)
        event = next(self._events)
        if isinstance(event, yaml.StreamEndEvent):
            return None
        root = self._node(next(self._events), place)
        next(self._events)
        event = next(self._events)
        if not isinstance(event, yaml.StreamEndEvent):
            raise _FaultError(_line(event), "found a second document, expected one")
        return root

    def _node(self, event: Any, place: Place) -> _Node:
        if len(place) > MAX_DEPTH:
            raise _too_deep(_line(event))
        if isinstance(event, yaml.AliasEvent):
            return self._aliased(event)
        if event.anchor is not None:
            self._anchors[event.anchor] = None
        if isinstance(event, yaml.ScalarEvent):
            node = _Node("scalar", _scalar(event, place), _line(event))
        elif isinstance(event, yaml.SequenceStartEvent):
            node = _Node("[", self._items(event, place), _line(event))
        else:
            node = _Node("{", self._fields(event, place), _line(event))
        if event.anchor is not None:
            self._anchors[event.anchor] = node
        return node

    def _aliased(self, event: Any) -> _Node:
        node = self._anchors.get(event.anchor)
        if node is None:
            why = "within what it stands for" if event.anchor in self._anchors else "without an anchor of that name"
            raise _FaultError(_line(event), f"found the alias *{shown(event.anchor)[1:-1]} {why}")
        return node

    def _items(self, start: Any, place: Place) -> list[_Node]:
        _check_tag(start, place, "[")
        items: list[_Node] = []
        while not isinstance(event := next(self._events), yaml.SequenceEndEvent):
            items.append(self._node(event, (*place, len(items))))
        return items

    def _fields(self, start: Any, place: Place) -> list[tuple[int, str, _Node]]:
        _check_tag(start, place, "{")
        fields = []
        while not isinstance(event := next(self._events), yaml.MappingEndEvent):
            line = _line(event)
            key = _key(self._node(event, place), place, line)
            fields.append((line, key, self._node(next(self._events), (*place, key))))
        return fields


def _key(node: _Node, place: Place, line: int) -> str:
    if node.kind != "scalar":
        raise _FaultError(line, f"{_path(place)}found a list or mapping as a key, expected text")
    if not isinstance(node.content, str):
        raise _FaultError(line, f"{_path(place)}found the key {shown(node.content)}, expected text: put it in quotes")
    if not is_name(node.content):
        message = f"{_path(place)}found the key {shown(node.content)}, expected text without control characters"
        raise _FaultError(line, message)
    return node.content


def _scalar(event: Any, place: Place) -> Any:
    try:
        if event.tag is not None:
            return plain_value(tagged_scalar(event.tag, event.value))
        return plain_value(plain_scalar(event.value) if event.implicit[0] else event.value)
    except ValueError as error:
        raise _FaultError(_line(event), f"{_path(place)}{error}") from error


def _check_tag(event: Any, place: Place, kind: str) -> None:
    if event.tag not in _COLLECTION_TAGS[kind]:
        tag = event.tag.replace("tag:yaml.org,2002:", "!!")
        what = "list" if kind == "[" else "mapping"
        message = f"{_path(place)}found the tag {shown(tag)} on a {what}, expected a {what} without a tag"
        raise _FaultError(_line(event), message)


def _path(place: Place) -> str:
    return f"{'.'.join(map(str, place))}: " if place else ""


class _Expansion:
    """Nodes to a tree of values, in which nothing stands twice."""

    def __init__(self, count: int = 0, merges: int = 0) -> None:
        self.lines: dict[Place, int] = {}
        self._count, self._merges = count, merges

    def value(self, node: _Node, place: Place) -> Any:
        """A new value of the node; where its fields stood goes to ``lines``."""
        self._count += 1
        if self._count > MAX_VALUES:
            raise _FaultError(node.line, f"found more than {MAX_VALUES:,} values, aliases written out, expected fewer")
        if max(len(place), self._merges) > MAX_DEPTH:
            raise _too_deep(node.line)
        self.lines.setdefault(place, node.line)
        if node.kind == "[":
            return [self.value(item, (*place, i)) for i, item in enumerate(node.content)]
        return self._mapping(node, place) if node.kind == "{" else node.content

    def _mapping(self, node: _Node, place: Place) -> dict[str, Any]:
        own: dict[str, Any] = {}
        merged: list[_Node] = []
        for line, key, child in node.content:
            inner = (*place, key)
            if inner in self.lines:
                raise _FaultError(line, f"{'.'.join(map(str, inner))}: found twice, expected once")
            self.lines[inner] = line
            if key == _MERGE:
                merged += _merged(child, line)
            else:
                own[key] = self.value(child, inner)
        return self._inherited(merged, own, place) if merged else own

    def _inherited(self, merged: Sequence[_Node], own: dict[str, Any], place: Place) -> dict[str, Any]:
        found: dict[str, Any] = {}
        for one in merged:
            # At a place of its own, since its keys are none of ours until we know which of them are new.
            apart = _Expansion(self._count, self._merges + 1)
            more = apart.value(one, place)
            self._count = apart._count
            for inner, line in apart.lines.items():
                self.lines.setdefault(inner, line)
            found |= {key: value for key, value in more.items() if key not in found}
        return found | own


def _merged(node: _Node, line: int) -> list[_Node]:
    nodes = node.content if node.kind == "[" else [node]
    if any(one.kind != "{" for one in nodes):
        raise _FaultError(line, "found << with something else, expected a mapping, or a list of mappings")
    return list(nodes)


def _too_deep(line: int) -> _FaultError:
    return _FaultError(line, f"found more than {MAX_DEPTH} levels, expected fewer lists and mappings in each other")


def _line(event: Any) -> int:
    return int(event.start_mark.line) + 1
