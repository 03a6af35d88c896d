"""From classes, functions and options to an experiment: what a script hands over, under names."""

from __future__ import annotations

import dataclasses
import inspect
import re
from collections.abc import Callable, Mapping
from typing import Any

import cloudpickle
import gymnasium

from apel.building.registry import LEARNERS, METRICS, SELECTORS
from apel.configs import Named, name_of
from apel.run.user_code import in_a_line
from jobs.experiment.spec import Experiment, validate
from jobs.experiment.starts import with_agents
from jobs.experiment.user_modules import named_paths, python_folders, source_digests
from jobs.experiment.yaml_source import Source, SpecError
from jobs.script.code_digests import digests_of, is_importable
from jobs.script.local_modules import folder_of, is_installed
from jobs.script.registrations import own_registration

Described = str | Callable[..., Any] | Mapping[str, Any]
"""A part by name, import path, class or function; or a mapping with that and its options, as in an experiment file."""
_WHERE = "jobs.run()"
_UNFIT = re.compile(r"[\x00-\x1f\s]")


class Parts:
    """Classes and functions of a script by the names that stand for them in the experiment."""

    def __init__(self) -> None:
        self.by_name: dict[str, Named] = {}

    def described(self, place: str, given: Any, key: str, shipped: Mapping[str, Any]) -> dict[str, Any]:
        """The fields of a part; ``key`` is the one that says what it is.

        Raises
        ------
        SpecError
            If it is none.
        """
        if isinstance(given, Mapping):
            if key not in given:
                message = f"{_WHERE}: {place}: found {sorted(given)}, expected a mapping with {key!r} and its options"
                raise SpecError(message)
            return {**given, key: self.named(f"{place}.{key}", given[key], shipped)}
        if dataclasses.is_dataclass(given) and not isinstance(given, type) and "selector" in place:
            options = {one.name: getattr(given, one.name) for one in dataclasses.fields(given) if one.init}
            return {key: self.named(place, type(given), shipped), **options}
        return {key: self.named(place, given, shipped)}

    def named(self, place: str, given: Any, shipped: Mapping[str, Any]) -> str:
        """The name of a part.

        Raises
        ------
        SpecError
            If it is no text and cannot be called, or cannot be sent to another process.
        """
        if isinstance(given, str):
            return given
        if not callable(given) or isinstance(given, gymnasium.Env):
            message = f"{_WHERE}: {place}: found {type(given).__name__}, expected a name, or what makes one: a class, …"
            raise SpecError(message)
        key = next((name for name, one in shipped.items() if one is given), None)
        if key is not None:
            return key
        if is_importable(given) and is_installed(given.__module__):
            return name_of(given)
        _refuse_unsendable(place, given)
        name = _UNFIT.sub("_", name_of(given))
        while self.by_name.get(name, given) is not given:
            name += "'"
        self.by_name[name] = given
        return name


def described_experiment(
    fields: Mapping[str, Any],
    environment: Described,
    learners: Mapping[str, Described],
    selector: Any,
    performance: Any,
    *,
    alone: bool,
) -> tuple[Experiment, set[str]]:
    """The experiment, and the user's modules with files that it rests on; not all of them have been imported.

    Raises
    ------
    SpecError
        If something is none of what is expected.
    """
    if not isinstance(learners, Mapping) or not learners:
        message = f"{_WHERE}: learners: found {learners!r}, expected a mapping from names to learners"
        raise SpecError(message)
    parts = Parts()
    names = list(learners)
    content = {name: value for name, value in fields.items() if value is not None}
    content["environment"] = parts.described("environment", environment, "id", {})
    content["learners"] = {
        name: parts.described(f"learners.{name}", one, "type", LEARNERS) for name, one in learners.items()
    }
    content["performance"] = parts.named("performance", performance, METRICS)
    content["arms"] = {name: {"learners": [name]} for name in names if alone or len(names) == 1}
    content["plots"] = [{"kind": "curves", "name": "returns", "panels": ["return"], "smooth": 5}]
    if len(names) > 1:
        ensemble = "ensemble" if "ensemble" not in names else "ensemble_of_all"
        chosen = parts.described("selector", selector, "type", SELECTORS)
        content["arms"] = {ensemble: {"learners": names, "selector": chosen}, **content["arms"]}
        shares = {"kind": "curves", "name": "selection", "panels": ["probability"], "smooth": 5, "arms": [ensemble]}
        content["plots"].append(shares)
    return _with_digests(validate(Source(_WHERE, content), parts.by_name), parts.by_name)


def _with_digests(experiment: Experiment, parts: Mapping[str, Named]) -> tuple[Experiment, set[str]]:
    environment = experiment.environment.id
    registration = None if environment in parts else own_registration(environment)
    registered = {} if registration is None else {f"gymnasium.registry:{environment}": registration}
    found, modules = digests_of({**parts, **registered})
    named = {path for path in named_paths(experiment) if not any(name.startswith(f"{path}:") for name in parts)}
    folders = [*sorted({folder_of(module) for module in modules}), *python_folders()]
    found |= source_digests(sorted(modules | named), folders)
    return with_agents(experiment.model_copy(update={"sources": dict(sorted(found.items()))})), modules


def _refuse_unsendable(place: str, part: Any) -> None:
    try:
        cloudpickle.dumps(part)
    except Exception as error:
        kind = "class" if inspect.isclass(part) else "function"
        message = (
            f"{_WHERE}: {place}: found a {kind} that cannot be sent to another process ({in_a_line(error)}), expected "
            "one that names nothing of the kind: make it where it is used"
        )
        raise SpecError(message) from error
