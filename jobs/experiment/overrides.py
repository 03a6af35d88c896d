"""Options that set a field (``--set``) beside a sweep that sets it, too."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from jobs.experiment.axes import axis_paths
from jobs.experiment.yaml_source import Place, Source, SpecError, place_of


def refuse_swept_overrides(source: Source, in_file: Any) -> None:
    """Refuse options that set what every sweep point sets again: they would change the identity, and no run.

    That is a field that an axis sets, one within it, or a mapping that gives such a field another value than
    ``in_file``, the content before any option; where it only repeats what stands in the file it may be there to say
    the order of its names.

    Raises
    ------
    SpecError
        One line per option.
    """
    swept = list(_swept(source.content.get("sweep")))
    messages = [
        f"{option}: found a value of {path}, which the axis {axis!r} of the sweep sets at each point, expected none, "
        "or the sweep itself to be overridden (--set 'sweep={…}')"
        for place, option in source.overrides.items()
        for axis, path in swept
        if _is_lost(place, place_of(path), source.content, in_file)
    ]
    if messages:
        raise SpecError("\n".join(dict.fromkeys(messages)))


def _swept(sweep: Any) -> Iterator[tuple[str, str]]:
    """Axis and path of each swept field; of what is no sweep, none: the error about it comes later."""
    for axis, values in sweep.items() if isinstance(sweep, dict) else ():
        yield from ((axis, path) for path in axis_paths(axis, values))


def _is_lost(place: Place, swept: Place, content: Any, in_file: Any) -> bool:
    if place[: len(swept)] == swept:
        return True
    found = _at(content, swept)
    return swept[: len(place)] == place and found is not ... and found != _at(in_file, swept)


def _at(node: Any, place: Place) -> Any:
    """What stands at a place; ``...`` where nothing does."""
    for part in place:
        if isinstance(node, dict):
            node = node.get(str(part), ...)
        elif isinstance(node, list) and isinstance(part, int) and part < len(node):
            node = node[part]
        else:
            return ...
    return node
