"""Experiment files: those that come with the package, and a user's own."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib import resources
from pathlib import Path
from typing import Literal

import yaml

from jobs.spec import Experiment, Gallery, set_path, validate
from jobs.yaml_source import SpecError, parse

Group = Literal["tabular", "deep", "cluster"]
_FOLDERS: Mapping[Group, str] = {"tabular": "", "deep": "deep", "cluster": "cluster"}
"""Below ``experiments/``: what two cores play in an hour; with deep learners, in some hours; what wants a cluster."""


def shipped_experiments(*groups: Group) -> dict[str, str]:
    """Name → text of the experiment files that come with the package, of some groups or of all."""
    found: dict[str, str] = {}
    for group in groups or _FOLDERS:
        found |= _shipped("arms", _FOLDERS[group])
    return found


def shipped_galleries() -> dict[str, Gallery]:
    """Name → figures that need no runs."""
    found = {name: parse(text, f"{name}.yaml") for name, text in _shipped("pictures").items()}
    return {name: Gallery.model_validate(source.content) for name, source in found.items()}


def _shipped(field: str, subfolder: str = "") -> dict[str, str]:
    """Name → text of the shipped files that have a field at their top."""
    folder = resources.files("jobs") / "experiments" / subfolder
    files = sorted((file for file in folder.iterdir() if file.name.endswith(".yaml")), key=lambda file: file.name)
    texts = {file.name.removesuffix(".yaml"): file.read_text(encoding="utf-8") for file in files}
    return {name: text for name, text in texts.items() if f"\n{field}:" in text}


def load_experiment(reference: str, overrides: Sequence[str] = ()) -> Experiment:
    """The experiment of a file, or the shipped one of that name; ``overrides`` are ``path=value`` with YAML values.

    Raises
    ------
    SpecError
        If there is none, or it is not valid; one line per error.
    """
    source = parse(*_text_of(reference))
    for override in overrides:
        path, separator, value = override.partition("=")
        if not separator or not path:
            message = f"--set: found {override!r}, expected path=value"
            raise SpecError(message)
        try:
            set_path(source.content, path, yaml.safe_load(value))
        except (KeyError, yaml.YAMLError) as error:
            message = f"--set {override}: {error.args[0] if isinstance(error, KeyError) else error}"
            raise SpecError(message) from error
    return validate(source)


def shortcuts(runs: int | None, seed: int | None) -> list[str]:
    """The overrides that have options of their own.

    >>> shortcuts(20, None)
    ['runs=20']
    """
    return [f"{name}={value}" for name, value in (("runs", runs), ("seed", seed)) if value is not None]


def _text_of(reference: str) -> tuple[str, str]:
    path = Path(reference)
    if path.suffix in {".yaml", ".yml"} or "/" in reference:
        try:
            return path.read_text(encoding="utf-8"), reference
        except (OSError, UnicodeDecodeError) as error:
            message = f"{reference}: found no readable file: {getattr(error, 'strerror', None) or error}"
            raise SpecError(message) from error
    shipped = shipped_experiments()
    if reference in shipped:
        return shipped[reference], f"{reference}.yaml"
    message = f"found the experiment {reference!r}, expected a file (*.yaml) or one of {', '.join(shipped)}"
    raise SpecError(message)
