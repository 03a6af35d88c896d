"""What pydantic finds wrong with an experiment file, in our words: place, what was found, what was expected."""

from __future__ import annotations

from typing import Any

from pydantic import ValidationError

from jobs.yaml_source import Place, Source


def describe(source: Source, error: ValidationError) -> str:
    """One line per error."""
    return "\n".join(_describe(source, one) for one in _most_specific(error))


def _most_specific(error: ValidationError) -> list[Any]:
    """One error per field: of the alternatives of a union, the one that was followed furthest."""
    errors = error.errors()
    places = [tuple(part for part in one["loc"] if _is_field(part)) for one in errors]
    chosen: dict[Place, Any] = {}
    for place, one in zip(places, errors, strict=True):
        if any(other != place and other[: len(place)] == place for other in places):
            continue
        if place in chosen:
            one["msg"] = f"{chosen[place]['msg']}, or {one['msg'].removeprefix('Input should be ')}"
        chosen[place] = one
    return list(chosen.values())


def _describe(source: Source, error: Any) -> str:
    place: Place = tuple(part for part in error["loc"] if _is_field(part))
    path = ".".join(str(part) for part in place)
    where = f"{source.where(place)}: {path}" if path else source.where(place)
    if error["type"] == "extra_forbidden":
        return f"{where}: found a field that does not exist here"
    if error["type"] == "missing":
        return f"{where}: found nothing, expected this field to be given"
    if error["type"] in {"value_error", "assertion_error"}:
        message = error["msg"].removeprefix("Value error, ")
        # What concerns several fields is found at the root: its message opens with the field to be changed.
        where = where if path else source.where(_parts(message.partition(":")[0]))
        return f"{where}: {message}"
    return f"{where}: found {error['input']!r}, expected {error['msg'].removeprefix('Input should be ')}"


def _parts(path: str) -> Place:
    return tuple(int(part) if part.isdigit() else part for part in path.split("."))


def _is_field(part: str | int) -> bool:
    """Pydantic adds the names of union members and of validators to a location."""
    return isinstance(part, int) or not any(
        mark in part for mark in ("[", "(", "Threshold", "Every", "literal", "float")
    )
