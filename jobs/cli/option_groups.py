"""Options that belong together, and which several commands take, as a dataclass that is written once."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator
from dataclasses import MISSING, fields, is_dataclass
from typing import Any, get_type_hints


def with_option_groups(function: Callable[..., None]) -> Callable[..., None]:
    """A command for typer from a function some of whose parameters are dataclasses.

    Every field of such a parameter becomes an option, or an argument, of the command; the function gets the dataclass.
    typer reads a command's options off its signature, so that this is all it takes.

    Raises
    ------
    TypeError
        If two groups have a field of the same name.
    """
    hints = get_type_hints(function, include_extras=True)
    groups: dict[str, Any] = {}
    flat: list[inspect.Parameter] = []
    for parameter in inspect.signature(function).parameters.values():
        kind = hints[parameter.name]
        if isinstance(kind, type) and is_dataclass(kind):
            groups[parameter.name] = kind
            flat += _options_of(kind)
        else:
            flat.append(_option(parameter.name, parameter.default, kind))

    def command(**given: Any) -> None:
        for name, group in groups.items():
            given[name] = group(**{field.name: given.pop(field.name) for field in fields(group)})
        function(**given)

    command.__name__, command.__doc__ = function.__name__, function.__doc__
    command.__annotations__ = {option.name: option.annotation for option in flat}
    if len(command.__annotations__) < len(flat):
        message = f"{function.__name__}: found an option twice, expected each once: {[option.name for option in flat]}"
        raise TypeError(message)
    command.__signature__ = inspect.Signature(flat)  # type: ignore[attr-defined]
    return command


def _options_of(group: type[Any]) -> Iterator[inspect.Parameter]:
    hints = get_type_hints(group, include_extras=True)
    for field in fields(group):
        default = inspect.Parameter.empty if field.default is MISSING else field.default
        yield _option(field.name, default, hints[field.name])


def _option(name: str, default: Any, annotation: Any) -> inspect.Parameter:
    return inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=annotation)
