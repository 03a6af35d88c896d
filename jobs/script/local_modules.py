"""The user's own modules: which they are, where they lie, and which of them compiled code imports when it is run."""

from __future__ import annotations

import dis
import importlib.util
import sys
from collections.abc import Iterator
from importlib.machinery import ModuleSpec
from pathlib import Path
from types import CodeType
from typing import Any

from jobs.experiment.user_modules import OURS, is_installed_in

_IMPORTERS = {"import_module", "__import__"}


def is_installed(module: str) -> bool:
    """Whether a module that has been imported is Python's, ours, or an installed package's."""
    file = getattr(sys.modules.get(module), "__file__", None)
    return module.split(".")[0] in OURS or file is None or is_installed_in(Path(file).resolve())


def is_local(module: str) -> bool:
    """Whether a module is the user's own and has a file; nothing is imported to find it out."""
    if module == "__main__":
        return False
    if module in sys.modules:
        return not is_installed(module)
    top = module.split(".")[0]
    place = None if top in (*OURS, "__main__") else _place(top)
    return place is not None and not is_installed_in(place)


def folder_of(module: str) -> Path:
    """The folder in which the top-level module or package of a local module (`is_local`) lies."""
    file = getattr(sys.modules.get(module), "__file__", None)
    if file is None and (place := _place(module.split(".")[0])) is not None:
        return place.parent
    path = Path(str(file)).resolve()
    return path.parents[module.count(".") + (path.name == "__init__.py")]


def imported_modules(code: CodeType, package: str) -> Iterator[str]:
    """Names of what code of ``package`` imports when it is run, wherever in it.

    ``from a import b`` may mean a module ``b``, so that both ``a`` and ``a.b`` are named; where a module is imported by
    a name that is a value, every text in the code may be that name.
    """
    level, names = None, None
    for instruction in dis.get_instructions(code):
        if instruction.opname == "IMPORT_NAME":
            yield from _imported(instruction.argval, level, names, package)
        if instruction.opname != "EXTENDED_ARG":
            level, names = names, instruction.argval
    if _IMPORTERS & set(code.co_names):
        yield from (one.lstrip(".") for one in code.co_consts if isinstance(one, str))
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield from imported_modules(constant, package)


def _imported(name: str, level: Any, names: Any, package: str) -> Iterator[str]:
    """What an instruction imports; ``level`` and ``names`` are the constants that were loaded before it."""
    parents = package.split(".") if package else []
    depth = level if isinstance(level, int) else 0
    base = parents[: len(parents) - depth + 1] if depth else []
    module = ".".join((*base, *([name] if name else [])))
    if module:
        yield module
        yield from (f"{module}.{one}" for one in (names if isinstance(names, tuple) else ()) if one != "*")


def _place(top: str) -> Path | None:
    """The file of a top-level module, or the folder of a package; None where there is none."""
    spec = _spec(top)
    if spec is None:
        return None
    folders = list(spec.submodule_search_locations or ())
    file = folders[0] if folders else spec.origin if spec.has_location else None
    return None if file is None else Path(file).resolve()


def _spec(top: str) -> ModuleSpec | None:
    try:
        return importlib.util.find_spec(top) if top.isidentifier() else None
    except (ImportError, ValueError):  # of a module that somebody has made without a file
        return None
