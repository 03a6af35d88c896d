"""The modules of a user's own that an experiment rests on: what it names, and what that imports."""

from __future__ import annotations

import ast
import hashlib
import re
import sys
import sysconfig
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from jobs.experiment.spec import Experiment
from jobs.experiment.yaml_source import SpecError

OURS = ("apel", "cluster", "jobs")
"""Our own packages, which no module of a user's may be called."""
_IMPORT_PATH = re.compile(r"^([A-Za-z_]\w*(?:\.\w+)*):[A-Za-z_]")
_NAMING = ("environment", "learners", "performance", "variables", "sweep")
_INSTALLED = tuple({Path(sysconfig.get_path(name)) for name in ("stdlib", "platstdlib", "purelib", "platlib")})
_DIGITS = 16


def named_modules(experiment: Experiment) -> list[str]:
    """The top-level modules of all import paths in an experiment, sorted: nothing else of a user's is ever imported.

    They may stand wherever a value may: environment, learners and selectors with all their options, the performance
    measure, variables and sweeps.
    """
    return sorted({path.split(".")[0] for path in named_paths(experiment)} - set(OURS))


def local_modules(names: Sequence[str], folder: Path) -> list[Path]:
    """The files and packages in ``folder`` that are those modules, and those that they import from it.

    Modules that are not there are expected to be installed on the cluster.

    Raises
    ------
    SpecError
        If one of them is no Python.
    """
    waiting, found = list(names), dict[str, Path]()
    while waiting:
        name = waiting.pop()
        path = _module_at(folder, name)
        if path is None or name in found:
            continue
        found[name] = path
        for file in [path] if path.is_file() else sorted(path.rglob("*.py")):
            waiting += [imported.split(".")[0] for imported in _imported(file, "", strict=True)]
    return [found[name] for name in sorted(found)]


def with_sources(experiment: Experiment, folders: Sequence[Path] | None = None) -> Experiment:
    """The experiment with the digests of the files that it rests on, as they are now in ``folders``.

    Without folders: in the current one, and where else Python looks, but for what is installed, whose versions are in
    the manifest.
    """
    found = source_digests(sorted(named_paths(experiment)), python_folders() if folders is None else folders)
    found |= {name: digest for name, digest in experiment.sources.items() if ":" in name}  # of a script's own objects
    return experiment if found == experiment.sources else experiment.model_copy(update={"sources": found})


def source_digests(modules: Sequence[str], folders: Sequence[Path]) -> dict[str, str]:
    """File → digest of each of the modules that lies in ``folders``, and of what it imports from the same folder."""
    waiting, seen, found = list(modules), set[str](), dict[str, str]()
    roots: dict[str, Path | None] = {}
    while waiting:
        module = waiting.pop()
        top = module.split(".")[0]
        if module in seen or top in (*OURS, "__main__"):
            continue
        seen.add(module)
        root = roots.setdefault(top, next((folder for folder in folders if _module_at(folder, top)), None))
        if root is None or is_installed_in(root):
            continue
        for name, file in _files_of(root, module):
            key = file.relative_to(root).as_posix()
            if key not in found:
                found[key] = _digest(file)
                waiting += _imported(file, name, strict=False)
    return dict(sorted(found.items()))


def python_folders() -> list[Path]:
    """Where Python looks for modules, the working directory first."""
    return [Path.cwd(), *(Path(entry) for entry in sys.path if entry and Path(entry).is_dir())]


def is_installed_in(folder: Path) -> bool:
    """Whether Python or an installed package lies there."""
    return any(folder == place or place in folder.parents for place in _INSTALLED)


def named_paths(experiment: Experiment) -> set[str]:
    """The modules of all import paths in an experiment."""
    content = experiment.model_dump(mode="json")
    naming = [content[field] for field in _NAMING]
    naming += [arm["selector"] for arm in content["arms"].values()]
    return {match[1] for text in _texts(naming) if (match := _IMPORT_PATH.match(text))}


def _texts(node: Any) -> Iterator[str]:
    match node:
        case str():
            yield node
        case dict():
            for value in node.values():
                yield from _texts(value)
        case list() | tuple():
            for value in node:
                yield from _texts(value)


def _module_at(folder: Path, name: str) -> Path | None:
    if (folder / name / "__init__.py").is_file():
        return folder / name
    if (folder / f"{name}.py").is_file():
        return folder / f"{name}.py"
    return folder / name if any((folder / name).glob("**/*.py")) else None


def _files_of(root: Path, module: str) -> Iterator[tuple[str, Path]]:
    """The file of a module, and those of the packages that it lies in, each with the package of its own imports."""
    folder, package = root, ""
    for part in module.split("."):
        inner = f"{package}.{part}".lstrip(".")
        if (folder / part / "__init__.py").is_file():
            yield inner, folder / part / "__init__.py"
        elif (folder / f"{part}.py").is_file():
            yield package, folder / f"{part}.py"
            return
        elif not (folder / part).is_dir():
            return
        folder, package = folder / part, inner


def _digest(file: Path) -> str:
    content = file.read_bytes().replace(b"\r\n", b"\n")  # some version controls change ends of lines
    return hashlib.sha256(content).hexdigest()[:_DIGITS]


def _imported(file: Path, package: str, *, strict: bool) -> Iterator[str]:
    """Names of what a file of ``package`` imports, wherever in it; nothing is run for that.

    ``from a import b`` may mean a module ``b``, so that both ``a`` and ``a.b`` are named.
    """
    try:
        tree = ast.parse(file.read_bytes(), str(file))
    except (SyntaxError, ValueError) as error:
        if not strict:
            return
        message = f"{file}:{getattr(error, 'lineno', 1)}: found {getattr(error, 'msg', error)}, expected Python"
        raise SpecError(message) from error
    for node in ast.walk(tree):
        match node:
            case ast.Import():
                yield from (alias.name for alias in node.names)
            case ast.ImportFrom():
                yield from _imported_from(node, package)
            case ast.Call(
                func=ast.Attribute(attr="import_module") | ast.Name(id="import_module" | "__import__"),
                args=[ast.Constant(value=str(name)), *_],
            ):
                yield name.lstrip(".")


def _imported_from(node: ast.ImportFrom, package: str) -> Iterator[str]:
    parents = package.split(".") if package else []
    if node.level and not parents:
        return  # within a package that is taken whole
    base = parents[: len(parents) - node.level + 1] if node.level else []
    module = ".".join((*base, *([node.module] if node.module else [])))
    if module:
        yield module
        yield from (f"{module}.{alias.name}" for alias in node.names)
