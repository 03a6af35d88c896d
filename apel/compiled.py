"""The one place that asks numba to compile.

Two needs of this project are not met by a bare ``numba.njit``:

* A cached function is not recompiled when a function *it calls* changes in another file. The cache therefore lives in a
  folder named after a digest of the whole package, so that no stale machine code is ever run.
* A compiled streak must call whichever selector the experiment names. Passing a dispatcher specialises (and so
  recompiles, in every process) the caller for each selector; a function pointer with a fixed signature does not.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable
from contextlib import suppress
from functools import cached_property, partial
from pathlib import Path
from types import FunctionType
from typing import Any

import numba
from numba import types

_PACKAGE = Path(__file__).parent


def _source_digest() -> str:
    digest = hashlib.sha256(numba.__version__.encode())
    for path in sorted(_PACKAGE.rglob("*.py")):
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


def _cache_folder() -> Path | None:
    """A folder of the package that this process may write to, or None for numba's own choice."""
    parent = _PACKAGE / "__pycache__"
    folder = parent / f"numba-{_source_digest()}"
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        return None
    return folder if os.access(folder, os.W_OK) else None


if not numba.config.CACHE_DIR and (_folder := _cache_folder()) is not None:
    numba.config.CACHE_DIR = str(_folder)


def _mark(name: str) -> Path:
    return Path(numba.config.CACHE_DIR or _PACKAGE) / f"compiled-{name}"


def is_compiled(name: str) -> bool:
    """Whether `mark_compiled` was called with this name for this very code before."""
    return _mark(name).exists()


def mark_compiled(name: str) -> None:
    """Remember that all that ``name`` needs has been compiled, and is in the cache."""
    with suppress(OSError):
        _mark(name).touch()


# error_model="numpy": a division by zero gives inf as in NumPy instead of a branch and an exception in the inner loops.
njit: Callable[..., Any] = partial(numba.njit, cache=True, error_model="numpy")


@njit
def _call(function: Any, *arguments: Any) -> Any:
    return function(*arguments)


class KernelFunction(types.WrapperAddressProtocol):  # type: ignore[misc]
    """A compiled function that is passed by address, and is still callable from Python.

    Parameters
    ----------
    function:
        A plain Python function that numba can compile and that raises nothing.
    signature:
        Its numba signature; the same for all functions that may stand in each other's place.
    """

    def __init__(self, function: FunctionType, signature: Any) -> None:
        self._function = function
        self._signature = signature
        self.__doc__ = function.__doc__

    @cached_property
    def _pointer(self) -> Any:
        return numba.cfunc(self._signature, cache=True, error_model="numpy")(self._function)

    def __call__(self, *arguments: Any) -> Any:
        """Call the compiled function from Python."""
        # Through its address, like everybody else: a second compilation for Python alone would cost as much again.
        return _call(self, *arguments)

    def __wrapper_address__(self) -> int:
        """Address for numba."""
        return int(self._pointer.address)

    def signature(self) -> Any:
        """Signature for numba."""
        return self._signature
