"""What results rest on besides the experiment file: users' source, and versions. A difference is told."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import suppress
from typing import Any

from jobs.experiment.spec import Experiment, validate
from jobs.experiment.user_modules import with_sources
from jobs.experiment.yaml_source import SpecError, parse
from jobs.results.manifest import versions
from jobs.results.places import joined
from jobs.results.storage import Folder

_SPEC_FILE = "spec.yaml"


def of_other_sources(experiment: Experiment, root: str) -> Iterator[str]:
    """A word for each folder of results of the same experiment that rest on other source of the user's modules."""
    if not experiment.sources:
        return
    folder = Folder(joined(root, experiment.name))
    for name in folder.names():
        identity, _, file = name.partition("/")
        if file != _SPEC_FILE or identity == experiment.identity:
            continue
        with suppress(SpecError, FileNotFoundError, UnicodeDecodeError):
            other = validate(parse(folder.read(name).decode(), folder.location(name)))
            if other.model_copy(update={"sources": experiment.sources}).identity == experiment.identity:
                yield (
                    f"{folder.location(identity)} holds results of other source: {_difference(other, experiment)}; "
                    "they stay as they are, and everything is computed again beside them"
                )


def of_changed_sources(experiment: Experiment) -> list[str]:
    """A word where the modules that stored results rest on are others by now, or cannot be found from here."""
    now = with_sources(experiment)
    if now.sources == experiment.sources:
        return []
    return [f"these results rest on other source than what is here: {_difference(experiment, now)}"]


def _difference(other: Experiment, experiment: Experiment) -> str:
    before, now = other.sources, experiment.sources
    if not before:
        return "which one was not noted then"
    changed = sorted(name for name in before.keys() & now.keys() if before[name] != now[name])
    parts = [f"{', '.join(changed)} changed since"] if changed else []
    parts += [f"{', '.join(sorted(now.keys() - before.keys()))} came in"] if now.keys() - before.keys() else []
    parts += [f"{', '.join(sorted(before.keys() - now.keys()))} dropped out"] if before.keys() - now.keys() else []
    return ", ".join(parts)


def of_other_versions(experiment: Experiment, manifest: Mapping[str, Any]) -> list[str]:
    """A word where packages that matter have changed since the last session of work on these results."""
    sessions = manifest.get("sessions") or [{}]
    before, now = sessions[-1].get("versions") or {}, versions(experiment)
    both = sorted(before.keys() & now.keys())
    changed = [f"{name} {before[name]} → {now[name]}" for name in both if before[name] != now[name]]
    if not changed:
        return []
    what = ", ".join(changed)
    return [f"the last session of these results had other versions: {what}; --fresh computes all with those of now"]
