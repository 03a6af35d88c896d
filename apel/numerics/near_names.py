"""Names that are nearly right: which one was meant, for messages that refuse what was found."""

from __future__ import annotations

import dataclasses
import difflib
import inspect
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, get_args, get_origin, get_type_hints

from pydantic import BaseModel

_KEYWORD = re.compile(r"unexpected keyword argument '(\w+)'")
_SUGGESTS = re.compile("did you mean", re.IGNORECASE)


def nearest(found: object, known: Iterable[object]) -> str | None:
    """Which of the ``known`` names was probably meant; None where none of them is close.

    >>> nearest("qlearning", ["dqn", "q_learning"])
    'q_learning'
    """
    by_plain = {str(name).casefold(): str(name) for name in known}
    close = difflib.get_close_matches(str(found).casefold(), by_plain, n=1)
    return by_plain[close[0]] if close else None


def did_you_mean(found: object, known: Iterable[object]) -> str:
    """The end of a message about a name that is not among the ``known`` ones; empty where none of them is close.

    >>> did_you_mean("qlearning", ["dqn", "q_learning"])
    '; did you mean q_learning?'
    >>> did_you_mean("sarsa", ["dqn", "q_learning"])
    ''
    """
    name = nearest(found, known)
    return "" if name is None else f"; did you mean {name}?"


def keyword_meant(error: BaseException, called: Any) -> str:
    """The same for an error about an argument that ``called`` does not take, where its signature can be read."""
    unknown = _KEYWORD.search(str(error))
    if unknown is None or _SUGGESTS.search(str(error)):
        return ""
    return did_you_mean(unknown[1], keywords_of(called))


def keywords_of(called: Any) -> list[str]:
    """Names that may be given to a class or function; none where that cannot be told."""
    try:
        parameters = inspect.signature(called).parameters.values()
    except (TypeError, ValueError):
        return []
    named = (inspect.Parameter.POSITIONAL_OR_KEYWORD, inspect.Parameter.KEYWORD_ONLY)
    return [one.name for one in parameters if one.kind in named]


def names_at(place: Sequence[str | int], model: Any) -> list[str]:
    """The names that a mapping at ``place`` may have by ``model``, a class of pydantic's or a dataclass.

    Parts of ``place`` that stand for an alternative of a union, as pydantic writes them, change nothing.
    """
    kinds: list[Any] = [model]
    for part in place:
        kinds = [inner for one in kinds for inner in _inside(one, part)] or kinds
    return list(dict.fromkeys(name for one in kinds for kind in _kinds(one) for name in _fields_of(kind)))


def _inside(annotation: Any, part: str | int) -> Iterator[Any]:
    """What may stand at ``part`` of a value that is annotated so."""
    for kind in _kinds(annotation):
        if str(part) in (fields := _fields_of(kind)):
            yield fields[str(part)]
        elif get_origin(kind) in (dict, list):
            yield get_args(kind)[-1]


def _kinds(annotation: Any) -> Iterator[Any]:
    """The models, lists and mappings among the alternatives of an annotation."""
    if isinstance(annotation, type) or get_origin(annotation) in (dict, list):
        yield annotation
        return
    for alternative in get_args(annotation):
        yield from _kinds(alternative)


def _fields_of(kind: Any) -> Mapping[str, Any]:
    if isinstance(kind, type) and issubclass(kind, BaseModel):
        return {name: field.annotation for name, field in kind.model_fields.items()}
    if isinstance(kind, type) and dataclasses.is_dataclass(kind):
        hints = get_type_hints(kind)
        return {field.name: hints[field.name] for field in dataclasses.fields(kind)}
    return {}
