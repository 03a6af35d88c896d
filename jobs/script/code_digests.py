"""Digests of classes and functions that stand in no module with a file: a script's own, and a notebook's.

What counts is what is run: the compiled code, with whatever it names (functions, classes, constants of the script,
what it closes over, defaults, what is registered with Gymnasium under an id), as all of these are at that moment; and
the files of the user's modules that it imports, before or when it is run. Comments, docstrings of functions, positions
and the rest of the script do not count, so that it may plot something else, or ask for more runs, and still go on with
its results.
Compiled code differs between minor versions of Python; under another one a script's experiment is another one.
"""

from __future__ import annotations

import dis
import functools
import hashlib
import inspect
import io
import json
import sys
from collections import defaultdict
from collections.abc import Collection, Iterable, Iterator, Mapping
from types import BuiltinFunctionType, CodeType, FunctionType, MethodType, ModuleType
from typing import Any

import cloudpickle
import numpy as np

from jobs.script.local_modules import imported_modules, is_installed, is_local
from jobs.script.registrations import Registration, own_registration

_DIGITS = 16
_MADE_BY_PYTHON = (
    "__module__", "__dict__", "__weakref__", "__doc__", "__firstlineno__", "__static_attributes__", "_abc_impl",
    "__abstractmethods__", "__dataclass_fields__", "__dataclass_params__", "__annotations__", "__annotate__",
    "__slots__",
)  # fmt: skip
_KIND = (
    inspect.CO_VARARGS | inspect.CO_VARKEYWORDS | inspect.CO_GENERATOR | inspect.CO_COROUTINE
    | inspect.CO_ITERABLE_COROUTINE | inspect.CO_ASYNC_GENERATOR
)  # fmt: skip
"""Flags that say what a function is; others say how it was compiled."""
_PLAIN = (type(None), bool, int, float, complex, str, bytes, type(...), range, np.generic, np.dtype)
_BUILTIN = (*_PLAIN, list, tuple, dict, set, frozenset, np.ndarray)
"""What is told without its class, where that is not the user's."""


class CodeReader:
    """Reads what parts of an experiment rest on.

    Attributes
    ----------
    modules:
        Names of the user's modules with files that the parts come from, that they name, or that they import when they
        are run: their files are digested whole (`jobs.experiment.user_modules`). Of ``from a import b`` there may be
        ``a.b``, too, whether or not it is a module.
    """

    def __init__(self) -> None:
        self.modules: set[str] = set()
        self._seen: dict[int, int] = {}
        self._kept: list[Any] = []
        self._open: dict[int, int] = {}
        self._outer: dict[int, int] = {}

    def digest(self, part: Any) -> str:
        """16 hexadecimal digits for a class or function."""
        self._seen.clear()
        text = json.dumps(self._told(part))
        return hashlib.sha256(text.encode()).hexdigest()[:_DIGITS]

    def _told(self, value: Any) -> Any:
        """What a value is, in lists and texts."""
        is_own = _is_own(type(value))
        if isinstance(value, _PLAIN) and not is_own:
            return [type(value).__name__, repr(value)]
        if id(value) in self._outer:
            return ["within", self._outer[id(value)]]
        if is_own or not isinstance(value, tuple | frozenset):  # of constants, those that are equal may be one or not
            if id(value) in self._seen:
                return ["again", self._seen[id(value)]]
            self._seen[id(value)] = len(self._seen)
            self._kept.append(value)  # or its identity could become another value's
            self._open[id(value)] = len(self._outer) + len(self._open)
        try:
            parts = [_plain_text(value)] if isinstance(value, _PLAIN) else self._parts(value)
            return [type(value).__name__, *parts, *self._beyond(value)]
        finally:
            self._open.pop(id(value), None)

    def _in_any_order(self, values: Collection[Any]) -> list[str]:
        """What the values of a set are, sorted, each of them told as if it were the only one: where it stands in the
        set follows from hashes, or from where it lies in memory.
        """
        return sorted(json.dumps(self._apart()._told(one)) for one in values)

    def _apart(self) -> CodeReader:
        """A reader that has seen nothing but what this one is amid of, which would have no end otherwise."""
        reader = CodeReader()
        reader.modules, reader._outer = self.modules, {**self._outer, **self._open}
        return reader

    def _parts(self, value: Any) -> Iterator[Any]:
        match value:
            case list() | tuple():
                yield from map(self._told, value)
            case dict():
                yield from ([self._told(key), self._told(inner)] for key, inner in value.items())
            case set() | frozenset():
                yield from self._in_any_order(value)
            case np.ndarray():
                told = value.tolist() if value.dtype == object else hashlib.sha256(value.tobytes()).hexdigest()
                yield from (str(value.dtype), list(value.shape), self._told(told))
            case ModuleType():
                yield value.__name__
                self._note(value.__name__)
            case functools.partial():
                yield from map(self._told, (value.func, value.args, value.keywords))
            case staticmethod() | classmethod() | MethodType():
                yield from map(self._told, (value.__func__, getattr(value, "__self__", None)))
            case property():
                yield from map(self._told, (value.fget, value.fset, value.fdel))
            case FunctionType() | type() | BuiltinFunctionType():
                yield from self._named(value)
            case _:
                yield from self._instance(value)

    def _beyond(self, value: Any) -> Iterator[Any]:
        """What a value is beyond that which it is to a builtin: how it makes items, and the user's class of it."""
        if isinstance(value, defaultdict):
            yield self._told(value.default_factory)
        if isinstance(value, _BUILTIN) and _is_own(type(value)):
            yield from map(self._told, (type(value), _attributes(value)))

    def _named(self, value: Any) -> Iterator[Any]:
        yield value.__qualname__
        self._note(value.__module__)
        if isinstance(value, BuiltinFunctionType) or is_importable(value):
            yield value.__module__
            if _is_bound(value):
                yield self._told(value.__self__)
        elif isinstance(value, FunctionType):
            yield from self._function(value)
        else:
            yield from self._class(value)

    def _function(self, function: FunctionType) -> Iterator[Any]:
        yield self._code(function.__code__, function.__doc__)
        yield from map(self._told, (function.__defaults__, function.__kwdefaults__, vars(function)))
        yield [_content(cell) and self._told(cell.cell_contents) for cell in function.__closure__ or ()]
        self._note_imports(imported_modules(function.__code__, function.__globals__.get("__package__") or ""))
        for text in sorted(set(_texts(function.__code__))):
            if (registration := own_registration(text)) is not None:
                yield [text, self._told(registration)]
        names = sorted(set(_global_names(function.__code__)))
        for name in names:
            if name in function.__globals__:
                value = function.__globals__[name]
                yield [name, self._told(value)]
                if isinstance(value, ModuleType):  # ``import package.module`` binds the package alone
                    for inner in _attribute_names(function.__code__):
                        self._note(f"{value.__name__}.{inner}")

    def _code(self, code: CodeType, doc: str | None = None) -> list[Any]:
        constants = [self._code(one) if isinstance(one, CodeType) else self._told(one) for one in code.co_consts]
        if doc is not None and code.co_consts and code.co_consts[0] == doc:
            constants = constants[1:]
        names = (code.co_names, code.co_varnames, code.co_freevars, code.co_cellvars)
        counts = (code.co_argcount, code.co_posonlyargcount, code.co_kwonlyargcount, code.co_flags & _KIND)
        return [code.co_code.hex(), code.co_exceptiontable.hex(), constants, names, counts]

    def _class(self, kind: type) -> Iterator[Any]:
        yield [self._told(base) for base in kind.__bases__]
        yield self._told(type(kind))
        yield [[name, str(annotation)] for name, annotation in inspect.get_annotations(kind).items()]
        members = {name: member for name, member in vars(kind).items() if name not in _MADE_BY_PYTHON}
        for name in sorted(members):
            is_slot = inspect.ismemberdescriptor(members[name]) or inspect.isgetsetdescriptor(members[name])
            if not is_slot and not name.startswith("__pydantic"):
                yield [name, self._told(members[name])]

    def _instance(self, value: Any) -> Iterator[Any]:
        yield self._told(type(value))
        wrapped = getattr(value, "__wrapped__", None) or getattr(value, "py_func", None)  # functools' and numba's
        if wrapped is not None:
            yield self._told(wrapped)
        elif isinstance(value, Registration):
            self._note_imports(value.modules)
            yield self._told(vars(value))
        elif not is_importable(type(value)) and ((attributes := _attributes(value)) or hasattr(value, "__dict__")):
            yield self._told(attributes)
        else:
            yield hashlib.sha256(self._pickled(value)).hexdigest()

    def _pickled(self, value: Any) -> bytes:
        with io.BytesIO() as file:
            pickler = cloudpickle.Pickler(file)
            pickler.persistent_id = self._persistent  # asked for each value what to write in its stead
            pickler.dump(value)
            return file.getvalue()

    def _persistent(self, value: Any) -> str | None:
        if isinstance(value, set | frozenset):
            return json.dumps([type(value).__qualname__, *self._in_any_order(value)])
        if not isinstance(value, type | FunctionType) or not _is_own(value):
            return None
        self._note(value.__module__)
        # Pickles of classes that cannot be imported bear a mark of the process, those of functions their lines.
        return None if is_importable(value) else json.dumps(self._told(value))

    def _note(self, module: str | None) -> None:
        if module in sys.modules and module != "__main__" and not is_installed(module):
            self.modules.add(module)

    def _note_imports(self, modules: Iterable[str]) -> None:
        self.modules |= {module for module in modules if is_local(module)}


def _is_own(part: type | FunctionType) -> bool:
    """Whether a class or function is the user's: neither Python's, nor ours, nor an installed package's."""
    module = part.__module__
    if not isinstance(module, str) or module in ("builtins", "numpy"):
        return False
    return module == "__main__" or not is_installed(module)


def _plain_text(value: Any) -> str:
    """What a plain value is to the builtin, or to NumPy's class, that its own class derives from; that may show it as
    anything.
    """
    base: Any = next(one for one in type(value).__mro__ if one in _PLAIN or one.__module__ == "numpy")
    return str(base.__repr__(value))


def _attributes(value: Any) -> dict[str, Any]:
    """What a value holds by name, in slots or not."""
    slots = [
        name for kind in type(value).__mro__ for name in vars(kind) if inspect.ismemberdescriptor(vars(kind)[name])
    ]
    return {name: getattr(value, name) for name in slots if hasattr(value, name)} | getattr(value, "__dict__", {})


def is_importable(part: Any) -> bool:
    """Whether its import path stands for this very class or function, in a module that other processes can find."""
    module = getattr(part, "__module__", None)
    found = sys.modules.get(module) if module is not None and module != "__main__" else None
    for name in getattr(part, "__qualname__", "<none>").split("."):
        found = getattr(found, name, None)
    return found is part


def _is_bound(value: Any) -> bool:
    """Whether it is a method of a value's, made by Python or in C; functions there are methods of their modules."""
    bound = value.__self__ if isinstance(value, BuiltinFunctionType) else None
    is_type = isinstance(bound, type) and is_importable(bound) and is_installed(bound.__module__)
    return bound is not None and not is_type and not isinstance(bound, ModuleType)


def _content(cell: Any) -> bool:
    try:
        return cell.cell_contents is not None
    except ValueError:  # not filled yet
        return False


def _global_names(code: CodeType) -> Iterator[str]:
    for instruction in dis.get_instructions(code):
        if instruction.opname in ("LOAD_GLOBAL", "LOAD_NAME"):
            yield instruction.argval
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield from _global_names(constant)


def _texts(code: CodeType) -> Iterator[str]:
    for constant in code.co_consts:
        if isinstance(constant, str):
            yield constant
        elif isinstance(constant, CodeType):
            yield from _texts(constant)


def _attribute_names(code: CodeType) -> Iterator[str]:
    yield from code.co_names
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield from _attribute_names(constant)


def digests_of(parts: Mapping[str, Any]) -> tuple[dict[str, str], set[str]]:
    """Name → digest of the parts that stand in no file, and the user's modules that all of them rest on."""
    reader = CodeReader()
    digests = {name: reader.digest(part) for name, part in parts.items()}
    return {name: one for name, one in digests.items() if not is_importable(parts[name])}, reader.modules
