"""The JSON schema of an experiment file, with the options of every shipped learner and selector, for editors.

All of it is read off the classes that check the file (pydantic's), and off their docstrings: what a field means is told
where it is declared. https://json-schema.org/draft/2020-12
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Mapping
from typing import Any

import gymnasium
from pydantic import TypeAdapter
from pydantic.json_schema import GenerateJsonSchema

from apel.building.registry import LEARNERS, METRICS, OPTIONS, SELECTORS, load
from apel.experience.representations import Representation
from apel.numerics.near_names import keywords_of
from jobs.experiment.spec import Experiment
from jobs.experiment.spec_parts import LearnerSpec

Schema = dict[str, Any]
_VARIABLE: Schema = {"type": "string", "pattern": r"^\$"}
"""What is drawn for each run, in the place of an option of a learner."""
_IMPORT_PATH: Schema = {"type": "string", "pattern": r"^[^:\s]+:[^:\s]+$"}
_MADE_WITH = ("observation_space", "action_space", "seed")
_ENTRY = re.compile(r"^([\w, ]+):\n((?:    .*\n|\n)+)", re.MULTILINE)
_FIELDS = set(LearnerSpec.model_fields) - {"representation"}
"""Of a learner, no options: what stands there is the same in every run."""
_ABOUT = ("description", "default", "title")


class _Untitled(GenerateJsonSchema):
    """Without the titles that only say a field's name again."""

    def field_title_should_be_set(self, schema: Any) -> bool:  # noqa: ARG002 - pydantic's signature
        return False


def experiment_schema() -> Schema:
    """The schema. Learners whose packages are not installed (PyTorch) take any option by it."""
    kinds: dict[Any, Any] = {"experiment": Experiment, "representation": Representation, **SELECTORS}
    kinds |= {f"learner {name}": model for name in LEARNERS if (model := _options_model(name)) is not None}
    adapters: Any = [(name, "validation", TypeAdapter(kind)) for name, kind in kinds.items()]
    found, shared = TypeAdapter.json_schemas(adapters, schema_generator=_Untitled)
    parts = {name: found[name, "validation"] for name in kinds}
    definitions = shared.get("$defs", {})
    whole = {name: _whole(part, definitions, kinds[name]) for name, part in parts.items()}
    learner, selector = (_described(definitions[name], None) for name in ("LearnerSpec", "SelectorSpec"))
    learner["properties"]["representation"] = whole["representation"]
    learners = [_one(name, learner, _of_learner(name, whole.get(f"learner {name}"))) for name in LEARNERS]
    definitions["LearnerSpec"] = {
        "description": learner["description"],
        "oneOf": [*map(_with_variables, learners), _one(None, learner, {})],
    }
    definitions["SelectorSpec"] = {
        "description": selector["description"],
        "oneOf": [*(_one(name, selector, whole[name]) for name in SELECTORS), _one(None, selector, {})],
    }
    for name in _reachable(definitions["LearnerSpec"], definitions):
        definitions[name] = _with_variables(definitions[name])
    ids = {"anyOf": [{"enum": sorted(gymnasium.registry)}, {"type": "string"}]}
    definitions["EnvironmentSpec"]["properties"]["id"] = ids
    schema = whole["experiment"]
    measures = {"anyOf": [{"enum": list(METRICS)}, _IMPORT_PATH], "default": "return"}
    about = schema["properties"]["performance"]["description"]
    schema["properties"]["performance"] = {"description": about, **measures}
    return {
        "$schema": GenerateJsonSchema.schema_dialect,
        "title": "An experiment of APEL",
        **schema,
        "$defs": {name: _described(definitions[name], None) for name in _reachable(schema, definitions)},
    }


def _options_model(learner: str) -> Any:
    """The class of a learner's options; None where it has none of pydantic's, or cannot be imported here."""
    model = OPTIONS.get(learner)
    try:
        return load(model) if isinstance(model, str) else model
    except ValueError:
        return None


def _of_learner(name: str, options: Schema | None) -> Schema:
    """The schema of a learner's options; open where it hands them on to somebody else, or where they are not known."""
    if name == "acer" and options is not None:
        from apel.learners.deep.acer_options import PRESETS

        preset = {"enum": sorted(PRESETS), "description": "Where the other options' defaults come from."}
        return options | {"properties": {"preset": preset, **options["properties"]}}
    if options is not None:
        return options
    try:
        made = load(str(LEARNERS[name]))
    except ValueError:
        return {"additionalProperties": True}
    known = [one for one in keywords_of(made) if one not in _MADE_WITH]
    return _described({"properties": {option: {} for option in known}, "additionalProperties": True}, made)


def _one(name: str | None, spec: Schema, options: Schema) -> Schema:
    """The alternative of a learner or selector; without a name, of those by import path, which take any option."""
    named = {"const": name, "description": options.get("description", "")} if name else _IMPORT_PATH
    is_open = name is None or options.get("additionalProperties", False) is True
    return {
        "title": name or "by import path",
        "type": "object",
        "properties": {**options.get("properties", {}), **spec["properties"], "type": named},
        "required": ["type"],
        "additionalProperties": is_open,
    }


def _whole(part: Schema, definitions: Mapping[str, Schema], kind: Any) -> Schema:
    """A part that may be a reference, as what it refers to, its properties described."""
    reference = part.get("$ref", "").rpartition("/")[2]
    return _described(dict(definitions[reference]) if reference else part, kind)


def _described(schema: Schema, kind: Any) -> Schema:
    """With what the docstring says of its fields at each of them; only its first paragraph stays."""
    text = schema.get("description", "")
    if kind is not None:
        ours = [one for one in kind.__mro__ if one.__doc__ and not one.__module__.startswith(("pydantic", "builtins"))]
        text = "\n\n".join(inspect.cleandoc(one.__doc__) for one in ours)
    about = _about_fields(text)
    properties = {
        name: {"description": about[name], **one} if name in about else one
        for name, one in schema.get("properties", {}).items()
    }
    described = schema | ({"properties": properties} if properties else {})
    if text:
        described["description"] = _plain(text.partition("\n\n")[0])
    return described


def _about_fields(text: str) -> dict[str, str]:
    found: dict[str, str] = {}
    for names, about in _ENTRY.findall(f"{text}\n"):
        for name in names.split(","):
            found.setdefault(name.strip(), _plain(about))
    return found


def _plain(text: str) -> str:
    return " ".join(text.replace("``", "").split())


def _with_variables(schema: Schema) -> Schema:
    """The same, but that ``$name`` may stand for every value in it."""
    changed = dict(schema)
    if "properties" in schema:
        changed["properties"] = {
            name: one if name in _FIELDS else _or_variable(one) for name, one in schema["properties"].items()
        }
    return changed


def _or_variable(schema: Schema) -> Schema:
    about = {name: schema[name] for name in _ABOUT if name in schema}
    value = {name: one for name, one in schema.items() if name not in _ABOUT}
    if "properties" in value:
        value = _with_variables(value)
    return {**about, "anyOf": [value, _VARIABLE]} if value else about


def _reachable(schema: Any, definitions: Mapping[str, Schema]) -> list[str]:
    """Names of the definitions that a schema refers to, directly or not."""
    found: dict[str, None] = {}
    waiting = [schema]
    while waiting:
        match waiting.pop():
            case dict() as node:
                name = str(node.get("$ref", "")).rpartition("/")[2]
                if name and name not in found:
                    found[name] = None
                    waiting.append(definitions[name])
                waiting += node.values()
            case list() as nodes:
                waiting += nodes
    return list(found)
