"""Writes the pages of the reference that are read off the code: the commands, and the fields of an experiment file.

python docs/generate_reference.py
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import typer.main
from typer.core import TyperArgument, TyperCommand

from jobs.cli.commands import COMMANDS, loaded
from jobs.cli.main import app
from jobs.experiment.schema import experiment_schema

REFERENCE = Path(__file__).parent / "reference"
TITLES = {
    "experiment_commands": "Experiments",
    "run_commands": "Runs",
    "job_commands": "Jobs on a cluster",
    "result_commands": "Results",
    "agent_commands": "Trained agents",
    "doctor_command": "The installation",
}
_BOUNDS = {"minimum": "≥", "exclusiveMinimum": ">", "maximum": "≤", "exclusiveMaximum": "<"}
_VARIABLE = r"^\$"
_IMPORT_PATH = r"^[^:\s]+:[^:\s]+$"


def main() -> None:
    """Write all pages."""
    for name, text in pages().items():
        (REFERENCE / name).write_text(text)


def pages() -> dict[str, str]:
    """File name → text."""
    return {"commands.md": commands_page(), "experiment-file.md": experiment_page(experiment_schema())}


def commands_page() -> str:
    """Every command with its arguments and options."""
    group = typer.main.get_command(app)
    context = typer.Context(group, info_name="apel")
    lines = ["# Commands", "", "What `apel COMMAND --help` says, on one page.", ""]
    lines += ["Exit codes: 0 done, 1 a run failed, 2 bad input, 130 interrupted.", ""]
    lines += ["Options of `apel` itself:", "", *_options(group, context)]
    for module, names in COMMANDS.items():
        lines += ["", f"## {TITLES[module]}"]
        for name in names:
            lines += _command(name, loaded(name, module), context)
    return "\n".join(lines) + "\n"


def _command(name: str, command: TyperCommand, context: Any) -> Iterator[str]:
    inner = typer.Context(command, info_name=name, parent=context)
    usage = " ".join(["apel", name, *command.collect_usage_pieces(inner)])
    yield from ("", f"### apel {name}", "", "```text", usage, "```", "", _paragraphs(command.help or ""), "")
    yield from _options(command, inner)


def _options(command: Any, context: Any) -> list[str]:
    rows = ["| argument or option | default | meaning |", "|---|---|---|"]
    for parameter in command.params:
        if not parameter.hidden:
            meaning = _cell(parameter.help or "") + (f" ({parameter.envvar})" if parameter.envvar else "")
            rows.append(f"| {_names(parameter, context)} | {_default(parameter)} | {meaning} |")
    return rows if len(rows) > 2 else []


def _names(parameter: Any, context: Any) -> str:
    if isinstance(parameter, TyperArgument):
        return f"`{parameter.display_name_raw}`".replace("|", "\\|")
    kind = "" if parameter.is_flag else f" {parameter.metavar or parameter.display_type_rich(ctx=context)}"
    names = [*parameter.opts, *parameter.secondary_opts]
    return ", ".join(f"`{name}{kind}`".replace("|", "\\|") for name in names)


def _default(parameter: Any) -> str:
    if parameter.required:
        return "required"
    if isinstance(parameter.show_default, str):
        return _cell(parameter.show_default)
    value = parameter.default
    if callable(value) or value is None or value is False or value in ((), [], "") or not parameter.show_default:
        return ""
    return "on" if value is True else f"`{value}`"


def experiment_page(schema: Mapping[str, Any]) -> str:
    """Every field of an experiment file, with the options of every learner and selector."""
    definitions = schema["$defs"]
    lines = [
        "# The experiment file",
        "",
        "Every field, read off the classes that check the file. `apel schema` prints the same as a JSON schema, with",
        "which editors complete fields.",
        "[A first experiment](../guide/1-first-experiment.md) explains a file step by step.",
        "",
        "An option of a learner may also be one of the `variables`, such as `$dropped`, which are drawn for each run.",
        "",
        "## Experiment",
        "",
        *_table(schema),
        "",
        "## Learners",
        "",
        "Each entry of `learners` is one of these, by its `type`. All of them also have:",
        "",
        *_table(_common(definitions["LearnerSpec"]["oneOf"])),
    ]
    shared = set(_common(definitions["LearnerSpec"]["oneOf"])["properties"])
    lines += _kinds(definitions["LearnerSpec"]["oneOf"], shared)
    representation = definitions["LearnerSpec"]["oneOf"][-1]["properties"]["representation"]
    lines += ["", "### Representation", "", *_about(representation), *_table(representation)]
    lines += [
        "",
        "## Selectors",
        "",
        "The `selector` of an arm is one of these, by its `type`; [Selectors](../selectors.md) has rules and sources.",
    ]
    lines += ["All of them also have:", "", *_table(_common(definitions["SelectorSpec"]["oneOf"]))]
    lines += _kinds(definitions["SelectorSpec"]["oneOf"], {"acting_floor"})
    lines += ["", "## Parts", "", "What the tables above name."]
    for name, part in definitions.items():
        if name not in ("LearnerSpec", "SelectorSpec"):
            lines += ["", f"### {name}", "", *_about(part), *_table(part)]
    return "\n".join(lines) + "\n"


def _common(kinds: list[Any]) -> dict[str, Any]:
    named, by_path = kinds[:-1], kinds[-1]
    shared = {
        key: field for key, field in by_path["properties"].items() if all(key in kind["properties"] for kind in named)
    }
    shared.pop("type")
    return {"properties": shared}


def _kinds(kinds: list[Any], shared: set[str]) -> Iterator[str]:
    for kind in kinds:
        own = {key: field for key, field in kind["properties"].items() if key not in shared and key != "type"}
        title = "By import path" if kind["title"] == "by import path" else f"`{kind['title']}`"
        about = kind["properties"]["type"].get("description", "")
        if kind["title"] == "by import path":
            about = "A class of your own: `type` is `module:Class`, and its options are the other fields."
        yield from ("", f"### {title}", "", _paragraphs(about), "", *_table({**kind, "properties": own}))


def _about(part: Mapping[str, Any]) -> list[str]:
    return [_paragraphs(part["description"]), ""] if "description" in part else []


def _table(part: Mapping[str, Any]) -> list[str]:
    rows = ["| field | values | default | meaning |", "|---|---|---|---|"]
    required = part.get("required", ())
    for name, field in part.get("properties", {}).items():
        default = "required" if name in required else _value(field["default"]) if "default" in field else ""
        rows.append(f"| `{name}` | {_values(field)} | {default} | {_cell(field.get('description', ''))} |")
    return rows if len(rows) > 2 else []


def _value(value: Any) -> str:
    if value is None or value in ("", [], {}):
        return ""
    return f"`{str(value).lower() if isinstance(value, bool) else value}`"


def _values(field: Mapping[str, Any]) -> str:
    """What may stand there, in words."""
    if "$ref" in field:
        name = field["$ref"].rpartition("/")[2]
        place = {"LearnerSpec": "learner", "SelectorSpec": "selector"}.get(name, name)
        return f"[{place}](#{ {'LearnerSpec': 'learners', 'SelectorSpec': 'selectors'}.get(name, name.lower()) })"
    if "anyOf" in field or "oneOf" in field:
        kinds = [_values(kind) for kind in field.get("anyOf", field.get("oneOf")) if kind.get("pattern") != _VARIABLE]
        return " or ".join(dict.fromkeys(kind for kind in kinds if kind))
    if "enum" in field:
        known = [f"`{value}`" for value in field["enum"]]
        return ", ".join(known) if len(known) < 12 else "a known id"
    if "const" in field:
        return f"`{field['const']}`"
    if field.get("title") == "Representation":
        return "[representation](#representation)"
    return _of_type(field)


def _of_type(field: Mapping[str, Any]) -> str:
    kind = field.get("type")
    if kind in ("number", "integer"):
        bounds = [f"{sign} {_number(field[key])}" for key, sign in _BOUNDS.items() if key in field]
        return " ".join(["number" if kind == "number" else "whole number", ", ".join(bounds)]).strip()
    if kind == "array":
        inner = field.get("prefixItems") or [field.get("items", {})]
        return "list of " + ", ".join(_values(one) or "values" for one in inner)
    if kind == "object" and "properties" in field:
        return "fields"
    if kind == "object":
        inner = next(iter(field.get("patternProperties", {}).values()), field.get("additionalProperties", {}))
        return f"names, each with {_values(inner) or 'a value'}" if isinstance(inner, Mapping) else "names and values"
    if field.get("pattern") == _IMPORT_PATH:
        return "`module:name`"
    return {"string": "text", "boolean": "`true` or `false`", "null": ""}.get(str(kind), "")


def _number(value: float) -> str:
    return f"{value:,}".replace(",", " ") if isinstance(value, int) and value < 10**9 else f"{value:g}"


def _cell(text: str) -> str:
    return " ".join(_paragraphs(text).split()).replace("|", "\\|")


def _paragraphs(text: str) -> str:
    """A docstring as Markdown."""
    return re.sub(r"``([^`]+)``", r"`\1`", inspect.cleandoc(text).replace("\b\n", "")).replace("<", "&lt;")


if __name__ == "__main__":
    main()
