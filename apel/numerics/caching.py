"""Where compiled functions of this project are kept, and when one is found again.

A cached function of numba's is compiled anew when its own file changes, but not when a function that *it calls* changes
in another. Here an entry is found only by whoever has the same source of all that the function can have taken in
(`apel.numerics.sources`), and lies in a folder of that source; so no stale machine code is ever run, not even where two
versions run side by side. numba's own settings, and with them the cache of other people's functions, stay as they are.
"""

from __future__ import annotations

import hashlib
import inspect
import os
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from types import CodeType, FunctionType
from typing import Any

import llvmlite
import numba
import numpy as np
from numba.core.caching import CompileResultCacheImpl, FunctionCache, _CacheLocator

from apel.numerics.sources import Sources, dotted, read_sources

_PACKAGE = Path(__file__).resolve().parents[1]
_VERSIONS = (numba.__version__, llvmlite.__version__, np.__version__)


def cache_root() -> Path | None:
    """The folder of all that is compiled: where NUMBA_CACHE_DIR says, else in the package, else of this user; None
    where this process can write to none of them.
    """
    return _first_writable(tuple(_candidates()))


def _candidates() -> Iterator[Path]:
    if numba.config.CACHE_DIR:
        yield Path(numba.config.CACHE_DIR) / _PACKAGE.name
    yield _PACKAGE / "__pycache__" / "numba"
    with suppress(RuntimeError):  # there may be no home
        yield Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / _PACKAGE.name / "numba"


@cache
def _first_writable(folders: Sequence[Path]) -> Path | None:
    for folder in folders:
        with suppress(OSError):
            folder.mkdir(parents=True, exist_ok=True)
            tempfile.TemporaryFile(dir=folder).close()
            return folder
    return None


@cache
def package_sources() -> Sources:
    """The sources of this package, read before any of its kernels is loaded."""
    root = cache_root()
    return read_sources(_PACKAGE, root / "sources.json" if root else None)


@dataclass(frozen=True)
class Origin:
    """What the functions of one file were made from.

    Attributes
    ----------
    name:
        Of the module, to be read by people.
    digest:
        Of all the source that they can have taken in, and of the versions of what compiles them.
    modules:
        Those of this package among it.
    """

    name: str
    digest: str
    modules: tuple[str, ...]

    def is_current(self) -> bool:
        """Whether the modules' files are as they were when this process began: else what it has loaded may be older."""
        return package_sources().is_current(self.modules)


def package_origin() -> Origin:
    """Of what may have taken in anything of the package."""
    sources = package_sources()
    modules = tuple(sorted(sources.modules))
    return Origin(_PACKAGE.name, sources.digest(modules, *_VERSIONS), modules)


def origin_of(py_file: str) -> Origin:
    """Of this package's file: its module and all that this imports. Of a user's: the file itself and the whole package.

    What a user's file imports from others of the user's is left out, as numba leaves it out.
    """
    path = Path(py_file).resolve()
    if path.is_relative_to(_PACKAGE) and (name := dotted(_PACKAGE, path)) in package_sources().modules:
        return _origin_of_module(name)
    origin = package_origin()
    content = path.read_bytes() if path.is_file() else b""
    digest = hashlib.sha256(origin.digest.encode() + content).hexdigest()[:16]
    return Origin(_CacheLocator.get_suitable_cache_subpath(py_file), digest, origin.modules)


@cache
def _origin_of_module(name: str) -> Origin:
    sources = package_sources()
    modules = tuple(sources.needed(name))
    return Origin(name, sources.digest(modules, *_VERSIONS), modules)


class KernelLocator(_CacheLocator):  # type: ignore[misc]
    """Tells numba where to keep a function that comes from a file: in a folder of its module and of its source."""

    def __init__(self, root: Path, py_file: str) -> None:
        self._origin = origin_of(py_file)
        self._root = root
        self._py_file = py_file  # numba names it in a warning

    def get_cache_path(self) -> str:
        """The folder."""
        return str(self._root / f"{self._origin.name}-{self._origin.digest}")

    def get_source_stamp(self) -> str:
        """What an index must have been written with."""
        return self._origin.digest

    def get_disambiguator(self) -> str:
        """Nothing that moves with an edit elsewhere in the file: `KernelCache` tells apart functions of one name."""
        return "kernel"

    @classmethod
    def from_function(cls, py_func: FunctionType, py_file: str) -> KernelLocator | None:  # noqa: ARG003 - numba's
        """The place for a function; None, and so one of numba's own, for one that no file holds."""
        root = cache_root()
        return cls(root, py_file) if root is not None and Path(py_file).is_file() else None


class _KernelCacheImpl(CompileResultCacheImpl):  # type: ignore[misc]
    _locator_classes = (KernelLocator, *CompileResultCacheImpl._locator_classes)


class KernelCache(FunctionCache):  # type: ignore[misc]
    """numba's cache of one function, whose entries are found with the source that they were made from alone."""

    _impl_class = _KernelCacheImpl

    def __init__(self, py_func: FunctionType) -> None:
        # Also where numba has been told to use other locators, whose stamps know nothing of this.
        self._origin = origin_of(inspect.getfile(py_func))
        super().__init__(py_func)

    def _load_overload(self, sig: Any, target_context: Any) -> Any:
        return super()._load_overload(sig, target_context) if self._origin.is_current() else None

    def _save_overload(self, sig: Any, data: Any) -> None:
        if self._origin.is_current():
            super()._save_overload(sig, data)

    def _index_key(self, sig: Any, codegen: Any) -> Any:
        constants = _constants(self._py_func.__code__, self._py_func.__doc__)
        return self._origin.digest, constants, super()._index_key(sig, codegen)


def _constants(code: CodeType, docstring: str | None = None) -> str:
    """What byte code, of which numba's key has a digest, only refers to."""
    constants = [_constants(one) if isinstance(one, CodeType) else one for one in code.co_consts if one != docstring]
    return repr((code.co_names, constants))
