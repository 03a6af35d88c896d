"""What pydantic finds wrong with an experiment file, in our words: place, what was found, what was expected."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from pydantic import BaseModel, ValidationError

from apel.numerics.near_names import did_you_mean, names_at, nearest
from jobs.experiment.yaml_schema import shown
from jobs.experiment.yaml_source import Place, Source, place_of

_MAX_LINES = 20
_MAPPING = "a mapping"
_QUOTED = re.compile(r"'([^']+)'")
_EXPECTED: Mapping[str, str] = {
    **dict.fromkeys(("model_type", "model_attributes_type", "dataclass_type", "dict_type"), _MAPPING),
    **dict.fromkeys(("int_type", "int_parsing", "int_from_float"), "a whole number"),
    **dict.fromkeys(("float_type", "float_parsing"), "a number"),
    **dict.fromkeys(("bool_type", "bool_parsing"), "true or false"),
    "string_type": "text",
    "list_type": "a list",
    "finite_number": "a finite number",
    "string_pattern_mismatch": "a name of letters, digits and _ . + -, that matches {pattern}",
    "string_too_long": "at most {max_length} characters",
    "too_short": "at least {min_length} of them",
    "too_long": "at most {max_length:,} of them",
    "union_tag_invalid": "one of {expected_tags}",
}


def describe(source: Source, error: ValidationError, model: type[BaseModel]) -> str:
    """One line per error; ``model`` is what the document should have been."""
    found = _without_echoes(_most_specific(source, error), model)
    lines = [_describe(source, place, one, model) for place, one in found[:_MAX_LINES]]
    return "\n".join(lines + [f"… and {len(found) - _MAX_LINES} more"] * (len(found) > _MAX_LINES))


def _most_specific(source: Source, error: ValidationError) -> list[tuple[Place, Any]]:
    """One error per field: of the alternatives of a union, the one that was followed furthest."""
    chosen: dict[Place, Any] = {}
    for one in error.errors(include_url=False):
        place = _place(source.content, one)
        if place in chosen:
            chosen[place]["alternatives"].append(_expected(one))
        else:
            chosen[place] = {**one, "alternatives": [_expected(one)]}
    enclosing = {place[:length] for place in chosen for length in range(len(place))}
    return [(place, one) for place, one in chosen.items() if place not in enclosing]


def _without_echoes(found: list[tuple[Place, Any]], model: type[BaseModel]) -> list[tuple[Place, Any]]:
    """The same without the fields that are missing only since their names are written wrongly: that is said already."""
    meant = {(*place[:-1], nearest(place[-1], names_at(place[:-1], model))) for place, one in found if _is_unknown(one)}
    return [(place, one) for place, one in found if one["type"] != "missing" or place not in meant]


def _is_unknown(error: Any) -> bool:
    return error["type"] in ("extra_forbidden", "unexpected_keyword_argument")


def _describe(source: Source, place: Place, error: Any, model: type[BaseModel]) -> str:
    path = ".".join(str(part) for part in place)
    where = f"{source.where(place)}: {path}" if path else source.where(place)
    match error["type"]:
        case "extra_forbidden" | "unexpected_keyword_argument":
            return f"{where}: found a field that does not exist here{_meant(place, model)}"
        case "missing" | "union_tag_not_found":
            return f"{where}: found nothing, expected this field to be given{_neighbour_meant(source, place)}"
        case "value_error" | "assertion_error":
            message = error["msg"].removeprefix("Value error, ")
            # What concerns several fields is found at the root: its message opens with the field to be changed.
            where = where if path else source.where(place_of(message.partition(":")[0]))
            return f"{where}: {message}"
    found = error["ctx"]["tag"] if error["type"] == "union_tag_invalid" else error["input"]
    meant = did_you_mean(found, _QUOTED.findall(" ".join(error["alternatives"]))) if isinstance(found, str) else ""
    return f"{where}: found {shown(found)}, expected {', or '.join(dict.fromkeys(error['alternatives']))}{meant}"


def expectation(error: Any, model: Any) -> str:
    """What was found at a field of ``model``, and what was expected there."""
    if _is_unknown(error):
        return f"found a field that does not exist here{_meant(error['loc'], model)}"
    return f"found {shown(error['input'])}, expected {_expected(error)}"


def _expected(error: Any) -> str:
    template = _EXPECTED.get(error["type"])
    return template.format(**error.get("ctx", {})) if template else error["msg"].removeprefix("Input should be ")


def _place(content: Any, error: Any) -> Place:
    """The fields of a location, without the names of union members and validators that pydantic puts between them."""
    place: list[str | int] = []
    node, location = content, error["loc"]
    for position, part in enumerate(location):
        is_inside = isinstance(node, dict) and part in node
        is_item = isinstance(node, list) and isinstance(part, int) and part < len(node)
        if is_inside or is_item:
            node = node[part]
            place.append(part)
        elif error["type"] == "missing" and position == len(location) - 1:
            place.append(part)
    if error["type"].startswith("union_tag_"):
        place.append(error["ctx"]["discriminator"].strip("'"))
    return tuple(place)


def _meant(place: Place, model: Any) -> str:
    names = names_at(place[:-1], model)
    return did_you_mean(place[-1], names) or (f", expected {', '.join(names)}" if names else "")


def _neighbour_meant(source: Source, place: Place) -> str:
    """Where an option has made a new arm, or the like, of which much is missing: the one that it was to change."""
    for length in range(1, len(place)):
        made, siblings = place[:length], source.content
        if source.made_by(made):
            for part in made[:-1]:
                siblings = siblings[part]  # type: ignore[index]
            return did_you_mean(made[-1], [name for name in siblings if name != made[-1]])
    return ""
