"""Experiment files: those that come with the package, and a user's own."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from importlib import resources
from pathlib import Path
from typing import Literal, get_args

from apel.numerics.near_names import did_you_mean
from jobs.experiment.overrides import refuse_swept_overrides
from jobs.experiment.paths import set_path
from jobs.experiment.spec import Experiment, Gallery, validate
from jobs.experiment.starts import with_agents
from jobs.experiment.user_modules import with_sources
from jobs.experiment.yaml_source import Source, SpecError, parse, parse_value, place_of

Group = Literal["tabular", "deep", "cluster"]
"""Folders below ``experiments/``: what two cores play in an hour; with deep learners, in some hours; what wants a
cluster.
"""
_EXPERIMENT = "experiment.yaml"
_MAX_SHOWN = 120


def shipped_experiments(*groups: Group) -> dict[str, str]:
    """Name → text of the experiment files that come with the package, of some groups or of all."""
    return shipped_texts(_EXPERIMENT, *groups)


def shipped_galleries() -> dict[str, Gallery]:
    """Name → figures that need no runs."""
    found = {name: parse(text, f"{name}/gallery.yaml") for name, text in _texts("gallery.yaml", "galleries").items()}
    return {name: Gallery.model_validate(source.content) for name, source in found.items()}


def shipped_texts(file: str, *groups: Group) -> dict[str, str]:
    """Name → text of a file in the folders of the shipped experiments, of some groups or of all, where there is one."""
    return _texts(file, *(groups or get_args(Group)))


def _texts(file: str, *folders: str) -> dict[str, str]:
    found: dict[str, str] = {}
    for folder in folders:
        places = (resources.files("jobs") / "experiments" / folder).iterdir()
        for place in sorted(places, key=lambda place: place.name):
            if (text := place / file).is_file():
                found[place.name] = text.read_text(encoding="utf-8")
    return found


def load_experiment(reference: str, overrides: Sequence[str] = ()) -> Experiment:
    """The experiment of a file, or the shipped one of that name; ``overrides`` are ``path=value`` with YAML values.

    Raises
    ------
    SpecError
        If there is none, or it is not valid; one line per error.
    """
    source = parse(*_text_of(reference))
    in_file = copy.deepcopy(source.content)
    for override in overrides:
        _override(source, override)
    refuse_swept_overrides(source, in_file)
    return with_agents(with_sources(validate(source)))


def _override(source: Source, override: str) -> None:
    path, separator, text = override.partition("=")
    if not separator or not path:
        message = f"--set: found {override!r}, expected path=value"
        raise SpecError(message)
    option = f"--set {override}" if len(override) < _MAX_SHOWN else f"--set {override[:_MAX_SHOWN]}…"
    place = place_of(path)
    try:
        set_path(source.content, path, parse_value(text, option, place))
    except KeyError as error:
        message = f"{option}: {error.args[0]}"
        raise SpecError(message) from error
    source.overrides[place] = option


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
        return shipped[reference], f"{reference}/{_EXPERIMENT}"
    expected = f"a file (*.yaml) or one of {', '.join(shipped)}{did_you_mean(reference, shipped)}"
    message = f"found the experiment {reference!r}, expected {expected}"
    raise SpecError(message)
