"""Whether an object does what its class was written to do, or something that was put in the place of it."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from types import FunctionType
from typing import Generic

_HARMLESS = frozenset(
    {"__init__", "__module__", "__qualname__", "__doc__", "__annotations__", "__dict__", "__weakref__"}
    | {"__parameters__", "__orig_bases__", "__firstlineno__", "__static_attributes__", "metadata", "render", "close"}
)
"""What a subclass may define without playing otherwise: how it is made, drawn and closed."""

_PLAYING = ("reset", "step")


def replacement_in(thing: object, known: type) -> str | None:
    """The first method in whose place something else was put, of ``thing`` or of its class ``known``, in words; None
    where there is none.
    """
    for name in vars(thing):
        if callable(getattr(type(thing), name, None)):
            return f"its {name} was replaced"
    return replacement_in_class(known)


def replacement_in_class(known: type) -> str | None:
    """The same of a class alone.

    A method must be the function of that name that the source file of its class defines, and those that play call the
    functions of their own package.
    """
    for owner in known.__mro__:
        if owner in (object, Generic):
            continue
        for name, function in _functions(owner):
            if not _is_of(owner, name, function):
                return f"{owner.__name__}.{name} was replaced"
    return None


def override_in(kind: type, known: type) -> str | None:
    """What the class ``kind`` defines that ``known``, of which it is a subclass, has or might look at; None where that
    is nothing, so that both play alike once they are made.
    """
    inherited = frozenset(dir(known))
    for owner in kind.__mro__:
        if owner in known.__mro__:
            continue
        for name, member in vars(owner).items():
            is_new = name not in inherited and not name.startswith("__")
            is_function = isinstance(member, FunctionType | staticmethod | classmethod)
            if name not in _HARMLESS and not (is_new and is_function):
                return f"{owner.__name__} {'defines' if is_new else 'overrides'} {name}"
    return None


def _functions(owner: type) -> Iterator[tuple[str, FunctionType]]:
    for name, member in vars(owner).items():
        match member:
            case FunctionType():
                yield name, member
            case staticmethod() | classmethod():
                if isinstance(member.__func__, FunctionType):
                    yield name, member.__func__
            case property():
                yield from ((name, part) for part in (member.fget, member.fset) if isinstance(part, FunctionType))


def _is_of(owner: type, name: str, function: FunctionType) -> bool:
    package = owner.__module__.partition(".")[0]
    called = [function.__globals__.get(one) for one in function.__code__.co_names] if name in _PLAYING else []
    return (
        _is_from(owner.__module__, function)
        and function.__code__.co_qualname == f"{owner.__qualname__}.{name}"
        and all(
            _is_from(one.__module__, one) and one.__module__.partition(".")[0] == package
            for one in called
            if isinstance(one, FunctionType)
        )
    )


def _is_from(module: str, function: FunctionType) -> bool:
    return function.__code__.co_filename == getattr(sys.modules.get(module), "__file__", None)
