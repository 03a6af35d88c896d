"""What a submitted job needs of the machine it is submitted from: the experiment, and the user's own modules."""

from __future__ import annotations

import ast
import re
import shutil
from collections.abc import Iterator, Sequence
from pathlib import Path

from cluster.storage import has_credentials, redacted
from jobs.spec import Experiment
from jobs.yaml_source import SpecError

EXPERIMENT_FILE = "experiment.yaml"
_IMPORT_PATH = re.compile(r"^([A-Za-z_]\w*)(\.\w+)*:[A-Za-z]")
_MAX_BYTES = 50 * 2**20
_LEFT_OUT = shutil.ignore_patterns("__pycache__", ".*", "*.pyc")


def refuse_credentials(results: str) -> None:
    """Ray keeps the command line of every driver and job, and shows it to all who may list jobs.

    Raises
    ------
    SpecError
        If a place for results holds a secret.
    """
    if has_credentials(results):
        message = (
            f"--results: found credentials in {redacted(results)}, expected none: the command can be read by everybody "
            "who can see the dashboard; set AWS_ACCESS_KEY_ID and the like in the environment of the cluster's nodes"
        )
        raise SpecError(message)


def named_modules(experiment: Experiment) -> list[str]:
    """The top-level modules of all import paths in an experiment, sorted: nothing else of a user's is ever imported.

    They stand where learners, selectors, the environment and the performance measure are named.
    """
    names = [experiment.environment.id, experiment.performance]
    names += [learner.type for learner in experiment.learners.values()]
    names += [arm.selector.type for arm in experiment.arms.values() if arm.selector]
    names += [value for values in _swept(experiment) for value in values if isinstance(value, str)]
    return sorted({match[1] for name in names if (match := _IMPORT_PATH.match(name))})


def local_modules(names: Sequence[str], folder: Path) -> list[Path]:
    """The files and packages in ``folder`` that are those modules, and those that they import from it.

    Modules that are not there are expected to be installed on the cluster.
    """
    waiting, found = list(names), dict[str, Path]()
    while waiting:
        name = waiting.pop()
        path = _module_at(folder, name)
        if path is None or name in found:
            continue
        found[name] = path
        for file in [path] if path.is_file() else sorted(path.rglob("*.py")):
            waiting += _imported(file)
    return [found[name] for name in sorted(found)]


def write_package(experiment: Experiment, modules: Sequence[Path], target: Path) -> None:
    """Copy everything into the folder ``target``, which must not exist.

    Raises
    ------
    SpecError
        If it is too large to be sent.
    """
    size = sum(file.stat().st_size for module in modules for file in _files(module))
    if size > _MAX_BYTES:
        names = ", ".join(module.name for module in modules)
        message = (
            f"{names}: found {size / 2**20:.0f} MiB, expected at most {_MAX_BYTES / 2**20:.0f} MiB of modules to be "
            "sent with a job: install them on the cluster's nodes, or keep data out of their folders"
        )
        raise SpecError(message)
    target.mkdir(parents=True)
    (target / EXPERIMENT_FILE).write_text(experiment.to_yaml(), encoding="utf-8")
    for module in modules:
        if module.is_file():
            shutil.copy2(module, target / module.name)
        else:
            shutil.copytree(module, target / module.name, ignore=_LEFT_OUT)


def _swept(experiment: Experiment) -> Iterator[list[object]]:
    for axis in experiment.sweep.values():
        yield from [axis] if isinstance(axis, list) else axis.values()


def _module_at(folder: Path, name: str) -> Path | None:
    if (folder / f"{name}.py").is_file():
        return folder / f"{name}.py"
    return folder / name if any((folder / name).glob("**/*.py")) else None


def _imported(file: Path) -> Iterator[str]:
    """Top-level names of the modules that a file imports, wherever in it; nothing is run for that."""
    try:
        tree = ast.parse(file.read_bytes(), str(file))
    except SyntaxError as error:
        message = f"{file}:{error.lineno}: found {error.msg}, expected Python"
        raise SpecError(message) from error
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name.split(".")[0] for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            yield node.module.split(".")[0]


def _files(module: Path) -> list[Path]:
    return [module] if module.is_file() else [path for path in module.rglob("*") if path.is_file()]
