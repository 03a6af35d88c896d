"""What a submitted job needs of the machine it is submitted from: the experiment, the user's own modules, and agents
with which it begins.
"""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from pathlib import Path

from jobs.experiment.spec import Experiment
from jobs.experiment.starts import with_paths
from jobs.experiment.yaml_source import SpecError

EXPERIMENT_FILE = "experiment.yaml"
_AGENTS = "agents"
_MAX_BYTES = 50 * 2**20
_LEFT_OUT = shutil.ignore_patterns("__pycache__", ".*", "*.pyc")


def write_package(experiment: Experiment, modules: Sequence[Path], target: Path) -> None:
    """Copy everything into the folder ``target``, which must not exist.

    Raises
    ------
    SpecError
        If it is too large to be sent.
    """
    agents = {Path(path): digest for path, digest in experiment.agents.items()}
    size = sum(file.stat().st_size for module in (*modules, *agents) for file in _files(module))
    if size > _MAX_BYTES:
        names = ", ".join(str(module) if module in agents else module.name for module in (*modules, *agents))
        message = (
            f"{names}: found {size / 2**20:.0f} MiB, expected at most {_MAX_BYTES / 2**20:.0f} MiB of modules and "
            "agents to be sent with a job: install modules on the cluster's nodes, or keep data out of their folders"
        )
        raise SpecError(message)
    target.mkdir(parents=True)
    if agents:
        experiment = with_paths(experiment, lambda digest: f"{_AGENTS}/{digest}")
    for path, digest in agents.items():
        shutil.copytree(path, target / _AGENTS / digest, ignore=_LEFT_OUT, dirs_exist_ok=True)
    (target / EXPERIMENT_FILE).write_text(experiment.to_yaml(), encoding="utf-8")
    for module in modules:
        if module.is_file():
            shutil.copy2(module, target / module.name)
        else:
            shutil.copytree(module, target / module.name, ignore=_LEFT_OUT)


def _files(module: Path) -> list[Path]:
    return [module] if module.is_file() else [path for path in module.rglob("*") if path.is_file()]
