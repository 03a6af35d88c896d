"""What a result rests on: versions, seeds, revision, and what each session of work took."""

from __future__ import annotations

import json
import platform
import subprocess
from collections.abc import Mapping, Sequence
from datetime import datetime
from importlib.metadata import PackageNotFoundError, packages_distributions, version
from pathlib import Path
from typing import Any

from cluster.checkpoint import digest
from jobs.experiment.plan import Plan
from jobs.experiment.spec import Experiment
from jobs.experiment.user_modules import named_modules

_PACKAGES = (
    "apel", "gymnasium", "numba", "numpy", "pandas", "pyarrow", "ray", "scipy", "stable-baselines3", "torch",
)  # fmt: skip
_CHECKSUM = "checksum"
_FIELDS: dict[str, Any] = {"seed": int, "run_seeds": list, "sessions": list}
_SESSION: dict[str, Any] = {
    "began": str, "seconds": (int, float), "placement": str, "num_cpus": int, "arms": dict, "versions": dict,
    "machine": str,
}  # fmt: skip


def new_manifest(experiment: Experiment) -> dict[str, Any]:
    """The manifest of an experiment without any work done."""
    return {"experiment": experiment.name, "identity": experiment.identity, "seed": experiment.seed, "sessions": []}


def add_session(
    manifest: dict[str, Any],
    plan: Plan,
    began: datetime,
    seconds: float,
    placement: str,
    num_cpus: int,
    arms: dict[str, dict[str, float]],
    notes: Sequence[str] = (),
) -> dict[str, Any]:
    """The manifest with one more session; ``arms`` gives seconds, steps and rounds of each arm, ``notes`` what
    people should know of it.
    """
    session = {
        "began": began.isoformat(timespec="seconds"),
        "seconds": round(seconds, 3),
        "placement": placement,
        "num_cpus": num_cpus,
        "arms": arms,
        "versions": versions(plan.experiment),
        "revision": _revision(),
        "machine": f"{platform.system()} {platform.machine()}, Python {platform.python_version()}",
    }
    if notes:
        session["notes"] = list(notes)
    return {**manifest, "run_seeds": list(plan.seeds), "sessions": [*manifest.get("sessions", []), session]}


def sealed_manifest(manifest: dict[str, Any]) -> dict[str, Any]:
    """The manifest with its checksum."""
    rest = {name: value for name, value in manifest.items() if name != _CHECKSUM}
    return {**rest, _CHECKSUM: digest(json.dumps(rest, sort_keys=True).encode())}


def checked_manifest(content: bytes) -> dict[str, Any]:
    """The manifest that a file holds. Those of older versions have no checksum.

    Raises
    ------
    ValueError
        If it is damaged, or no manifest.
    """
    try:
        manifest = json.loads(content)
    except (ValueError, RecursionError) as error:
        message = f"found no valid JSON ({error}), expected a manifest"
        raise ValueError(message) from error
    if not isinstance(manifest, dict) or not _has_form(manifest):
        message = "found JSON of another form than a manifest's"
        raise ValueError(message)
    if not all(_is_session(session) for session in manifest.get("sessions", [])):
        message = "found a session of work of another form, expected when it began, what it took, and with what"
        raise ValueError(message)
    if _CHECKSUM in manifest and sealed_manifest(manifest)[_CHECKSUM] != manifest[_CHECKSUM]:
        message = "found a damaged file, whose checksum is not that of its content"
        raise ValueError(message)
    return manifest


def _has_form(manifest: Mapping[str, Any]) -> bool:
    is_named = all(_fits(manifest.get(name), str) for name in ("experiment", "identity"))
    return is_named and all(_fits(manifest[name], kind) for name, kind in _FIELDS.items() if name in manifest)


def _fits(value: Any, kind: Any) -> bool:
    return isinstance(value, kind) and not isinstance(value, bool)


def _is_session(session: Any) -> bool:
    if not isinstance(session, dict) or not all(_fits(session.get(name), kind) for name, kind in _SESSION.items()):
        return False
    arms, known = session["arms"].values(), session["versions"].values()
    revision = session.get("revision")
    return (
        (revision is None or isinstance(revision, str))
        and all(isinstance(number, str) for number in known)
        and all(
            isinstance(arm, dict) and all(_fits(arm.get(one), (int, float)) for one in ("seconds", "steps"))
            for arm in arms
        )
    )


def arm_timings(manifest: dict[str, Any]) -> dict[str, tuple[float, float]]:
    """Seconds and steps of each arm over all sessions."""
    timings: dict[str, tuple[float, float]] = {}
    for session in manifest.get("sessions", []):
        for arm, entry in session["arms"].items():
            seconds, steps = timings.get(arm, (0.0, 0.0))
            timings[arm] = seconds + entry["seconds"], steps + entry["steps"]
    return timings


def versions(experiment: Experiment | None = None) -> dict[str, str]:
    """Versions of the packages that a result depends on, with those that the experiment names besides."""
    found = {}
    for package in sorted({*_PACKAGES, *(_named_packages(experiment) if experiment else ())}):
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            found[package] = "not installed"
    return found


def _named_packages(experiment: Experiment) -> set[str]:
    """Installed packages that import paths lead to; of a user's own modules the source counts."""
    names = set(named_modules(experiment)) - {file.removesuffix(".py").split("/")[0] for file in experiment.sources}
    if not names:
        return set()
    packages = packages_distributions()
    return {package for name in names for package in packages.get(name, ())}


def _revision() -> str | None:
    """The commit of the source tree, if this runs from one."""
    folder = Path(__file__).parent
    command = ["git", "-C", str(folder), "rev-parse", "HEAD"]
    try:
        result = subprocess.run(command, capture_output=True, text=True, timeout=5, check=False)
    except (OSError, subprocess.TimeoutExpired):
        return None
    return result.stdout.strip() or None
