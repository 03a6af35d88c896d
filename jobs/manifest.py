"""What a result rests on: versions, seeds, revision, and what each session of work took."""

from __future__ import annotations

import platform
import subprocess
from datetime import datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from apel.seeding import run_seeds
from jobs.spec import Experiment

_PACKAGES = (
    "apel", "gymnasium", "numba", "numpy", "pandas", "pyarrow", "ray", "scipy", "stable-baselines3", "torch",
)  # fmt: skip


def new_manifest(experiment: Experiment) -> dict[str, Any]:
    """The manifest of an experiment without any work done."""
    return {"experiment": experiment.name, "identity": experiment.identity, "seed": experiment.seed, "sessions": []}


def add_session(
    manifest: dict[str, Any],
    experiment: Experiment,
    began: datetime,
    seconds: float,
    placement: str,
    num_cpus: int,
    arms: dict[str, dict[str, float]],
) -> dict[str, Any]:
    """The manifest with one more session; ``arms`` gives seconds, steps and rounds of each arm."""
    session = {
        "began": began.isoformat(timespec="seconds"),
        "seconds": round(seconds, 3),
        "placement": placement,
        "num_cpus": num_cpus,
        "arms": arms,
        "versions": versions(),
        "revision": _revision(),
        "machine": f"{platform.system()} {platform.machine()}, Python {platform.python_version()}",
    }
    seeds = run_seeds(experiment.seed, experiment.runs)
    return {**manifest, "run_seeds": seeds, "sessions": [*manifest["sessions"], session]}


def arm_timings(manifest: dict[str, Any]) -> dict[str, tuple[float, float]]:
    """Seconds and steps of each arm over all sessions."""
    timings: dict[str, tuple[float, float]] = {}
    for session in manifest.get("sessions", []):
        for arm, entry in session["arms"].items():
            seconds, steps = timings.get(arm, (0.0, 0.0))
            timings[arm] = seconds + entry["seconds"], steps + entry["steps"]
    return timings


def versions() -> dict[str, str]:
    """Versions of the packages that a result depends on."""
    found = {}
    for package in _PACKAGES:
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            found[package] = "not installed"
    return found


def _revision() -> str | None:
    """The commit of the source tree, if this runs from one."""
    folder = Path(__file__).parent
    command = ["git", "-C", str(folder), "rev-parse", "HEAD"]
    try:
        result = subprocess.run(command, capture_output=True, text=True, timeout=5, check=False)
    except (OSError, subprocess.TimeoutExpired):
        return None
    return result.stdout.strip() or None
