"""The one place that asks numba to compile.

Two needs of this project are not met by a bare ``numba.njit``:

* A cached function is not recompiled when a function *it calls* changes in another file, and where it is kept is a
  setting of the whole process. Here each function has a cache of its own kind (`apel.numerics.caching`), so that no
  stale machine code is ever run, and other people's functions are cached as ever.
* A compiled streak must call whichever selector the experiment names. Passing a dispatcher specialises (and so
  recompiles, in every process) the caller for each selector; a function pointer with a fixed signature does not.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from functools import cached_property
from pathlib import Path
from types import FunctionType
from typing import Any, Literal, cast

import numba
from llvmlite import ir
from numba import types
from numba.core.caching import NullCache
from numba.core.ccallback import CFunc
from numba.core.sigutils import normalize_signature
from numba.experimental import function_type  # noqa: F401 - it teaches numba the type of a `KernelFunction`
from numba.extending import intrinsic

from apel.numerics.caching import KernelCache, cache_root, package_origin

# A division by zero gives inf as in NumPy instead of a branch and an exception in the inner loops.
_OPTIONS = {"nopython": True, "error_model": "numpy"}


def _mark(name: str) -> Path | None:
    root = cache_root()
    return root / f"compiled-{name}-{package_origin().digest}" if root else None


def is_compiled(name: str) -> bool:
    """Whether `mark_compiled` was called with this name for this very code before."""
    mark = _mark(name)
    return mark is not None and mark.exists()


def mark_compiled(name: str) -> None:
    """Remember that all that ``name`` needs has been compiled, and is in the cache."""
    mark = _mark(name)
    if mark is not None and package_origin().is_current():
        with suppress(OSError):
            mark.touch()


def njit(function: Callable[..., Any] | None = None, *, inline: Literal["never", "always"] = "never") -> Any:
    """``numba.njit`` with the cache of this project, as a decorator with or without arguments.

    With NUMBA_DISABLE_JIT, for debuggers, the function itself, which has a ``py_func`` then, too.
    """

    def compiled(function: Any) -> Any:
        if numba.config.DISABLE_JIT:
            function.py_func = function
            return function
        dispatcher = numba.jit(function, inline=inline, **_OPTIONS)
        dispatcher._cache = _cache_of(dispatcher.py_func)
        return dispatcher

    return compiled if function is None else compiled(function)


def _cache_of(function: FunctionType) -> Any:
    try:
        return KernelCache(function)
    except RuntimeError:
        return NullCache()  # it comes from no file, or no folder can be written to


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

    def __init__(self, function: Callable[..., Any], signature: Any) -> None:
        self._function = cast("FunctionType", function)
        self._signature = signature
        self.__doc__ = function.__doc__

    @cached_property
    def _pointer(self) -> Any:
        # `numba.cfunc`, with the cache of this project.
        pointer: Any = CFunc(self._function, normalize_signature(self._signature), locals={}, options=_OPTIONS)
        pointer._cache = _cache_of(self._function)
        pointer.compile()
        return pointer

    def __call__(self, *arguments: Any) -> Any:
        """Call the compiled function from Python; with NUMBA_DISABLE_JIT, the plain one."""
        if numba.config.DISABLE_JIT:
            return self._function(*arguments)
        # Through its address, like everybody else: a second compilation for Python alone would cost as much again.
        return _call(self, *arguments)

    @property
    def address(self) -> int:
        """Where it lies in this process, to be called with `caller_of`."""
        return 0 if numba.config.DISABLE_JIT else int(self._pointer.address)

    def __wrapper_address__(self) -> int:
        """Address for numba."""
        return self.address

    def signature(self) -> Any:
        """Signature for numba."""
        return self._signature


def caller_of(kernel: KernelFunction) -> Any:
    """``call(address, arguments)`` for compiled code: calls what is like ``kernel`` and lies at an address.

    A number is handed to compiled code in a nanosecond, a `KernelFunction` in fifty microseconds.
    """
    if numba.config.DISABLE_JIT:
        return lambda _, arguments: kernel(*arguments)
    wanted = normalize_signature(kernel.signature())
    argument_types, return_type = wanted

    @intrinsic
    def call(typing_context: Any, address: Any, arguments: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
            given = zip(signature.args[1], argument_types, strict=True)
            unpacked = [builder.extract_value(values[1], i) for i in range(len(argument_types))]
            cast = [context.cast(builder, value, *pair) for value, pair in zip(unpacked, given, strict=True)]
            kinds = [context.get_value_type(kind) for kind in argument_types]
            pointer = ir.FunctionType(context.get_value_type(return_type), kinds).as_pointer()
            return builder.call(builder.inttoptr(values[0], pointer), cast)

        return return_type(types.int64, arguments), generate

    return call
